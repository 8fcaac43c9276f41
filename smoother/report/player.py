"""The arm on the page: its points, and what the page's player is given."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..error_radius import error_radius
from ..linalg import interpolate, median_rate_hz, unit
from ..recording import CameraFrame, Truth
from ..result import Recovery
from ..result.untrusted import untrusted_times
from .sheet import Html, PageSection, data_block
from .traces import axis_names

#: How many arms are drawn.
MOST_ARMS = 8
#: The joints of an arm in a row.
CHAIN = ("shoulder", "elbow", "wrist", "hand")


def instants(recovery: Recovery, occluded: bool) -> IntArray:
    """Samples at which the arm is drawn: middles of the longest gaps, or spread over what is seen."""
    answered: BoolArray = np.all(np.isfinite(recovery.position), axis=1)
    if occluded:
        longest = sorted(recovery.gaps, key=lambda gap: -gap.length_s)[: MOST_ARMS // 2]
        middles = [0.5 * (gap.start_s + gap.end_s) for gap in longest]
        chosen = np.searchsorted(recovery.t_s, middles)
        chosen = np.clip(chosen, 0, max(len(recovery) - 1, 0)).astype(np.int64)
        return chosen[answered[chosen]] if len(chosen) and len(recovery) else np.zeros(0, np.int64)
    seen = np.flatnonzero(answered & ~recovery.occluded)
    if not len(seen):
        return seen
    return seen[np.linspace(0, len(seen) - 1, MOST_ARMS // 2 + 2).astype(int)[1:-1]]


#: All arms together take no more than this before they are written as text; longer ones are decimated.
MOST_BYTES = 5_500_000
#: No more frames per second than this, and this many where there is no camera.
MOST_HZ, PLAIN_HZ = 60.0, 30.0
#: A larger standard deviation is drawn as this one, m.
LARGEST_SIGMA_M = 3.0


def player(
    heading: str, caption: Html, arms: Sequence[tuple[Recovery, Truth | None]], frame: CameraFrame | None
) -> PageSection | None:
    """The arms in space as they move; None where no arm has an answer."""
    arms = [(recovery, truth) for recovery, truth in arms if len(recovery) > 1 and recovery.answered.any()]
    if not arms:
        return None
    played = [played_arm(recovery, truth, MOST_BYTES / len(arms)) for recovery, truth in arms]
    first = arms[0][0]
    points = np.concatenate([_extent(recovery) for recovery, _ in arms])
    up = upwards(frame, first.gravity_direction)
    at = [float(first.t_s[row]) for hidden in (True, False) for row in instants(first, hidden)]
    view = view_of(points, up, _seen_from(points, up, frame))
    data = data_block({"view": view, "arms": played, "axes": list(axis_names(frame)), "instants": at})
    return PageSection(heading, caption, player={"data": data, "switches": list(_switches(played))})


def played_arm(recovery: Recovery, truth: Truth | None, most_bytes: float) -> dict[str, Any]:
    """One arm on an even grid of times, about as many as the camera has frames."""
    names = [joint for joint in CHAIN if joint in recovery.joints]
    start, end = float(recovery.t_s[0]), float(recovery.t_s[-1])
    width = 2 * (6 * len(names) + 10 + (3 * len(names) + 3 if truth is not None else 0)) + 1
    rate_hz = median_rate_hz(recovery.arm.t_s) if len(recovery.arm) > 1 else PLAIN_HZ
    rate_hz = min(rate_hz if np.isfinite(rate_hz) else PLAIN_HZ, MOST_HZ)
    count = int(np.clip((end - start) * rate_hz, 2, max(most_bytes / width, 2)))
    t = np.linspace(start, end, count)
    tip, covariance = _tip(recovery)
    arm: dict[str, Any] = {
        "name": recovery.side or recovery.name,
        "names": names,
        "tip": tip,
        "start": start,
        "step": (end - start) / (count - 1),
        "count": count,
        "gaps": [[float(gap.start_s), float(gap.end_s)] for gap in recovery.gaps],
        "untrusted": [[start, end] for start, end in untrusted_times(recovery)],
        "sensor": packed(interpolate(recovery.t_s, recovery.position, t)),
    }
    if names:
        joints = [interpolate(recovery.t_s, recovery.joints[name], t) for name in names]
        arm["joints"] = packed(np.concatenate(joints, axis=1))
        arm |= _camera(recovery, names, t)
    if truth is not None and len(truth) > 1:
        columns = [truth.joints.get(name) for name in names]
        stacked = [np.full((len(truth), 3), np.nan) if each is None else each for each in columns]
        reference = np.concatenate([*stacked, truth.position], axis=1)
        arm["truth"] = packed(interpolate(truth.t_s, reference, t))
    if covariance is not None and recovery.trusted.any():
        row = np.searchsorted(recovery.t_s, t).clip(max=len(recovery) - 1)
        roots = _roots(covariance[row])
        radius = error_radius(covariance[row])[:, None].clip(max=LARGEST_SIGMA_M)
        roots[~recovery.trusted[row]] = radius[~recovery.trusted[row]] = np.nan
        arm |= {"sigma": packed(roots), "within": packed(radius)}
    return arm


def _tip(recovery: Recovery) -> tuple[str, FloatArray | None]:
    """The point whose path and sigma are shown, and its covariance (N, 3, 3) where it is stated."""
    for joint in ("wrist", "hand", "elbow"):
        if joint in recovery.joints:
            return joint, recovery.joint_covariance.get(joint)
    return "sensor", recovery.pose_covariance[:, :3, :3]


def _camera(recovery: Recovery, names: Sequence[str], t: FloatArray) -> dict[str, Any]:
    """The camera's own joints at the nearest frame, none where that is far; which it called tracked."""
    arm = recovery.arm
    if len(arm) < 2:
        return {}
    after = np.searchsorted(arm.t_s, t).clip(1, len(arm) - 1)
    row = np.where(t - arm.t_s[after - 1] < arm.t_s[after] - t, after - 1, after)
    near = np.abs(arm.t_s[row] - t) < 1.5 * max(1 / median_rate_hz(arm.t_s), t[1] - t[0])
    joints = [np.where(near[:, None], arm.joint(name)[row], np.nan) for name in names]
    bits = sum(arm.tracked(name)[row].astype(np.uint8) << k for k, name in enumerate(names))
    tracked = b64encode(np.asarray(bits, np.uint8).tobytes()).decode("ascii")
    return {"camera": packed(np.concatenate(joints, axis=1)), "tracked": tracked}


