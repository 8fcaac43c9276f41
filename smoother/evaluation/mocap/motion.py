"""The arm's motion by motion capture, in its own frame {E} and on its own clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...errors import RecordingError
from ...io.tables.markers import Markers
from ...measures.motion import one_sign
from ...recording import Truth
from ..metrics import BRIDGED_S
from ..words import said
from .markers import (
    LONGEST_S,
    MarkerMap,
    fill_on_plate,
    find_markers,
    find_shape,
    fit_poses,
    follow,
    plate_axes,
)

_said = partial(said, "reference")
#: Joints whose markers are filled in the axes of the plate.
ON_FOREARM = ("elbow", "wrist", "hand")
#: Windows tried for smoothing the plate's pose, s; 0.16 s is a low-pass at about 10 Hz, as labs use it.
SMOOTH_S = (0.06, 0.08, 0.12, 0.16, 0.2, 0.24, 0.32, 0.4)
#: A map whose plate differs from the one that was seen by more than this is of another plate, m (rms).
OTHER_PLATE_M = 0.005
#: Joints next to each other are apart by this, m; a file whose unit is wrong shows by it.
BONE_M = (0.08, 0.8)
#: Markers on skin and a shoulder that shifts change an upper arm's length by less (10 to 90 %), m.
LENGTH_CHANGES_M = 0.05
#: Markers that fit one body in fewer of the frames that show three of them are not on one.
LEAST_RIGID = 0.5


@dataclass(frozen=True)
class MocapMotion:
    """Joint centres, landmarks and the plate's pose."""

    t_s: FloatArray  # (n,) s: on the mocap's clock
    joints: dict[str, FloatArray] = field(default_factory=dict)  # dict of (n, 3) m: positions by name, in {E}
    # dict of (n, 3) m: Positions by name, in {E}; nan where a marker of theirs was not seen
    landmarks: dict[str, FloatArray] = field(default_factory=dict)
    R_E_P: FloatArray | None = None  # (n, 3, 3) and (n, 3) m: pose of the plate's axes {P}
    p_E_P: FloatArray | None = None
    R_A_P: FloatArray | None = None  # (3, 3) and (3,) m: the plate's axes in the IMU's
    p_A_P: FloatArray | None = None
    source: str = "the motion capture"  # What to call it in messages
    notes: tuple[str, ...] = ()  # What was decided, one sentence each

    @property
    def quaternion(self) -> FloatArray:
        """(N, 4) qw, qx, qy, qz of `R_E_P`; nan where there is none."""
        result = np.full((len(self.t_s), 4), np.nan)
        if self.R_E_P is not None:
            known = np.isfinite(self.R_E_P).all(axis=(1, 2))
            result[known] = Rotation.from_matrix(self.R_E_P[known]).as_quat(scalar_first=True)
        return result


def motion_of_markers(markers: Markers, marker_map: MarkerMap) -> MocapMotion:
    """Joint centres as means of their markers, the plate as a rigid body."""

    def places(names: Sequence[str]) -> FloatArray:
        index = find_markers(names, markers.names, marker_map.source, markers.source)
        return markers.position[:, index]

    plate = MocapMotion(markers.t_s, source=markers.source, notes=markers.notes)
    positions = {joint: places(names) for joint, names in marker_map.joints.items()}
    _check_unit(positions, markers)
    if marker_map.plate:
        plate = _with_plate(plate, places(marker_map.plate), marker_map)
    filled = []
    for joint in [each for each in positions if each in ON_FOREARM and plate.R_E_P is not None]:
        positions[joint], count = _filled(plate, positions[joint])
        if count:
            filled.append(f"{joint} {100 * count / positions[joint][..., 0].size:.1f} %")
    joints = {joint: each.mean(axis=1) for joint, each in positions.items()}
    landmarks = {name: places([marker])[:, 0] for name, marker in marker_map.landmarks.items()}
    notes = list(plate.notes)
    if filled:
        notes.append(_said("filled", longest_s=LONGEST_S, joints=", ".join(filled)))
    for joint, centre in joints.items():
        if not np.isfinite(centre).any():
            raise RecordingError(
                f"{markers.source}: the markers of the {joint} ({', '.join(marker_map.joints[joint])}) are"
                " never seen together; correct the map"
            )
    notes += _exchanged(joints)
    shares = [np.isfinite(centre).all(axis=1).mean() for centre in joints.values()]
    poor = [f"{name} {100 * share:.0f} %" for name, share in zip(joints, shares, strict=True) if share < 0.8]
    if poor:
        notes.append(_said("incomplete", joints=", ".join(poor)))
    return replace(plate, joints=joints, landmarks=landmarks, notes=tuple(notes))


