"""A truth brought to a result: its frame to the camera's, its clock to the IMU's, and how that was done."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..errors import RecordingError
from ..recording import CameraFrame, Truth
from ..result import Recovery
from .mocap.clock import MocapClock, align_clock
from .mocap.frame import (
    CameraFromMocap,
    far_off_m,
    imu_in_mocap,
    solve_frame,
    solve_plate_place,
    stated_frame,
)
from .mocap.markers import map_by_names, read_marker_map
from .mocap.motion import MocapMotion, motion_of_markers, motion_of_truth
from .truth import read_truth
from .words import said

_said = partial(said, "reference")
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
        camera_frame = camera_frame or likely_frame(recovery)
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


def likely_frame(recovery: Recovery) -> CameraFrame | None:
    """The camera's axes by where gravity points in them; None where that does not show."""
    down = recovery.gravity_direction
    if not np.isfinite(down).all() or abs(down[1]) < 0.7:
        return None
    return CameraFrame.OPTICAL if down[1] > 0 else CameraFrame.KINECT
