"""The grey person about a moving arm: as measured where the skeleton has it, else a silhouette."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..joint_angles import torso_axes
from ..linalg import interpolate, unit
from ..recording import CameraFrame, JointTracks, Recording
from ..result import Recovery
from ..rotation import Rotation
from .sheet import listed
from .space import packed, upwards

#: Lengths as shares of stature: Drillis and Contini (1966), in Winter, Biomechanics and Motor Control of
#: Human Movement, 4th ed., figure 4.1; the shoulders' centres lie nearer to each other than the acromia.
UPPER_ARM, FOREARM, HAND = 0.186, 0.146, 0.05
BETWEEN_SHOULDERS, SHOULDERS_TO_HIPS, BETWEEN_HIPS = 0.22, 0.288, 0.14
SHOULDERS_TO_NECK, SHOULDERS_TO_HEAD, NOSE = 0.052, 0.125, 0.06
#: Stature where the arm does not show it, and its limits, m.
STATURE_M, STATURES_M = 1.70, (0.9, 2.2)
#: Between the shoulders of a person, m; others are mistakes of the camera.
WIDTHS_M = (0.15, 0.6)
#: A body moves slowly: it is drawn at no more than this many instants a second, and this many in all.
RATE_HZ, MOST_FRAMES = 10.0, 5000
#: The shoulder moves with the arm, the trunk hardly: shoulders are averaged over this time, s.
SMOOTH_S = 2.0
#: A joint of the other arm that was not tracked for longer is not drawn, s.
AWAY_S = 0.5
#: Points of a person, in the order of the columns.
POINTS = ("head", "nose", "neck", "shoulder_left", "shoulder_right", "hip_left", "hip_right")
OTHER = ("elbow", "wrist", "hand")

#: An arm's recording, where it is at hand, and its answer.
PersonArm = tuple[Recording | None, Recovery]


def persons(arms: Sequence[PersonArm], frame: CameraFrame | None) -> list[dict[str, Any]]:
    """The person of each arm, once each, as the page's player takes them.

    Parameters
    ----------
    arms : sequence of (Recording or None, Recovery)
        In one camera frame and on one clock; the other arm of a recording is drawn where it is not an arm
        itself.
    frame : CameraFrame, optional
        The directions of the camera's axes.

    Returns
    -------
    persons : list of dict
        Plain values: `points` (n, 3 x `names`), on a grid `start`, `step`, `count`, `stature` in m, `other`
        ("left", "right" or "" where both arms are recovered), and `measured`, what of it the skeleton has.
        Arms without a shoulder have no person.
    """
    found = []
    for body in dict.fromkeys(recovery.body for _, recovery in arms):
        mine = [arm for arm in arms if arm[1].body == body and _has_shoulder(arm[1])]
        if mine:
            found.append(_person(mine, frame))
    return found


def words_of(people: Sequence[dict[str, Any]]) -> str:
    """What of the grey body was measured, and what is a silhouette, in a sentence; "" without a body."""
    if not people:
        return ""
    measured = list(dict.fromkeys(part for person in people for part in person["measured"]))
    upright = ", upright and facing the camera"
    if measured:
        upright = "" if "trunk" in measured else ", upright"
    seen = f" As measured: {listed(measured)}. The rest is" if measured else " It is"
    return (
        f"The grey body shows where the arm is.{seen} a silhouette by usual body proportions{upright}, which"
        " was not measured."
    )


def _person(arms: Sequence[PersonArm], frame: CameraFrame | None) -> dict[str, Any]:
    first = arms[0][1]
    t = _grid([recovery for _, recovery in arms])
    up = np.tile(upwards(frame, first.gravity_direction), (len(t), 1))
    shoulders = {
        recovery.side or "right": _smooth(t, recovery.t_s, recovery.joints["shoulder"])
        for _, recovery in arms
    }
    side = first.side or "right"
    other = {"left": "right", "right": "left"}[side]
    opposite = arms[0][0].opposite if len(shoulders) == 1 and arms[0][0] is not None else None
    limb: dict[str, FloatArray] = {}
    if opposite is not None:
        limb = _tracked(opposite, t - _offset(first))
        if np.isfinite(limb.get("shoulder", np.nan)).any():
            shoulders[other] = _smooth(t, t, limb["shoulder"])
    if len(shoulders) == 2 and not _are_apart(shoulders):
        del shoulders[other]
    measured = ["both shoulders"] if len(shoulders) == 2 else []
    stature = _stature(arms)
    right = _right(t, shoulders, first, up, frame, measured)
    for each, sign in (("right", 1.0), ("left", -1.0)):
        if each not in shoulders:
            there = shoulders[side]
            shoulders[each] = there + sign * BETWEEN_SHOULDERS * stature * right
    if "trunk" in measured:
        up = _axis(first, t, 1)
    ahead = unit(np.cross(up, right))
    middle = 0.5 * (shoulders["left"] + shoulders["right"])
    head = middle + stature * (SHOULDERS_TO_HEAD * up + 0.01 * ahead)
    hips = middle - stature * SHOULDERS_TO_HIPS * up
    points = {
        "head": head,
        "nose": head + stature * NOSE * ahead,
        "neck": middle + stature * SHOULDERS_TO_NECK * up,
        "shoulder_left": shoulders["left"],
        "shoulder_right": shoulders["right"],
        "hip_left": hips - 0.5 * BETWEEN_HIPS * stature * right,
        "hip_right": hips + 0.5 * BETWEEN_HIPS * stature * right,
    }
    free = other if len(arms) == 1 else ""
    if free:
        if {"elbow", "wrist"} & limb.keys():
            measured.append(f"{other} arm")
            points |= {joint: limb.get(joint, np.full((len(t), 3), np.nan)) for joint in OTHER}
        else:
            outwards = right if other == "right" else -right
            points["elbow"] = shoulders[other] + stature * (0.03 * outwards - UPPER_ARM * up)
            points["wrist"] = points["elbow"] + stature * (0.03 * ahead - FOREARM * up)
            points["hand"] = points["wrist"] - stature * HAND * up
    names = [*POINTS, *(OTHER if free else ())]
    return {
        "names": names,
        "points": packed(np.concatenate([points[name] for name in names], axis=1)),
        "start": float(t[0]),
        "step": float(t[1] - t[0]),
        "count": len(t),
        "stature": stature,
        "other": free,
        "measured": measured,
        "extent": [np.nanmedian(points[name], axis=0).tolist() for name in ("head", "hip_left", "hip_right")],
    }


def _has_shoulder(recovery: Recovery) -> bool:
    shoulder = recovery.joints.get("shoulder")
    return shoulder is not None and len(recovery) > 1 and bool(np.isfinite(shoulder).all(axis=1).any())


def _are_apart(shoulders: dict[str, FloatArray]) -> bool:
    """Whether two shoulders are as far from each other as a person's."""
    width_m = float(np.nanmedian(np.linalg.norm(shoulders["right"] - shoulders["left"], axis=1)))
    return WIDTHS_M[0] < width_m < WIDTHS_M[1]


