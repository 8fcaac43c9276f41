"""The arms in motion: what the page's player is given of one or several recoveries."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..linalg import interpolate, median_rate_hz
from ..recording import CameraFrame, Truth
from ..result import Recovery
from ..result.untrusted import untrusted_times
from .path3d import CHAIN, instants
from .sheet import Html, data_block, headed
from .space import packed, seen_from, switch, upwards, view_of
from .style import axis_names

#: All arms together take no more than this before they are written as text; longer ones are decimated.
MOST_BYTES = 5_500_000
#: No more frames a second than this, and so many where there is no camera.
MOST_HZ, PLAIN_HZ = 60.0, 30.0
#: A larger standard deviation is drawn as this one, m.
LARGEST_SIGMA_M = 3.0


def player(
    heading: str,
    caption: Html,
    arms: Sequence[tuple[Recovery, Truth | None]],
    frame: CameraFrame | None,
) -> str:
    """A heading, a caption and the player; "" where no arm has an answer.

    Parameters
    ----------
    heading : str
        Above it.
    caption : Html
        Below the heading.
    arms : sequence of (Recovery, Truth or None)
        Arms in one camera frame and on one clock, each with its reference.
    frame : CameraFrame, optional
        The directions of the camera's axes.

    Returns
    -------
    html : str
        The section, with its data.
    """
    arms = [(recovery, truth) for recovery, truth in arms if len(recovery) > 1 and recovery.answered.any()]
    if not arms:
        return ""
    played = [played_arm(recovery, truth, MOST_BYTES / len(arms)) for recovery, truth in arms]
    first = arms[0][0]
    points = np.concatenate([_extent(recovery) for recovery, _ in arms])
    up = upwards(frame, first.gravity_direction)
    view = view_of(points, up, seen_from(points, up, frame))
    at = [float(first.t_s[row]) for hidden in (True, False) for row in instants(first, hidden)]
    values = {"view": view, "arms": played, "axes": list(axis_names(frame)), "instants": at}
    view["zoom"] = 1.15
    return (
        f'<div class="together">{headed(heading, caption)}<div class="space player">'
        f'<canvas tabindex="0" role="img" aria-label="The arm in space, at the time of the slider"></canvas>'
        f"{_controls(played)}{data_block(values)}</div></div>"
    )


def played_arm(recovery: Recovery, truth: Truth | None, most_bytes: float) -> dict[str, Any]:
    """One arm on an even grid of times, about as many as the camera has frames.

    Parameters
    ----------
    recovery : Recovery
        Of at least two samples.
    truth : Truth, optional
        Its reference.
    most_bytes : float
        Longer recordings get fewer frames a second than the camera had.

    Returns
    -------
    arm : dict
        Plain values, tracks packed: `joints`, `camera`, `truth` (n, 3 joints), `sensor` (n, 3), `sigma`
        (n, 6; lower Cholesky factor of the covariance of the point `tip`; nothing where the answer is not to
        be trusted), `tracked` (n, a bit a joint). `untrusted` has start and end of the times that are not.
    """
    names = [joint for joint in CHAIN if joint in recovery.joints]
    start, end = float(recovery.t_s[0]), float(recovery.t_s[-1])
    width = 2 * (6 * len(names) + 9 + (3 * len(names) + 3 if truth is not None else 0)) + 1
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
        roots[~recovery.trusted[row]] = np.nan
        arm["sigma"] = packed(roots)
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
    """Legend, slider with the gaps marked on it, buttons, and what the keys do."""
    sound = any("sigma" in arm or not arm["untrusted"] for arm in arms)
    colour = "var(--seen)" if sound else "var(--untrusted)"
    switches = [("path", f"path of the {arms[0]['tip']}", colour), ("trail", "last 2 s", colour)]
    if any("sigma" in arm for arm in arms):
        switches.append(("sigma", "2 sigma", "var(--recovered)"))
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
        '<div class="controls"><button type="button" data-do="play" aria-pressed="false">▶ Play</button>'
        '<button type="button" data-do="previous">◀ gap</button>'
        '<button type="button" data-do="next">gap ▶</button>'
        f'<label>speed <select data-do="speed">{speeds}</select></label>'
        '<span>look from <button type="button" data-do="camera">camera</button>'
        ' <button type="button" data-do="side">side</button>'
        ' <button type="button" data-do="top">above</button></span></div>'
        '<p class="now" aria-live="off"></p>'
        f'<div class="legend">{"".join(switch(*each) for each in switches)}</div>'
        '<p class="keys">Keys: space plays, left and right go a frame (with Shift a second), g goes to the'
        " next gap, Shift+g to the one before. Drag to turn, Ctrl and the wheel (or two fingers) to come"
        " closer, double-click to come back. A click into a plot over time moves the arm there.</p>"
    )
