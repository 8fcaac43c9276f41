"""The live smoother as methods: a recording played into it on a simulated clock, the answers a recovery."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..linalg import interpolate
from ..live.buffers import ImuBatch, SkeletonFrame
from ..live.estimate import LiveEstimate
from ..recording import JOINTS, Recording
from ..result import Recovery

#: Answers are asked for at this rate, Hz, and interpolated to the IMU's times.
RATE_HZ = 30.0
#: A self-calibration in the background takes so many steps until its answer is there.
STEPS_OF_CALIBRATION = 15
#: Between answers farther apart than this there is none, s.
APART_S = 0.2

#: A method: recording in, recovery out.
Method = Callable[[Recording], Recovery]


class LivePlay:
    """A recording played once into the live smoother, for several methods.

    Parameters
    ----------
    graph : callable
        The offline method; its clock says when frames arrive, and its gaps are scored.
    calibration : ArmCalibration or None
        What is known beforehand.
    config : Config
    latency_s : float, s
        From a frame's moment to its arrival.
    lag_s : float, s
        Of `live-settled`.
    """

    def __init__(
        self,
        graph: Method,
        calibration: ArmCalibration | None,
        config: Config,
        latency_s: float = 0.1,
        lag_s: float = 0.2,
    ) -> None:
        self._graph, self._calibration, self._config = graph, calibration, config
        self._latency_s, self._lag_s = latency_s, lag_s
        self._recording: Recording | None = None
        self._answers: dict[str, list[tuple[float, FloatArray]]] = {}

    def method(self, kind: str) -> Method:
        """The method that answers with "now" or "settled"."""

        def run(recording: Recording) -> Recovery:
            graph = self._graph(recording)
            if self._recording is not recording:
                self._answers = self._played(recording, graph.clock_offset_s)
                self._recording = recording
            return _as_recovery(graph, self._answers[kind], f"live-{kind}")

        return run

    def _played(self, recording: Recording, offset_s: float) -> dict[str, list[tuple[float, FloatArray]]]:
        """Time and values (position, quaternion, velocity, covariance, joints) of each answer."""
        from ..live.calibrations import InlineCalibrator
        from ..live.smoother import LiveSmoother

        answers: dict[str, list[tuple[float, FloatArray]]] = {"now": [], "settled": []}
        smoother = LiveSmoother(
            recording.side,
            self._calibration,
            self._config,
            self._lag_s,
            recording.gravity_hint,
            recording.camera_frame,
            InlineCalibrator(STEPS_OF_CALIBRATION),
        )
        with smoother as live:
            for now_s, imu, frames in arrivals(recording, offset_s, self._latency_s):
                for batch in imu:
                    live.add_imu(batch)
                for frame in frames:
                    live.add_frame(frame)
                output = live.step(now_s)
                for kind, estimate in (("now", output.now), ("settled", output.settled)):
                    if estimate is not None:
                        answers[kind].append((estimate.t_s, _values(estimate)))
        return answers


def arrivals(
    recording: Recording, offset_s: float, latency_s: float
) -> Iterator[tuple[float, list[ImuBatch], list[SkeletonFrame]]]:
    """Step by step what has arrived since the last one: the time, IMU batches, frames."""
    imu, arm = recording.imu, recording.arm
    arrival_s = np.asarray(arm.t_s) + offset_s + latency_s
    first = frame = 0
    for now_s in np.arange(float(imu.t_s[0]), float(imu.t_s[-1]), 1.0 / RATE_HZ).tolist():
        last = int(np.searchsorted(imu.t_s, now_s, side="right"))
        rows = slice(first, last)
        batch = ImuBatch(np.array(imu.t_s[rows]), np.array(imu.acc[rows]), np.array(imu.gyro[rows]))
        until = int(np.searchsorted(arrival_s, now_s, side="right"))
        frames = [
            SkeletonFrame(float(arm.t_s[k]), float(arrival_s[k]), np.array(arm.position[k]), arm.state[k])
            for k in range(frame, until)
        ]
        yield now_s, [batch] if last > first else [], frames
        first, frame = last, until


def _values(estimate: LiveEstimate) -> FloatArray:
    """Position, quaternion, velocity, pose covariance, joints and their covariances in one row."""
    joints = [estimate.joints.get(joint, np.full(3, np.nan)) for joint in JOINTS]
    spreads = [estimate.joint_covariance.get(joint, np.full((3, 3), np.nan)).ravel() for joint in JOINTS]
    return np.concatenate(
        [
            estimate.position,
            estimate.quaternion,
            estimate.velocity,
            estimate.pose_covariance.ravel(),
            *joints,
            *spreads,
        ]
    )


def _as_recovery(graph: Recovery, answers: list[tuple[float, FloatArray]], name: str) -> Recovery:
    """The answers at the times of the graph's recovery; nan before the first."""
    if len(answers) < 2:
        raise UnoccludeError(
            f"{graph.name}: too short for {name}, which calibrates itself on the first seconds"
        )
    rows = dict(answers)
    t, values = np.array(list(rows)), np.array(list(rows.values()))
    order = np.argsort(t)
    t, values = t[order], values[order]
    flips = np.where((values[1:, 3:7] * values[:-1, 3:7]).sum(axis=1) < 0, -1.0, 1.0)
    values[1:, 3:7] *= np.cumprod(flips)[:, None]
    at = interpolate(t, values, graph.t_s)
    right = np.clip(np.searchsorted(t, graph.t_s), 1, len(t) - 1)
    unknown = (graph.t_s < t[0]) | (graph.t_s > t[-1]) | (t[right] - t[right - 1] > APART_S)
    at[unknown] = np.nan
    quaternion = at[:, 3:7] / np.linalg.norm(at[:, 3:7], axis=1, keepdims=True)
    joints = at[:, 46 : 46 + 3 * len(JOINTS)].reshape(-1, len(JOINTS), 3)
    spreads = at[:, 46 + 3 * len(JOINTS) :].reshape(-1, len(JOINTS), 3, 3)
    columns = {joint: JOINTS.index(joint) for joint in graph.joints}
    return replace(
        graph,
        method=name,
        position=at[:, :3],
        quaternion=quaternion,
        velocity=at[:, 7:10],
        pose_covariance=at[:, 10:46].reshape(-1, 6, 6),
        velocity_covariance=np.full((len(at), 3, 3), np.nan),
        joints={joint: joints[:, column] for joint, column in columns.items()},
        joint_covariance={joint: spreads[:, column] for joint, column in columns.items()},
    )
