"""A truth brought to a result: read, and in its frame and on its clock; whether it can be one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..errors import RecordingError
from ..io import open_recording
from ..io.recording.choose import choose_truth
from ..io.tables.columns import read_pose_table
from ..linalg import masked_correlation
from ..recording import CameraFrame, Truth
from ..result import Recovery
from ..runtime.inputs import check_input
from .metrics import truth_at
from .mocap.alignment import (
    STEP_S,
    CameraFromMocap,
    MocapClock,
    align_clock,
    far_off_m,
    imu_in_mocap,
    solve_frame,
    solve_plate_place,
    stated_frame,
    turns_rad,
    way_m,
)
from .mocap.motion import MocapMotion, map_by_names, motion_of_markers, motion_of_truth, read_marker_map
from .words import said

_said = partial(said, "reference")
#: What a truth may be read from.
FORMATS = (".mcap", ".csv")


def read_truth(path: Path | str, recovery: Recovery) -> Truth:
    """Read the pose of the forearm IMU in the camera frame, on the IMU's clock.

    Times of a table count from the recovery's origin, or are those of its clock.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise RecordingError(
            f"{path}: a truth is read from .c3d or .trc (markers), {' or '.join(FORMATS)} (poses), not from"
            f" '{path.suffix or path.name}'"
        )
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    is_table = path.suffix.lower() == ".csv"
    own = None if is_table else choose_truth(open_recording(path), recovery.side, recovery.body)
    poses, why = own or (read_pose_table(path), [])
    if poses is None:
        why = why or [f"There are no poses (PoseInFrame, PoseStamped) of the {recovery.arm_label}."]
        raise RecordingError(f"{path} has no truth. {' '.join(why)} Keep one, or call it /truth.")
    order = np.argsort(poses.stamp_ns, kind="stable")
    t_s: FloatArray = (poses.stamp_ns[order] - recovery.origin_ns) / 1e9
    if is_table and len(recovery) and (t_s[0] > recovery.t_s[-1] or recovery.t_s[0] > t_s[-1]):
        t_s = poses.stamp_ns[order] / 1e9
    score = np.ones(len(t_s), dtype=bool) if poses.score is None else poses.score[order]
    joints = {name: value[order] for name, value in poses.joints.items()}
    return Truth(t_s, poses.position[order], poses.quaternion[order], score, joints)


#: No arm is this far from where the camera saw it: the truth is in another unit, m (median).
OTHER_UNIT_M = 50.0
#: A truth that moves like the answer and is farther from it than this, while the camera sees the arm, is in
#: other axes, m (median).
OTHER_FRAME_M = 0.3
#: Orientations farther apart than this are not errors of a result whose positions fit, degrees (median).
OTHER_AXES_DEG = 60.0
#: Quaternions read in the right order are nearer than this, degrees (median).
RIGHT_ORDER_DEG = 20.0
#: Speeds of one motion agree better than this; another trial of a protocol stays below within half a second.
LEAST_CORRELATION = 0.5
#: A signal whose speed varies less (standard deviation) is not informative, m/s and rad/s.
STILL_M_S, STILL_RAD_S = 0.05, 0.2
#: Samples per second that speeds are compared at, and the least time that they must share, s.
RATE_HZ, SHORTEST_S = 20.0, 4.0
#: They are shifted against each other by up to this, s.
MOST_LAG_S = 0.5


def truth_notes(recovery: Recovery, truth: Truth, aligned: bool = False) -> list[str]:
    """What makes a truth look wrong, one sentence each; usually none."""
    at = truth_at(truth, recovery.t_s)
    chosen = at.score & ~recovery.occluded
    away = [np.linalg.norm(mine - other, axis=1)[chosen] for mine, other in _shared(recovery, at)]
    # of the IMU, else of the joints that both have
    distance_m = next((float(np.nanmedian(each)) for each in away if np.isfinite(each).any()), np.nan)
    if distance_m > OTHER_UNIT_M:
        everywhere = (np.concatenate([one.position, *one.joints.values()]) for one in (truth, recovery))
        true_m, found_m = (float(np.nanmedian(np.linalg.norm(each, axis=1))) for each in everywhere)
        ratio = true_m / found_m
        unit = "centimetres" if 30.0 < ratio < 300.0 else "millimetres"
        return [_said("other_unit", away_m=distance_m, unit=unit)]
    if aligned:
        return []
    correlations = _correlations(recovery, truth)
    if correlations and max(correlations) < LEAST_CORRELATION:
        return [_said("other_motion", correlation=max(correlations))]
    notes = []
    if distance_m > OTHER_FRAME_M and correlations:
        notes.append(_said("other_frame", away_m=distance_m))
    return notes + _axes_notes(recovery, at, chosen)


def _shared(recovery: Recovery, truth: Truth) -> list[tuple[FloatArray, FloatArray]]:
    """Positions of both: of the IMU, and of the joints they share."""
    pairs = [(recovery.position, truth.position)]
    return pairs + [
        (recovery.joints[name], place) for name, place in truth.joints.items() if name in recovery.joints
    ]


