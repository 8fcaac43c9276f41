"""The methods by name: the graph, and the baselines that start from what it estimates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from ..baselines.registry import BASELINES, DEFAULT_ORIENTATION, LIVE_BASELINES
from ..errors import UnoccludeError

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..measurements.clock import Clock
    from ..recording import Recording
    from ..result import Recovery
    from ..runtime.pool import Progress
    from .compare import LivePlay

    Method = Callable[[Recording], Recovery]


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


class SharedGraph:
    """The graph's recovery of a recording, solved once and kept until another recording comes."""

    def __init__(
        self,
        calibration: ArmCalibration | None,
        config: Config,
        progress: Progress | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._calibration, self._config, self._progress = calibration, config, progress
        self._clock = clock
        self._recording: Recording | None = None
        self._answer: Recovery | UnoccludeError | None = None

    def __getstate__(self) -> dict[str, object]:
        """In another process there is no progress to report, and the answer is in its memory."""
        return {**self.__dict__, "_progress": None}

    def __call__(self, recording: Recording) -> Recovery:
        """The recovery of this very object."""
        if self._recording is not recording:
            self._answer = self._solve(recording)
            self._recording = recording
        if isinstance(self._answer, UnoccludeError):
            raise self._answer
        assert self._answer is not None
        return self._answer

    def last(self) -> Recovery:
        """The recovery of the recording that was solved last."""
        if isinstance(self._answer, UnoccludeError):
            raise self._answer
        if self._answer is None:
            raise UnoccludeError("no recording was solved yet")
        return self._answer

    def _solve(self, recording: Recording) -> Recovery | UnoccludeError:
        from .. import smooth

        try:
            return smooth(recording, self._calibration, self._config, self._progress, clock=self._clock)
        except UnoccludeError as error:
            return error


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
    graph, settings = SharedGraph(calibration, config, progress, clock), settings or BaselineSettings()
    live = _SharedPlay(graph, calibration, config, latency_s)

    def method(name: str) -> Method:
        if name == GRAPH:
            return graph
        if name in LIVE_SMOOTHER:
            return partial(live, LIVE_SMOOTHER[name])
        options = settings.for_method(name)
        if name in LIVE_BASELINES:
            options["latency_s"] = latency_s
        return partial(_by_baseline, name, graph, settings.orientation, options)

    return {name: method(name) for name in names}


class _SharedPlay:
    """A recording played once into the live smoother, for what it answers now and later."""

    def __init__(
        self, graph: SharedGraph, calibration: ArmCalibration | None, config: Config, latency_s: float
    ) -> None:
        self._inputs = graph, calibration, config, latency_s
        self._play: LivePlay | None = None

    def __getstate__(self) -> dict[str, object]:
        return {"_inputs": self._inputs, "_play": None}

    def __call__(self, kind: str, recording: Recording) -> Recovery:
        from .compare import LivePlay

        if self._play is None:
            self._play = LivePlay(*self._inputs)
        return self._play.method(kind)(recording)


def _by_baseline(
    name: str, graph: SharedGraph, orientation: str, options: Mapping[str, Any], recording: Recording
) -> Recovery:
    from ..baselines.registry import recover

    return recover(recording, graph(recording), name, orientation, options)
