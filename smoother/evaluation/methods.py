"""The methods by name: the graph, and the baselines that start from what it estimates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from ..baselines.registry import BASELINES, DEFAULT_ORIENTATION, recover
from ..errors import UnoccludeError

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..measurements.clock import Clock
    from ..recording import Recording
    from ..result import Recovery
    from ..runtime.pool import Progress

    Method = Callable[[Recording], Recovery]


GRAPH = "graph"
#: Every method, ours first, then the baselines, the strongest first.
METHODS = (GRAPH, *BASELINES)


class Shared:
    """The graph's answer to a recording, kept until another recording comes; failures too."""

    def __init__(self, solve: Callable[..., Recovery], progress: Progress | None) -> None:
        self._solve, self._progress = solve, progress
        self._recording: Recording | None = None
        self._answer: Recovery | UnoccludeError | None = None

    def __getstate__(self) -> dict[str, object]:
        """In another process there is no progress to report."""
        return {**self.__dict__, "_progress": None}

    def __call__(self, recording: Recording) -> Recovery:
        """The answer to this very object."""
        if self._recording is not recording or self._answer is None:
            try:
                self._answer = self._solve(recording, progress=self._progress)
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
) -> dict[str, Method]:
    """The chosen methods by name; the baselines start from what the graph estimates, which they share.

    `orientation` is the filter of the baselines that need one.
    """
    from ..smoothing import smooth

    graph = Shared(partial(smooth, calibration=calibration, config=config, clock=clock), progress)
    return {
        name: graph if name == GRAPH else partial(_by_baseline, name, graph, orientation) for name in names
    }


def _by_baseline(name: str, graph: Method, orientation: str, recording: Recording) -> Recovery:
    return recover(recording, graph(recording), name, orientation)