def _correlations(recovery: Recovery, truth: Truth) -> list[float]:
    """The best correlations of both speeds, and of both turns, within half a second, if informative."""
    first, last = max(recovery.t_s[0], truth.t_s[0]), min(recovery.t_s[-1], truth.t_s[-1])
    if last - first < SHORTEST_S:
        return []
    t = np.arange(first, last, 1.0 / RATE_HZ)
    hidden = recovery.occluded[np.clip(np.searchsorted(recovery.t_s, t), 0, len(recovery) - 1)]
    own, others = (recovery.t_s, recovery.quaternion), (truth.t_s, truth.quaternion)
    speeds = [
        (way_m(recovery.t_s, mine, t) / STEP_S, way_m(truth.t_s, other, t) / STEP_S, STILL_M_S)
        for mine, other in _shared(recovery, truth)
    ]
    turning = (np.linalg.norm(turns_rad(*each, t), axis=1) / STEP_S for each in (own, others))
    found = []
    for mine, other, still in [*speeds, (*turning, STILL_RAD_S)]:
        mine = np.where(hidden, np.nan, mine)
        known = np.isfinite(mine) & np.isfinite(other)
        if known.sum() < SHORTEST_S * RATE_HZ or min(mine[known].std(), other[known].std()) < still:
            continue
        r, _ = masked_correlation(mine, other, least_variance=1e-3)
        within = slice(len(t) - 1 - round(MOST_LAG_S * RATE_HZ), len(t) + round(MOST_LAG_S * RATE_HZ))
        found.append(float(r[within].max()))
    return found


def _axes_notes(recovery: Recovery, at: Truth, chosen: BoolArray) -> list[str]:
    """Orientations that are far off all the time: the order of the quaternion, or other axes."""
    chosen = chosen & np.isfinite(at.quaternion).all(axis=1) & np.isfinite(recovery.quaternion).all(axis=1)
    if not chosen.any():
        return []
    mine = Rotation.from_quat(recovery.quaternion[chosen], scalar_first=True)
    # the columns may contain qx, qy, qz, qw under the names qw, qx, qy, qz
    turn, rolled = (
        mine.inv() * Rotation.from_quat(at.quaternion[chosen], scalar_first=k) for k in (True, False)
    )
    angle_deg = float(np.median(np.degrees(turn.magnitude())))
    if not angle_deg > OTHER_AXES_DEG:
        return []
    if np.median(np.degrees(rolled.magnitude())) < RIGHT_ORDER_DEG:
        return [_said("other_order", angle_deg=angle_deg)]
    apart = np.degrees((turn.mean().inv() * turn).magnitude())
    steady = "by a constant turn" if np.median(apart) < RIGHT_ORDER_DEG else "all the time"
    return [_said("other_axes", angle_deg=angle_deg, steady=steady)]


#: Mocap kept beyond the ends of the result, s.
MARGIN_S = 1.0
#: A calibration that puts the arm farther than this from where the camera saw it is doubted, m.
FAR_OFF_M = 0.15
#: A plate whose mean lies closer than this to where the answer has the IMU is centred on it: the answer's own
#: constant errors are as large, m.
CENTRED_M = 0.003
#: No plate reaches farther from its IMU; what does is an error of the frame or of the answer, m.
LARGEST_PLATE_M = 0.15


@dataclass(frozen=True)
class ReferenceAlignment:
    """How the truth was brought to the result."""

    # "none" (the truth came in the camera's frame and on the IMU's clock), "calibration" (the frame from a
    # calibration file, the clock solved) or "solved" (both solved from the recording)
    kind: Literal["none", "calibration", "solved"] = "none"
    clock: MocapClock | None = None  # The truth's clock; None where the kind is "none"
    frame: CameraFromMocap | None = None  # The truth's frame; likewise
    # dict of (m, 3) m: Positions in {K} of single markers on the bones, by name, at the truth's times
    landmarks: dict[str, FloatArray] | None = None
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    def titled(self, text: str) -> str:
        """The title of a result: states where the truth was aligned."""
        how = {
            "none": "",
            "calibration": " (clock aligned, frame from the calibration)",
            "solved": " (aligned: frame and clock of the truth solved from this recording)",
        }
        return text + how[self.kind]

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        clock, frame = self.clock, self.frame
        plain: dict[str, Any] = {
            "alignment": self.kind,
            "clock": {
                "offset_s": clock.offset_s if clock else 0.0,
                "sigma_s": clock and clock.sigma_s,
                "skew_ppm": clock and 1e6 * clock.skew,
                "skew_sigma_ppm": clock and 1e6 * clock.skew_sigma,
                "correlation": clock and clock.correlation,
            },
        }
        if frame is not None:
            plain["camera_from_mocap"] = {
                "rotation": Rotation.from_matrix(frame.R_K_E).as_quat(canonical=True, scalar_first=True),
                "translation": frame.t_K_E,
                "rotation_sigma_deg": frame.rotation_sigma_deg,
                "translation_sigma_m": frame.translation_sigma_m,
                "residual_rms_m": frame.residual_m,
                "axes": "those of the recording's camera frame",
            }
        return plain