def _check_unit(positions: dict[str, FloatArray], markers: Markers) -> None:
    """Refuse bones of impossible length, from markers (N, M, 3) by joint."""
    for one, other in (("elbow", "wrist"), ("shoulder", "elbow")):
        if one not in positions or other not in positions:
            continue
        length = np.linalg.norm(positions[one].mean(axis=1) - positions[other].mean(axis=1), axis=1)
        length = length[np.isfinite(length)]
        if len(length) and not BONE_M[0] < float(np.median(length)) < BONE_M[1]:
            raise RecordingError(
                f"{markers.source}: {one} and {other} are {float(np.median(length)):.3g} m apart; check that"
                f" the file's coordinates are in its unit, {markers.unit}, and the marker map"
            )


def _exchanged(joints: dict[str, FloatArray]) -> list[str]:
    """Whether lengths show that elbow and wrist are called by each other's name."""
    if not {"elbow", "wrist"} <= set(joints):
        return []
    elbow, wrist = joints["elbow"], joints["wrist"]

    def apart(one: FloatArray, other: FloatArray) -> FloatArray:
        length = np.linalg.norm(one - other, axis=1)
        return length[np.isfinite(length)]

    signs = []
    if "hand" in joints:
        near, far = apart(joints["hand"], elbow), apart(joints["hand"], wrist)
        if len(near) and len(far) and np.median(near) < np.median(far):
            near_cm, far_cm = (100 * float(np.median(each)) for each in (near, far))
            signs.append(f"the hand is {near_cm:.0f} cm from the elbow and {far_cm:.0f} cm from the wrist")
    if "shoulder" in joints:
        steady, changing = apart(joints["shoulder"], wrist), apart(joints["shoulder"], elbow)
        if len(steady) and len(changing):
            own, other = (float(np.subtract(*np.percentile(each, [90, 10]))) for each in (steady, changing))
            if other > LENGTH_CHANGES_M and own < 0.5 * other:
                signs.append(
                    f"the upper arm's length changes by {100 * other:.0f} cm, shoulder to wrist by"
                    f" {100 * own:.0f} cm"
                )
    return [_said("exchanged", signs="; ".join(signs))] if signs else []


def _filled(plate: MocapMotion, positions: FloatArray) -> tuple[FloatArray, int]:
    """Markers (N, M, 3) of a joint, filled where hidden for a moment, and how many samples were."""
    assert plate.R_E_P is not None and plate.p_E_P is not None
    parts = [
        fill_on_plate(plate.t_s, positions[:, marker], plate.R_E_P, plate.p_E_P)
        for marker in range(positions.shape[1])
    ]
    return np.stack([path for path, _ in parts], axis=1), sum(count for _, count in parts)


def motion_of_truth(truth: Truth, source: str) -> MocapMotion:
    """A reference of poses as if a plate whose axes are the IMU's had been captured."""
    quaternion = truth.quaternion
    R_E_P = np.full((len(truth), 3, 3), np.nan)
    known = np.isfinite(quaternion).all(axis=1)
    R_E_P[known] = Rotation.from_quat(quaternion[known], scalar_first=True).as_matrix()
    position = np.where(truth.score[:, None], truth.position, np.nan)
    return MocapMotion(truth.t_s, truth.joints, {}, R_E_P, position, np.eye(3), np.zeros(3), source=source)