def _roots(covariance: FloatArray) -> FloatArray:
    """Lower Cholesky factors (n, 6) of covariances (n, 3, 3): xx, yx, yy, zx, zy, zz; nan stays nan."""
    roots = np.full((len(covariance), 6), np.nan)
    rows = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    values, axes = np.linalg.eigh(covariance[rows])
    values = np.clip(values, 1e-12, LARGEST_SIGMA_M**2)
    factor = np.linalg.cholesky((axes * values[:, None, :]) @ np.swapaxes(axes, 1, 2))
    lower = np.tril_indices(3)
    roots[rows] = factor[:, lower[0], lower[1]]
    return roots


def _extent(recovery: Recovery) -> FloatArray:
    """Some of the points (n, 3) that must be in sight."""
    rows = np.linspace(0, len(recovery) - 1, min(len(recovery), 2000)).astype(int)
    joints = [recovery.joints[name][rows] for name in CHAIN if name in recovery.joints]
    return np.concatenate([recovery.position[rows], *joints])


def _switches(arms: Sequence[dict[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """What a reader can switch off: name, words and colour."""
    sound = any("sigma" in arm or not arm["untrusted"] for arm in arms)
    colour = "var(--seen)" if sound else "var(--untrusted)"
    yield "path", f"path of the {arms[0]['tip']}", colour
    yield "trail", "last 2 s", colour
    for key, name, words, own in (
        ("sigma", "sigma", "95 % region", "var(--recovered)"),
        ("camera", "camera", "camera's skeleton", "var(--ghost)"),
        ("truth", "reference", "reference", "var(--truth)"),
    ):
        if any(key in arm for arm in arms):
            yield name, words, own


#: Largest number of the packed values, and the one that marks a missing value.
_LARGEST, _NOTHING = 32000, -32768


def packed(values: FloatArray) -> dict[str, Any]:
    """Numbers (n, c) as 16 bits each: their scale, one offset per column, base64; nan stays nothing."""
    values = np.asarray(values, float)
    finite = np.isfinite(values)
    low = np.min(np.where(finite, values, np.inf), axis=0, initial=np.inf)
    high = np.max(np.where(finite, values, -np.inf), axis=0, initial=-np.inf)
    some = np.isfinite(low)
    offset = np.where(some, 0.5 * (np.where(some, low, 0.0) + np.where(some, high, 0.0)), 0.0)
    scale = max(float(np.max(np.where(some, high - offset, 0.0), initial=0.0)) / _LARGEST, 1e-9)
    whole = np.where(finite, np.rint((np.where(finite, values, 0.0) - offset) / scale), _NOTHING)
    data = b64encode(whole.astype("<i2").tobytes()).decode("ascii")
    return {"data": data, "scale": scale, "offset": [float(f"{value:.9g}") for value in offset]}


def upwards(frame: CameraFrame | None, gravity: FloatArray | None = None) -> FloatArray:
    """Unit vector (3,) upwards in {K}: by gravity where it is known, else by the camera's convention."""
    if gravity is not None and np.isfinite(gravity).all() and np.linalg.norm(gravity) > 0:
        return -unit(gravity)
    return -(frame or CameraFrame.ZUP).down


def _seen_from(points: FloatArray, up: FloatArray, frame: CameraFrame | None) -> FloatArray:
    """Direction (3,) from which to look: from the camera's side, a little from above and beside it."""
    points = points[np.isfinite(points).all(axis=1)]
    back = -np.median(points, axis=0) if len(points) else np.array([1.0, 1.0, 0.5])
    if frame not in (CameraFrame.KINECT, CameraFrame.OPTICAL):
        back = np.array([1.2, -1.4, 0.3])
    back = back - up * (back @ up)
    length = np.linalg.norm(back)
    back = back / length if length > 1e-9 else unit(np.cross(up, [0.3, 0.5, 0.8]))
    return 2.3 * back + 0.7 * up + 0.9 * np.cross(up, back)


def view_of(points: FloatArray, up: FloatArray, eye: FloatArray) -> dict[str, Any]:
    """Where to look at points (n, 3) from so that all but a few outliers of them are in sight."""
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        points = np.zeros((1, 3))
    low, high = np.percentile(points, (0.5, 99.5), axis=0)
    center = 0.5 * (low + high)
    away = np.linalg.norm(points - center, axis=1)
    radius = max(1.05 * float(np.percentile(away, 99.5)), 0.05)
    return {
        "up": up.tolist(),
        "eye": eye.tolist(),
        "center": center.tolist(),
        "radius": radius,
        "aspect": 0.56,
        "zoom": 1.15,
        "low": float(np.percentile(points @ up, 0.5)),
    }
