"""The baselines by name, and `recover`: one of them over a whole recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..errors import UnoccludeError

if TYPE_CHECKING:
    from ..recording import Recording
    from ..result import Recovery
    from .scene import Baseline


#: Orientation filters; each is a function of `baselines.orientation`.
ORIENTATIONS = ("vqf", "madgwick", "comotti", "complementary")
#: The filter that baselines get unless another is asked for.
DEFAULT_ORIENTATION = "vqf"


@dataclass(frozen=True)
class BaselineEntry:
    """One method to compare with."""

    name: str  # As users call it; the function is the module's of that name, with underscores
    module: str  # Where the function is
    words: str = ""  # What it is, and whose, in a paper's sentence; keys as in `report.methods`
    needs_orientation: bool = True  # The answer depends on the orientation filter
    options: frozenset[str] = frozenset()  # Keyword arguments of the function that a user may set

    def function(self, options: Mapping[str, Any]) -> Baseline:
        """The method, from a scene to a path, its options set."""
        module = import_module(f".{self.module}", __package__)
        function: Baseline = getattr(module, self.name.replace("-", "_"))
        return partial(function, **options) if options else function


def _by_name(*entries: BaselineEntry) -> dict[str, BaselineEntry]:
    return {entry.name: entry for entry in entries}


_RTS = "an iterated error-state Kalman filter with Rauch-Tung-Striebel smoothing [@bell1994]"
_GAUSSIAN = "Gaussian-process regression of positions and accelerations after [@feng2014]"
_ONLINE = "an autoregressive Gaussian-process predictor of the present after [@feng2014]"
_MULTIRATE = "a multi-rate Kalman filter of positions and accelerations after [@feng2014]"
_LINEAR = (
    "double integration of the accelerometer through each gap, its error spread linearly in time"
    " [@jatesiktat2017]"
)
_CAMERA = "the camera's own skeleton alone, its guesses included [@jatesiktat2017]"
_PCHIP = "shape-preserving cubic interpolation of the camera's points [@fritsch1980]"
#: Every baseline, the strongest first.
BASELINES = _by_name(
    BaselineEntry("rts", "rts", _RTS),
    BaselineEntry("ukf", "rts", "an unscented Kalman filter after [@tian2015], with one IMU"),
    BaselineEntry("gaussian-process", "gaussian_process", _GAUSSIAN),
    BaselineEntry("multirate-kalman", "kalman", _MULTIRATE),
    BaselineEntry(
        "kalman", "kalman", "a Kalman filter of position, velocity and acceleration after [@le2017]"
    ),
    BaselineEntry("gaussian-process-online", "gaussian_process", _ONLINE),
    BaselineEntry("linear-drift", "simple", _LINEAR, options=frozenset({"boundary_s"})),
    BaselineEntry("camera-only", "simple", _CAMERA, needs_orientation=False),
    BaselineEntry("pchip", "simple", _PCHIP),
    BaselineEntry("hold", "simple", "the last visible value carried forward"),
)


def recover(
    recording: Recording,
    graph: Recovery,
    method: str,
    orientation: str = DEFAULT_ORIENTATION,
    options: Mapping[str, Any] | None = None,
) -> Recovery:
    """Recover a recording by a baseline."""
    from .scene import of_best_camera, recovery_of, scenes_of

    options = dict(options or {})
    if method not in BASELINES:
        raise UnoccludeError(f"there is no method '{method}'; baselines: {', '.join(BASELINES)}")
    if orientation not in ORIENTATIONS:
        raise UnoccludeError(
            f"there is no orientation '{orientation}'; choose one of: {', '.join(ORIENTATIONS)}"
        )
    entry = BASELINES[method]
    if unknown := options.keys() - entry.options:
        raise UnoccludeError(f"{method} has no option {', '.join(sorted(unknown))}")
    recording, graph = of_best_camera(recording, graph)
    scenes = scenes_of(recording, graph, orientation if entry.needs_orientation else DEFAULT_ORIENTATION)
    baseline = entry.function(options)
    settings = {"orientation": orientation} if entry.needs_orientation else {}
    paths = [baseline(scene) for scene in scenes]
    return recovery_of(recording, graph, scenes, paths, method, settings | options)
