"""A truth read from a file, and whether it can be one of this recording."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..errors import RecordingError
from ..io import open_recording
from ..io.recording.choose import choose_truth
from ..io.tables.recording_toml import read_pose_table
from ..recording import Truth
from ..result import Recovery
from ..runtime.inputs import check_input
from .metrics import best_correlation, truth_at
from .mocap.clock import STEP_S, turns_rad, way_m
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
        best = best_correlation(t, mine[:, None], other[:, None])
        if best is not None:
            found.append(best)
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