def read_reference(
    path: Path | str,
    recovery: Recovery,
    *,
    markers: Path | str | None = None,
    calibration: Path | str | None = None,
    camera_frame: CameraFrame | None = None,
    align: bool = False,
) -> tuple[Truth, ReferenceAlignment]:
    """Read a truth of any kind, in the camera frame and on the IMU's clock."""
    from ..io.tables.markers import MARKER_FORMATS, read_markers

    path = Path(path)
    if path.suffix.lower() not in MARKER_FORMATS:
        if markers is not None:
            raise RecordingError(f"{path} contains poses, not markers, so --markers has no use; leave it out")
        truth = read_truth(path, recovery)
        if calibration is None and not align:
            return truth, ReferenceAlignment()
        motion = motion_of_truth(truth, str(path))
    else:
        trajectories = read_markers(path)
        chosen = map_by_names(trajectories.names, str(path)) if markers is None else read_marker_map(markers)
        motion = motion_of_markers(trajectories, chosen)
    frame = None
    if calibration is not None:
        from calib.file import read_calibration

        tables = read_calibration(calibration).tables
        if camera_frame is None and abs(down_y := recovery.gravity_direction[1]) >= 0.7:  # as it seems
            camera_frame = CameraFrame.OPTICAL if down_y > 0 else CameraFrame.KINECT
        frame = stated_frame(tables.get("camera_from_mocap"), camera_frame, str(calibration))
    return align_reference(motion, recovery, frame)


def align_reference(
    motion: MocapMotion, recovery: Recovery, frame: CameraFromMocap | None
) -> tuple[Truth, ReferenceAlignment]:
    """A motion capture as a truth: its clock, its frame, the plate on the IMU."""
    clock = align_clock(recovery, motion)
    notes = [
        *motion.notes,
        _said(
            "clock",
            **{name: getattr(clock, name) for name in ("by", "correlation", "offset_s")},
            sigma_ms=1e3 * clock.sigma_s,
            skew_ppm=1e6 * clock.skew,
            skew_sigma_ppm=1e6 * clock.skew_sigma,
        ),
        *clock.notes,
    ]
    if clock.R_A_P is not None:
        motion = replace(motion, R_A_P=clock.R_A_P)
        notes.append(_said("mount", sigma_deg=np.degrees(clock.mount_sigma_rad)))
    kind: Literal["calibration", "solved"] = "solved" if frame is None else "calibration"
    if frame is None:
        frame = solve_frame(recovery, motion, clock)
        sizes = {"sigma_mm": 1e3 * frame.translation_sigma_m, "rms_mm": 1e3 * frame.residual_m}
        notes.append(_said("frame", by=frame.by, sigma_deg=frame.rotation_sigma_deg, **sizes))
    else:
        notes.append(_said("stated_frame", by=frame.by))
        away = far_off_m(recovery, motion, clock, frame)
        if away > FAR_OFF_M:
            notes.append(_said("far_off", away_m=away))
    if motion.p_E_P is not None and motion.p_A_P is None and motion.R_A_P is not None:
        p_A_P = solve_plate_place(recovery, motion, clock, frame)
        away_m = float(np.linalg.norm(p_A_P))
        solved = CENTRED_M <= away_m <= LARGEST_PLATE_M
        motion = replace(motion, p_A_P=p_A_P if solved else np.zeros(3))
        why = "within its own error" if away_m < CENTRED_M else "farther than a plate reaches"
        notes.append(_said("place" if solved else "centred", away_mm=1e3 * away_m, why=why))
    truth, landmarks = _aligned(motion, clock, frame, recovery)
    return truth, ReferenceAlignment(kind, clock, frame, landmarks, tuple(notes))


def _aligned(
    motion: MocapMotion, clock: MocapClock, frame: CameraFromMocap, recovery: Recovery
) -> tuple[Truth, dict[str, FloatArray]]:
    """The motion near the recovery as a truth, and its landmarks."""
    t_s = clock.to_imu(motion.t_s)
    rows = np.flatnonzero((t_s >= recovery.t_s[0] - MARGIN_S) & (t_s <= recovery.t_s[-1] + MARGIN_S))
    imu = imu_in_mocap(motion)
    position = np.full((len(rows), 3), np.nan) if imu is None else frame.place(imu[rows])
    quaternion = np.full((len(rows), 4), np.nan)
    if motion.R_E_P is not None and motion.R_A_P is not None:
        R_E_P = motion.R_E_P[rows]
        known = np.isfinite(R_E_P).all(axis=(1, 2))
        R_K_A = frame.R_K_E @ R_E_P[known] @ motion.R_A_P.T
        quaternion[known] = Rotation.from_matrix(R_K_A).as_quat(scalar_first=True)
    joints, landmarks = (
        {name: frame.place(value[rows]) for name, value in places.items()}
        for places in (motion.joints, motion.landmarks)
    )
    return Truth(t_s[rows], position, quaternion, np.ones(len(rows), dtype=bool), joints), landmarks
