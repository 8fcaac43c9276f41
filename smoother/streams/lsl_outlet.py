"""The recovered arm as streams of the Lab Streaming Layer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..array_types import FloatArray
from ..live.estimate import LiveEstimate, LiveOutput, LiveState
from ..measurements.visibility import Gap
from ..recording import JOINTS
from .arrivals import FrameRows, SourceInfo
from .lsl_library import lsl_module

#: What the channel `state` says.
STATES = {LiveState.CALIBRATING: 0, LiveState.VISIBLE: 1, LiveState.GAP: 2, LiveState.LOST: 3}
_AXES = "XYZ"


class LslOutlet:
    """Sends `now` as a stream NAME and `settled` as NAME_settled, of type MoCap, a sample a step.

    Of each joint x, y, z and the largest sigma of an axis, of the IMU its orientation as well; then `state`
    (0 calibrating, 1 visible, 2 gap, 3 the IMU is lost), `gap` (s since it began, 0 outside) and `lag` (s
    before the present). Joints without an answer are nan. Stamps are this computer's LSL clock at the moment
    that the sample speaks of.

    Parameters
    ----------
    name : str
        Of the stream.
    info : SourceInfo
        Of the session.
    """

    def __init__(self, name: str, info: SourceInfo):
        self._start_s = info.lsl_start_s
        self._side = f"_{info.side}" if info.side else ""
        self._outlets = {
            "now": self._outlet(name, info),
            "settled": self._outlet(f"{name}_settled", info),
        }

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """Send what a step answered; frames, gaps and events have no place in a stream of numbers."""
        start_s = self._start_s
        if start_s is None:  # a recording is played: the step's present is now
            start_s = lsl_module().local_clock() - output.now_s
        for kind, estimate in (("now", output.now), ("settled", output.settled)):
            t_s = output.now_s if estimate is None else estimate.t_s
            values = self._values(estimate, output)
            self._outlets[kind].push_sample(values, start_s + t_s)

    def close(self) -> None:
        """Let all receivers go."""
        self._outlets.clear()

    def _outlet(self, name: str, info: SourceInfo):  # type: ignore[no-untyped-def]
        lsl = lsl_module()
        channels = self._channels()
        stream = lsl.StreamInfo(
            name, "MoCap", len(channels), lsl.IRREGULAR_RATE, lsl.cf_double64, f"unocclude-{name}"
        )
        described = stream.desc().append_child("channels")
        for label, marker, kind, unit in channels:
            channel = described.append_child("channel")
            texts = (("label", label), ("marker", marker), ("type", kind), ("unit", unit))
            for key, text in texts:
                if text:
                    channel.append_child_value(key, text)
        acquisition = stream.desc().append_child("acquisition")
        for key, text in (("manufacturer", "unocclude"), ("imu", info.imu), ("skeleton", info.skeleton)):
            acquisition.append_child_value(key, text)
        return lsl.StreamOutlet(stream)

    def _channels(self) -> list[tuple[str, str, str, str]]:
        """Label, marker, type and unit of every channel."""
        channels = []
        for joint in ("imu", *JOINTS):
            marker = joint + self._side
            channels += [(f"{marker}_{axis.lower()}", marker, f"Position{axis}", "meters") for axis in _AXES]
            channels.append((f"{marker}_sigma", "", "Sigma", "meters"))
        marker = "imu" + self._side
        turns = zip("wxyz", "ABCD", strict=True)
        channels += [
            (f"{marker}_q{axis}", marker, f"Orientation{letter}", "quaternion") for axis, letter in turns
        ]
        channels.append((f"{marker}_sigma_deg", "", "Sigma", "degrees"))
        return [
            *channels,
            ("state", "", "State", "0 calibrating, 1 visible, 2 gap, 3 lost"),
            ("gap", "", "Time", "seconds"),
            ("lag", "", "Time", "seconds"),
        ]

    def _values(self, estimate: LiveEstimate | None, output: LiveOutput) -> list[float]:
        nothing = [np.nan] * 4
        if estimate is None:
            values = [*nothing * (1 + len(JOINTS)), *nothing, np.nan]
            return [*values, float(STATES[output.state]), 0.0, 0.0]
        values = [*estimate.position.tolist(), _largest_sigma(estimate.pose_covariance[:3, :3])]
        for joint in JOINTS:
            if joint in estimate.joints:
                covariance = estimate.joint_covariance[joint]
                values += [*estimate.joints[joint].tolist(), _largest_sigma(covariance)]
            else:
                values += nothing
        values += [*estimate.quaternion.tolist(), estimate.sigma_deg]
        since = 0.0 if estimate.since_s is None else estimate.t_s - estimate.since_s
        return [*values, float(STATES[estimate.state]), since, output.now_s - estimate.t_s]


def _largest_sigma(covariance: FloatArray) -> float:
    """Standard deviation (m) on the worst axis of a covariance (3, 3)."""
    return float(np.sqrt(np.diag(covariance).max()))