def _grid(recoveries: Sequence[Recovery]) -> FloatArray:
    start = min(float(recovery.t_s[0]) for recovery in recoveries)
    end = max(float(recovery.t_s[-1]) for recovery in recoveries)
    return np.linspace(start, end, int(np.clip((end - start) * RATE_HZ, 2, MOST_FRAMES)))


def _smooth(t: FloatArray, at: FloatArray, values: FloatArray) -> FloatArray:
    """Values (n, 3) at times `t`, averaged over some seconds, held where there are none."""
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    known = known[:: max(1, len(known) // (4 * MOST_FRAMES))]
    even = interpolate(at[known], values[known], t)
    width = max(1, round(0.5 * SMOOTH_S / (t[1] - t[0])))
    sums = np.cumsum(np.concatenate([np.zeros((1, 3)), even]), axis=0)
    low, high = np.maximum(np.arange(len(t)) - width, 0), np.minimum(np.arange(len(t)) + width + 1, len(t))
    return (sums[high] - sums[low]) / (high - low)[:, None]


def _tracked(arm: JointTracks, t: FloatArray) -> dict[str, FloatArray]:
    """Joints that were tracked, at times of the camera's clock; nan where they were not for long."""
    joints = {}
    for name in ("shoulder", *OTHER):
        rows = np.flatnonzero(arm.tracked(name))
        if len(rows) < 2:
            continue
        at = arm.t_s[rows]
        after = np.searchsorted(at, t).clip(1, len(at) - 1)
        away = np.minimum(np.abs(at[after] - t), np.abs(t - at[after - 1])) > AWAY_S
        joints[name] = interpolate(at, arm.joint(name)[rows], t)
        joints[name][away] = np.nan
    return joints


def _offset(recovery: Recovery) -> float:
    """The IMU's clock less the camera's, s."""
    return recovery.clock_offset_s if np.isfinite(recovery.clock_offset_s) else 0.0


def _right(
    t: FloatArray,
    shoulders: dict[str, FloatArray],
    recovery: Recovery,
    up: FloatArray,
    frame: CameraFrame | None,
    measured: list[str],
) -> FloatArray:
    """Unit vectors (n, 3) to the person's right: by the trunk's IMU, by both shoulders, else as facing us."""
    if _has_trunk(recovery):
        measured.append("trunk")
        return _axis(recovery, t, 2)
    if len(shoulders) == 2:
        across = shoulders["right"] - shoulders["left"]
        return unit(across - np.einsum("ni,ni->n", across, up)[:, None] * up)
    return np.tile(torso_axes(-up[0])[:, 2], (len(t), 1))


def _has_trunk(recovery: Recovery) -> bool:
    trunk = recovery.trunk
    return trunk is not None and bool(np.isfinite(trunk.quaternion).all(axis=1).any())


def _axis(recovery: Recovery, t: FloatArray, axis: int) -> FloatArray:
    """An axis (n, 3) of the thorax by the IMU on the trunk, held where it has no samples."""
    assert recovery.trunk is not None
    known = np.flatnonzero(np.isfinite(recovery.trunk.quaternion).all(axis=1))
    known = known[:: max(1, len(known) // (4 * MOST_FRAMES))]
    R_K_T = Rotation.from_quat(recovery.trunk.quaternion[known], scalar_first=True).as_matrix()
    return unit(interpolate(recovery.t_s[known], R_K_T[:, :, axis], t))


def _stature(arms: Sequence[PersonArm]) -> float:
    """By the length of the arms, m."""
    lengths = []
    for _, recovery in arms:
        joints = recovery.joints
        if {"shoulder", "elbow", "wrist"} <= joints.keys():
            rows = slice(None, None, max(1, len(recovery) // 2000))
            at = [joints[name][rows] for name in ("shoulder", "elbow", "wrist")]
            arm = np.linalg.norm(at[1] - at[0], axis=1) + np.linalg.norm(at[2] - at[1], axis=1)
            lengths.append(float(np.nanmedian(arm)))
    known = [length for length in lengths if np.isfinite(length)]
    if not known:
        return STATURE_M
    return float(np.clip(np.mean(known) / (UPPER_ARM + FOREARM), *STATURES_M))
