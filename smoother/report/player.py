"""The arm on the page: its points, flat views of its path, and what the page's player is given."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..array_types import BoolArray, FloatArray, IntArray
from ..error_radius import error_radius
from ..linalg import interpolate, median_rate_hz
from ..recording import CameraFrame, Truth
from ..result import Recovery
from ..result.untrusted import untrusted_times
from .sheet import Html, data_block, headed
from .space import packed, seen_from, switch, upwards, view_of
from .style import OCCLUDED, TRUTH, UNTRUSTED, VISIBLE, axis_names, curve, decimate, dress, split_line

SENSOR = "sensor"
#: Most camera samples of a point that are drawn.
MOST_DOTS = 1500


@dataclass(frozen=True)
class Point:
    """One point of the arm over time."""

    name: str  # "sensor" (the IMU on the forearm) or a joint
    position: FloatArray  # (n, 3) m: in {K}, at the recovery's times
    sigma: FloatArray  # (n, 3) m: in {K}, at the recovery's times
    camera_t_s: FloatArray  # (f,) and (f, 3) s and m: what the camera tracked, on the IMU's clock
    camera: FloatArray  # (f,) and (f, 3) s and m: what the camera tracked, on the IMU's clock
    truth_t_s: FloatArray  # (m,) and (m, 3) s and m: the reference, empty without one
    truth: FloatArray  # (m,) and (m, 3) s and m: the reference, empty without one


def points(recovery: Recovery, truth: Truth | None) -> list[Point]:
    """The points to show, the one that the camera sees best first."""
    joints = [_joint(recovery, name, truth) for name in ("wrist", "elbow", "hand") if name in recovery.joints]
    sensor = _point(SENSOR, recovery, recovery.position, recovery.sigma_m, "strap", truth, None)
    tracked = [point for point in joints if len(point.camera)]
    return [*tracked[:1], sensor, *tracked[1:2]]


def _joint(recovery: Recovery, name: str, truth: Truth | None) -> Point:
    covariance = recovery.joint_covariance.get(name)
    sigma = np.full((len(recovery), 3), np.nan)
    if covariance is not None:
        sigma = np.sqrt(np.einsum("nii->ni", covariance))
    return _point(name, recovery, recovery.joints[name], sigma, name, truth, name)


def _point(
    name: str,
    recovery: Recovery,
    position: FloatArray,
    sigma: FloatArray,
    joint: str,
    truth: Truth | None,
    truth_joint: str | None,
) -> Point:
    arm = recovery.arm
    tracked = [part.tracked(joint) for part in recovery.frame_batches()]
    frames = np.flatnonzero(np.concatenate(tracked)) if tracked else np.zeros(0, np.int64)
    frames = frames[decimate(np.zeros(len(frames), bool), MOST_DOTS)]
    reference = np.zeros((0, 3))
    if truth is not None:
        reference = truth.position if truth_joint is None else truth.joints.get(truth_joint, reference)
    truth_t = truth.t_s if truth is not None and len(reference) else np.zeros(0)
    return Point(name, position, sigma, arm.t_s[frames], arm.joint(joint)[frames], truth_t, reference)


#: How many arms are drawn.
MOST_ARMS = 8
#: The joints of an arm in a row.
CHAIN = ("shoulder", "elbow", "wrist", "hand")


def flat_views(recovery: Recovery, truth: Truth | None, frame: CameraFrame | None) -> go.Figure:
    """The same path in two flat views: as the camera sees it, and from the side."""
    names = [f"{name}, m" for name in axis_names(frame)]
    # right, up of each view, as (axis, drawn backwards)
    views = {
        CameraFrame.KINECT: (((0, True), (1, False)), ((2, False), (1, False))),
        CameraFrame.OPTICAL: (((0, False), (1, True)), ((2, False), (1, True))),
    }.get(frame or CameraFrame.ZUP, _upright(upwards(frame, recovery.gravity_direction)))
    titles = (
        ("as the camera sees it", "from the side")
        if frame in (CameraFrame.KINECT, CameraFrame.OPTICAL)
        else None
    )
    figure = make_subplots(rows=1, cols=2, subplot_titles=titles)
    index = decimate(recovery.occluded)
    good, distrusted = split_line(recovery.position[index], ~recovery.trusted[index])
    visible, hidden = split_line(good, recovery.occluded[index])
    lines = [("seen", visible, VISIBLE, "solid"), ("recovered", hidden, OCCLUDED, "solid")]
    if np.isfinite(distrusted).any():
        lines = [line for line in lines if np.isfinite(line[1]).any()]
        lines.append(("not to be trusted", distrusted, UNTRUSTED, "dot"))
    if truth is not None and len(truth):
        lines.append(("reference", truth.position[decimate(np.zeros(len(truth), bool))], TRUTH, "dot"))
    for column, ((right, mirrored), (upward, flipped)) in enumerate(views, start=1):
        for name, values, colour, dash in lines:
            line = curve(values[:, right], values[:, upward], name, colour, 1.6, dash, legendgroup=name)
            figure.add_trace(line.update(showlegend=column == 1), row=1, col=column)
        figure.update_xaxes(
            title_text=names[right], autorange="reversed" if mirrored else True, row=1, col=column
        )
        figure.update_yaxes(
            title_text=names[upward],
            autorange="reversed" if flipped else True,
            scaleanchor="x" if column == 1 else "x2",
            row=1,
            col=column,
        )
    return dress(figure, 450, head=75)


def _upright(up: FloatArray) -> tuple[tuple[tuple[int, bool], tuple[int, bool]], ...]:
    """Two views of unnamed axes: the one that gravity says points up is drawn upwards."""
    upright = int(np.argmax(np.abs(up)))
    across = [axis for axis in range(3) if axis != upright]
    return tuple(((axis, False), (upright, bool(up[upright] < 0))) for axis in across)


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
    heading: str,
    caption: Html,
    arms: Sequence[tuple[Recovery, Truth | None]],
    frame: CameraFrame | None,
) -> str:
    """A heading, the player and a caption; "" where no arm has an answer."""
    arms = [(recovery, truth) for recovery, truth in arms if len(recovery) > 1 and recovery.answered.any()]
    if not arms:
        return ""
    played = [played_arm(recovery, truth, MOST_BYTES / len(arms)) for recovery, truth in arms]
    first = arms[0][0]
    points = np.concatenate([_extent(recovery) for recovery, _ in arms])
    up = upwards(frame, first.gravity_direction)
    view = view_of(points, up, seen_from(points, up, frame))
    at = [float(first.t_s[row]) for hidden in (True, False) for row in instants(first, hidden)]
    values: dict[str, Any] = {"view": view, "arms": played, "axes": list(axis_names(frame)), "instants": at}
    view["zoom"] = 1.15
    return (
        f'<div class="together">{headed(heading)}<div class="space player"><div class="stage">'
        f'<canvas tabindex="0" role="img" aria-label="The arm in space, at the time of the slider"></canvas>'
        f"</div>{_controls(played)}{data_block(values)}</div>"
        f'<p class="caption">{caption}</p></div>'
    )


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


def _controls(arms: Sequence[dict[str, Any]]) -> str:
    """Slider with the gaps marked on it, buttons, legend, and what the keys do."""
    sound = any("sigma" in arm or not arm["untrusted"] for arm in arms)
    colour = "var(--seen)" if sound else "var(--untrusted)"
    switches = [("path", f"path of the {arms[0]['tip']}", colour), ("trail", "last 2 s", colour)]
    if any("sigma" in arm for arm in arms):
        switches.append(("sigma", "95 % region", "var(--recovered)"))
    if any("camera" in arm for arm in arms):
        switches.append(("camera", "camera's skeleton", "var(--ghost)"))
    if any("truth" in arm for arm in arms):
        switches.append(("reference", "reference", "var(--truth)"))
    speeds = "".join(
        f'<option value="{speed}"{" selected" if speed == "1" else ""}>{speed} x</option>'
        for speed in ("0.1", "0.25", "0.5", "1", "2", "5", "10")
    )
    return (
        '<div class="time"><div class="marks"></div>'
        '<input type="range" data-do="seek" aria-label="Time"></div>'
        '<p class="now" aria-live="off"></p>'
        '<div class="controls"><button type="button" data-do="play" aria-pressed="false">▶ Play</button>'
        '<button type="button" data-do="previous">◀ gap</button>'
        '<button type="button" data-do="next">gap ▶</button>'
        f'<select data-do="speed" aria-label="Speed">{speeds}</select>'
        '<span class="looks"><span>look from </span><button type="button" data-do="camera">camera</button>'
        ' <button type="button" data-do="side">side</button>'
        ' <button type="button" data-do="behind">behind</button>'
        ' <button type="button" data-do="top">above</button></span></div>'
        f'<div class="legend">{"".join(switch(*each) for each in switches)}</div>'
        '<p class="keys">Keys: space plays, left and right go a frame (with Shift a second), g goes to the'
        " next gap, Shift+g to the one before. Drag to turn, Ctrl and the wheel (or two fingers) to come"
        " closer, double-click to come back. A click into a plot over time moves the arm there.</p>"
    )
