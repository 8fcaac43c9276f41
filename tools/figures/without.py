"""The graph with one ingredient taken away: the same gaps, nothing calibrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation

from smoother import smooth
from smoother.config import Config
from smoother.measurements.clock import constant_clock
from smoother.recording import Recording
from smoother.result import Recovery

#: How far a tripod's camera is taken to be off the level, degrees.
TILT_DEG = 3.0


def without_shoulder(recording: Recording, config: Config) -> Recovery:
    """No upper-arm length: the elbow is held to no sphere about the shoulder."""
    return smooth(_hidden(recording, "shoulder"), None, config)


def without_wrist(recording: Recording, config: Config) -> Recovery:
    """Neither wrist nor hand: of the forearm the camera sees the elbow alone, in the gaps and beside them."""
    return smooth(_hidden(recording, "wrist", "hand"), None, config)


def without_gravity(recording: Recording, config: Config) -> Recovery:
    """Gravity not solved, but taken from the camera's axes, which are off the level by `TILT_DEG`."""
    assert recording.camera_frame is not None
    tilt = Rotation.from_euler("xz", [TILT_DEG / np.sqrt(2)] * 2, degrees=True)
    down = tilt.apply(recording.camera_frame.down)
    return smooth(replace(recording, gravity_hint=down, gravity_sigma_rad=1e-4), None, config)


def without_clock(recording: Recording, config: Config) -> Recovery:
    """Clock offset not solved: the camera's stamps are believed as they came."""
    place = "smoother.selfcal.rounds"
    with (
        patch(f"{place}.constant_clock", lambda *_: constant_clock(0.0, 1e-4)),
        patch(f"{place}.refined_clocks", lambda clocks, *_: tuple(clocks)),
    ):
        return smooth(recording, None, config)


def _hidden(recording: Recording, *joints: str) -> Recording:
    everywhere = np.ones(len(recording.arm), dtype=bool)
    return replace(recording, arm=recording.arm.hide(everywhere, joints))


WITHOUT: dict[str, Callable[[Recording, Config], Recovery]] = {
    "no upper-arm length": without_shoulder,
    "no wrist": without_wrist,
    f"gravity {TILT_DEG:g} degrees off": without_gravity,
    "clock offset not solved": without_clock,
}
