"""A stand-in for the live smoother where a test is about streams: it answers what the camera saw last."""

from __future__ import annotations

import numpy as np

from smoother.live.answers import LiveEstimate, LiveOutput, LiveState
from smoother.recording import JOINTS, CameraFrame, JointState
from smoother.streams.arrivals import SourceInfo

INFO = SourceInfo({"forearm": "wrist"}, "kinect", "right", JOINTS[:3], 0, CameraFrame.OPTICAL)


def estimate(t_s, kind, state, since_s, joints) -> LiveEstimate:
    """An answer with the IMU in the wrist."""
    spread = dict.fromkeys(joints, 1e-4 * np.eye(3))
    return LiveEstimate(
        t_s, kind, state, since_s, joints["wrist"], np.array([1.0, 0.0, 0.0, 0.0]),
        np.zeros(3), 1e-4 * np.eye(6), joints, spread,
    )  # fmt: skip


def answer(t_s: float, bent_deg: float) -> LiveOutput:
    """An upper arm that hangs, and a forearm bent so far in the camera's plane."""
    bent, shoulder = np.radians(bent_deg), np.array([0.0, 0.0, 2.0])
    elbow = shoulder + np.array([0.0, 0.3, 0.0])
    wrist = elbow + 0.25 * np.array([np.sin(bent), np.cos(bent), 0.0])
    joints = {"shoulder": shoulder, "elbow": elbow, "wrist": wrist}
    return LiveOutput(t_s, LiveState.VISIBLE, estimate(t_s, "now", LiveState.VISIBLE, None, joints))


class CameraEcho:
    """Calibrates for a second, then repeats the last frame; without a tracked wrist it is a gap."""

    def __init__(self, *_, **__):
        self.imus, self.frames, self.steps = {}, [], 0
        self._since = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def add_imu(self, samples, segment="forearm"):
        self.imus.setdefault(segment, []).append(samples)

    def add_frame(self, frame):
        self.frames.append(frame)

    def column(self, name, segment="forearm"):
        """All that came of an IMU, in the order in which it came."""
        return np.concatenate([getattr(samples, name) for samples in self.imus[segment]])

    def step(self, now_s):
        self.steps += 1
        if not self.frames or now_s - self.frames[0].arrival_s < 1.0:
            return LiveOutput(now_s, LiveState.CALIBRATING, calibration="move the arm")
        tracked = [f for f in self.frames[-60:] if f.state[2] == JointState.TRACKED]
        is_gap = self.frames[-1].state[2] != JointState.TRACKED
        self._since = (self._since or now_s) if is_gap else None
        if not tracked:
            return LiveOutput(now_s, LiveState.LOST)
        frame = tracked[-1]
        joints = {j: frame.position[i] for i, j in enumerate(JOINTS) if np.isfinite(frame.position[i]).all()}
        state = LiveState.GAP if is_gap else LiveState.VISIBLE

        now, settled = (
            estimate(t_s, kind, state, self._since, joints)
            for t_s, kind in ((now_s, "now"), (now_s - 0.2, "settled"))
        )
        return LiveOutput(now_s, state, now, settled, 0.012, 0.001, 0.1)