def _with_plate(motion: MocapMotion, positions: FloatArray, marker_map: MarkerMap) -> MocapMotion:
    """Add the plate's pose: its shape from the frames, its axes from the map where that states them."""
    shape = find_shape(positions)
    if np.isfinite(shape).all(axis=1).sum() < 3:
        raise RecordingError(
            f"{motion.source}: the plate's markers ({', '.join(marker_map.plate)}) are never seen three at a"
            " time, or lie on a line, so the plate has no pose"
        )
    shape, R_A_P, p_A_P = _in_stated_axes(shape, marker_map, motion.source)
    poses = follow(shape, positions)
    answered = np.isfinite(poses.residual_m)
    tried = np.isfinite(positions).all(axis=2).sum(axis=1) >= 3
    if not answered.sum() >= LEAST_RIGID * tried.sum():
        raise RecordingError(
            f"{motion.source}: the plate's markers ({', '.join(marker_map.plate)}) do not move as one body;"
            " correct the map"
        )
    rms_mm = 1000 * np.sqrt(np.nanmean(poses.residual_m**2))
    notes = [_said("plate", markers=len(shape), percent=100 * answered.mean(), rms_mm=rms_mm)]
    if poses.mistaken:
        notes.append(_said("mistaken", count=poses.mistaken))
    rotation, position = smoothed(motion.t_s, poses.rotation, poses.position)
    posed = replace(motion, R_E_P=rotation, p_E_P=position, notes=(*motion.notes, *notes))
    return replace(posed, R_A_P=R_A_P, p_A_P=p_A_P)


def _in_stated_axes(
    shape: FloatArray, marker_map: MarkerMap, source: str
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """The shape in the IMU's axes where the map places its markers, else in {P}; and those axes in {A}."""
    if marker_map.plate_A:
        placed = np.array([marker_map.plate_A.get(name, np.full(3, np.nan)) for name in marker_map.plate])
        both = np.isfinite(placed).all(axis=1) & np.isfinite(shape).all(axis=1)
        R, p = fit_poses(shape, placed[None], both[None])
        in_imu = shape @ R[0].T + p[0]
        off = float(np.sqrt(((in_imu - placed)[both] ** 2).sum(axis=1).mean()))
        if off > OTHER_PLATE_M:
            raise RecordingError(
                f"{marker_map.source}: [imu_plate] places the markers {1000 * off:.1f} mm (rms) from where"
                f" {source} has them on the plate; check the places, their unit (m) and their names"
            )
        return in_imu, np.eye(3), np.zeros(3)
    axes, origin = plate_axes(shape)
    return (shape - origin) @ axes, marker_map.R_A_P, marker_map.p_A_P


def smoothed(t_s: FloatArray, rotation: FloatArray, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses low-passed without delay, not across missing frames, by cubics (Savitzky, Golay)."""
    known = np.isfinite(rotation).all(axis=(1, 2)) & np.isfinite(position).all(axis=1)
    rotation, position = rotation.copy(), position.copy()
    rotation[~known], position[~known] = np.nan, np.nan
    rows = np.flatnonzero(known)
    if len(rows) < 2:
        return rotation, position
    period = float(np.median(np.diff(t_s)))
    # a missing frame would shift the samples against the window, so the parts end there
    parts = np.split(rows, np.flatnonzero(np.diff(t_s[rows]) > min(1.5 * period, BRIDGED_S)) + 1)
    quaternions = [one_sign(Rotation.from_matrix(rotation[part]).as_quat()) for part in parts]
    for part, smooth in zip(parts, _best_smooth(quaternions, period), strict=True):
        rotation[part] = Rotation.from_quat(smooth).as_matrix()
    for part, smooth in zip(parts, _best_smooth([position[part] for part in parts], period), strict=True):
        position[part] = smooth
    return rotation, position


def _best_smooth(parts: list[FloatArray], period_s: float) -> list[FloatArray]:
    """Each part (n, d) smoothed with the window that predicts best; shorter ones as they are."""
    from scipy.signal import savgol_coeffs, savgol_filter

    best, least = parts, np.inf
    windows = sorted({2 * round(0.5 * length / period_s) + 1 for length in SMOOTH_S})
    windows = [window for window in windows if window >= 5]
    scored = [part for part in parts if windows and len(part) >= windows[-1]]
    for window in windows:
        own_share = savgol_coeffs(window, 3)[window // 2]
        half = windows[-1] // 2  # the ends of a part are fitted from one side: not scored
        error = sum(
            float(
                (((part - savgol_filter(part, window, 3, axis=0)) / (1 - own_share))[half:-half] ** 2).sum()
            )
            for part in scored
        )
        if scored and error < least:
            least = error
            best = [savgol_filter(part, window, 3, axis=0) if len(part) >= window else part for part in parts]
    return best
