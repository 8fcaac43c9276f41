"""The methods by name: the graph, and the baselines that start from what it estimates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..baselines.registry import BASELINES, DEFAULT_ORIENTATION, LIVE_BASELINES, recover
from ..errors import UnoccludeError

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..measurements.clock import Clock
    from ..recording import Recording
    from ..result import Recovery
    from ..runtime.pool import Progress

    Method = Callable[[Recording], Recovery]


T = TypeVar("T")

GRAPH = "graph"
#: Every method, ours first, then the baselines, the strongest first.
METHODS = (GRAPH, *BASELINES)
#: What `--live` adds: the live smoother's two answers, then what could be shown without it.
LIVE_SMOOTHER = {"live-now": "now", "live-settled": "settled"}
LIVE_METHODS = (*LIVE_SMOOTHER, *LIVE_BASELINES)


@dataclass(frozen=True)
class BaselineSettings:
    """What the command line sets for the baselines."""

    orientation: str = DEFAULT_ORIENTATION  # The filter of those that need one
    options: Mapping[str, Any] = field(default_factory=dict)  # By name

    def for_method(self, name: str) -> dict[str, Any]:
        """The options that a method knows."""
        known = (BASELINES | LIVE_BASELINES)[name].options
        return {key: value for key, value in self.options.items() if key in known}


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


def shared_graph(
    calibration: ArmCalibration | None,
    config: Config,
    progress: Progress | None = None,
    clock: Clock | None = None,
) -> Shared[Recovery]:
    """The graph's recovery of a recording, solved once."""
    from ..smoothing import smooth

    solve = partial(smooth, calibration=calibration, config=config, clock=clock)
    return Shared(solve, progress=progress)


def make_methods(
    names: Sequence[str],
    calibration: ArmCalibration | None,
    config: Config,
    settings: BaselineSettings | None = None,
    progress: Progress | None = None,
    clock: Clock | None = None,
    latency_s: float = 0.1,
) -> dict[str, Method]:
    """The chosen methods by name; the baselines start from what the graph estimates, which they share."""
    from .compare import by_live, play

    graph, settings = (
        shared_graph(calibration, config, progress, clock),
        settings or BaselineSettings(),
    )
    played = Shared(partial(play, graph=graph, calibration=calibration, config=config, latency_s=latency_s))

    def method(name: str) -> Method:
        if name == GRAPH:
            return graph
        if name in LIVE_SMOOTHER:
            return partial(by_live, LIVE_SMOOTHER[name], played, graph)
        options = settings.for_method(name)
        if name in LIVE_BASELINES:
            options["latency_s"] = latency_s
        return partial(_by_baseline, name, graph, settings.orientation, options)

    return {name: method(name) for name in names}


def _by_baseline(
    name: str, graph: Method, orientation: str, options: Mapping[str, Any], recording: Recording
) -> Recovery:
    return recover(recording, graph(recording), name, orientation, options)
