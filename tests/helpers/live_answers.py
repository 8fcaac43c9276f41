"""A live answer whose arm hangs, bent at the elbow."""

from __future__ import annotations

import numpy as np

from smoother.live.answers import LiveEstimate, LiveOutput, LiveState
from smoother.recording import CameraFrame
from smoother.streams.arrivals import SourceInfo

JOINTS = ("shoulder", "elbow", "wrist")
INFO = SourceInfo({"forearm": "wrist"}, "kinect", "right", JOINTS, 0, CameraFrame.OPTICAL)


def answer(t_s: float, bent_deg: float) -> LiveOutput:
    """An upper arm that hangs, and a forearm bent so far in the camera's plane."""
    bent = np.radians(bent_deg)
    shoulder = np.array([0.0, 0.0, 2.0])
    elbow = shoulder + np.array([0.0, 0.3, 0.0])
    wrist = elbow + 0.25 * np.array([np.sin(bent), np.cos(bent), 0.0])
    joints = {"shoulder": shoulder, "elbow": elbow, "wrist": wrist}
    spread = dict.fromkeys(joints, 1e-4 * np.eye(3))
    estimate = LiveEstimate(
        t_s, "now", LiveState.VISIBLE, None, wrist,
        np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), 1e-4 * np.eye(6), joints, spread,
    )  # fmt: skip
    return LiveOutput(t_s, LiveState.VISIBLE, estimate)
