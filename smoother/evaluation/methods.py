"""The methods by name: the graph, the baselines that start from what it estimates, the live smoother.

The live smoother is played a recording on a simulated clock; its answers are a recovery.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..baselines.registry import BASELINES, DEFAULT_ORIENTATION, LIVE_BASELINES, recover
from ..errors import UnoccludeError

if TYPE_CHECKING:
    from ..array_types import FloatArray
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..live.answers import LiveEstimate
    from ..live.buffers import SkeletonFrame
    from ..measurements.clock import Clock
    from ..recording import ImuStream, Recording
    from ..result import Recovery
    from ..runtime.pool import Progress

    #: By kind ("now" or "settled"), every answer of the live smoother.
    LiveAnswers = dict[str, list[LiveEstimate]]

    Method = Callable[[Recording], Recovery]


T = TypeVar("T")

GRAPH = "graph"
#: Every method, ours first, then the baselines, the strongest first.
METHODS = (GRAPH, *BASELINES)
#: What `--live` adds: the live smoother's two answers, then what could be shown without it.
LIVE_SMOOTHER = {"live-now": "now", "live-settled": "settled"}
LIVE_METHODS = (*LIVE_SMOOTHER, *LIVE_BASELINES)


class Shared(Generic[T]):
    """What is made of a recording, made once and kept until another recording comes; failures too."""

    def __init__(self, make: Callable[..., T], **here: object) -> None:
        self._make, self._here = make, here
        self._recording: Recording | None = None
        self._answer: T | UnoccludeError | None = None

    def __getstate__(self) -> dict[str, object]:
        """In another process there is no progress to report, and the answer is in its memory."""
        return {**self.__dict__, "_here": {}}

    def __call__(self, recording: Recording) -> T:
        """What is made of this very object."""
        if self._recording is not recording or self._answer is None:
            try:
                self._answer = self._make(recording, **self._here)
            except UnoccludeError as error:
                self._answer = error
            self._recording = recording
        if isinstance(self._answer, UnoccludeError):
            raise self._answer
        return self._answer


def make_methods(
    names: Sequence[str],
    calibration: ArmCalibration | None,
    config: Config,
    orientation: str = DEFAULT_ORIENTATION,
    progress: Progress | None = None,
    clock: Clock | None = None,
    latency_s: float = 0.1,
) -> dict[str, Method]:
    """The chosen methods by name; the baselines start from what the graph estimates, which they share.

    `orientation` is the filter of the baselines that need one.
    """
    from ..smoothing import smooth

    solve = partial(smooth, calibration=calibration, config=config, clock=clock)
    graph = Shared(solve, progress=progress)
    played = Shared(partial(play, graph=graph, calibration=calibration, config=config, latency_s=latency_s))

    def method(name: str) -> Method:
        if name == GRAPH:
            return graph
        if name in LIVE_SMOOTHER:
            return partial(by_live, LIVE_SMOOTHER[name], played, graph)
        options = {"latency_s": latency_s} if name in LIVE_BASELINES else {}
        return partial(_by_baseline, name, graph, orientation, options)

    return {name: method(name) for name in names}


def _by_baseline(
    name: str, graph: Method, orientation: str, options: Mapping[str, Any], recording: Recording
) -> Recovery:
    return recover(recording, graph(recording), name, orientation, options)


#: Answers are asked for at this rate, Hz, and interpolated to the IMU's times.
RATE_HZ = 30.0
#: Delay of the settled answer, s.
LAG_S = 0.2
#: A self-calibration in the background takes this many steps until its answer is there.
STEPS_OF_CALIBRATION = 15
#: Between answers farther apart than this there is none, s.
APART_S = 0.2


def play(
    recording: Recording,
    graph: Method,
    calibration: ArmCalibration | None,
    config: Config,
    latency_s: float = 0.1,
) -> LiveAnswers:
    """What the live smoother answers to a recording that arrives step by step."""
    from ..live.calibrations import InlineCalibrator
    from ..live.smoother import LiveSmoother

    answers: LiveAnswers = {"now": [], "settled": []}
    calibrator = InlineCalibrator(STEPS_OF_CALIBRATION)
    given = (recording.gravity_hint, recording.camera_frame, calibrator)
    with LiveSmoother(recording.side, calibration, config, LAG_S, *given) as live:
        for now_s, imu, frames in arrivals(recording, graph(recording).clock_offset_s, latency_s):
            live.add_imu(imu)
            for frame in frames:
                live.add_frame(frame)
            output = live.step(now_s)
            for kind, own in answers.items():
                if (estimate := getattr(output, kind)) is not None:
                    own.append(estimate)
    return answers


def arrivals(
    recording: Recording, offset_s: float, latency_s: float
) -> Iterator[tuple[float, ImuStream, list[SkeletonFrame]]]:
    """Step by step what has arrived since the last one: the time, samples, frames."""
    import numpy as np

    from ..live.buffers import SkeletonFrame

    imu, arm = recording.imu, recording.arm
    arrival_s = np.asarray(arm.t_s) + offset_s + latency_s
    first = frame = 0
    for now_s in np.arange(float(imu.t_s[0]), float(imu.t_s[-1]), 1.0 / RATE_HZ).tolist():
        last = int(np.searchsorted(imu.t_s, now_s, side="right"))
        until = int(np.searchsorted(arrival_s, now_s, side="right"))
        frames = [
            SkeletonFrame(float(arm.t_s[k]), float(arrival_s[k]), np.array(arm.position[k]), arm.state[k])
            for k in range(frame, until)
        ]
        yield now_s, imu.select(slice(first, last)), frames
        first, frame = last, until


def by_live(
    kind: str, played: Callable[[Recording], LiveAnswers], graph: Method, recording: Recording
) -> Recovery:
    """The live answers at the times of the graph's recovery; nan before the first."""
    import numpy as np

    from ..linalg import interpolate
    from ..measures.motion import one_sign

    solved, answers = graph(recording), played(recording)[kind]
    if len(answers) < 2:
        raise UnoccludeError(
            f"{solved.name}: too short for live-{kind}, which calibrates itself on the first seconds"
        )
    by_time = {answer.t_s: answer for answer in answers}
    t = np.array(sorted(by_time))
    answers = [by_time[t_s] for t_s in t.tolist()]
    right = np.clip(np.searchsorted(t, solved.t_s), 1, len(t) - 1)
    unknown = (solved.t_s < t[0]) | (solved.t_s > t[-1]) | (t[right] - t[right - 1] > APART_S)

    def column(values: list[FloatArray]) -> FloatArray:
        at = interpolate(t, np.array(values), solved.t_s)
        at[unknown] = np.nan
        return at

    quaternion = column(list(one_sign(np.array([answer.quaternion for answer in answers]))))
    no_place, no_spread = np.full(3, np.nan), np.full((3, 3), np.nan)
    return replace(
        solved,
        method=f"live-{kind}",
        position=column([answer.position for answer in answers]),
        quaternion=quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        velocity=column([answer.velocity for answer in answers]),
        pose_covariance=column([answer.pose_covariance for answer in answers]),
        velocity_covariance=np.full((len(solved), 3, 3), np.nan),
        joints={
            name: column([each.joints.get(name, no_place) for each in answers]) for name in solved.joints
        },
        joint_covariance={
            name: column([each.joint_covariance.get(name, no_spread) for each in answers])
            for name in solved.joints
        },
    )
