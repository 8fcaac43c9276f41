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
    words: str = ""  # What it is, and whose, in a paper's sentence; keys as in `report.methods`
    needs_orientation: bool = True  # The answer depends on the orientation filter
    options: frozenset[str] = frozenset()  # Keyword arguments of the function that a user may set
    module: str = ""  # Where the function is; the module of its own name where ""

    def function(self, options: Mapping[str, Any]) -> Baseline:
        """The method, from a scene to a path, its options set."""
        name = self.name.replace("-", "_")
        function: Baseline = getattr(import_module(f".{self.module or name}", __package__), name)
        return partial(function, **options) if options else function


#: Every baseline, the strongest first.
BASELINES: dict[str, BaselineEntry] = {
    entry.name: entry
    for entry in (
        BaselineEntry(
            "rts", "an iterated error-state Kalman filter with Rauch-Tung-Striebel smoothing [@bell1994]"
        ),
        BaselineEntry("ukf", "an unscented Kalman filter after [@tian2015], with one IMU"),
        BaselineEntry(
            "gaussian-process",
            "Gaussian-process regression of positions and accelerations after [@feng2014]",
        ),
        BaselineEntry(
            "multirate-kalman",
            "a multi-rate Kalman filter of positions and accelerations after [@feng2014]",
            module="kalman",
        ),
        BaselineEntry("kalman", "a Kalman filter of position, velocity and acceleration after [@le2017]"),
        BaselineEntry(
            "linear-drift",
            "double integration of the accelerometer through each gap, its error spread linearly in time"
            " [@jatesiktat2017]",
            options=frozenset({"boundary_s"}),
            module="simple",
        ),
        BaselineEntry(
            "camera-only",
            "the camera's own skeleton alone, its guesses included [@jatesiktat2017]",
            needs_orientation=False,
            module="simple",
        ),
        BaselineEntry(
            "pchip",
            "shape-preserving cubic interpolation of the camera's points [@fritsch1980]",
            module="simple",
        ),
        BaselineEntry("hold", "the last visible value carried forward", module="simple"),
    )
}

#: Baselines that see only what has arrived: they answer for the present.
LIVE_BASELINES: dict[str, BaselineEntry] = {
    entry.name: entry
    for entry in (
        BaselineEntry("autoregressive", options=frozenset({"latency_s"}), module="simple"),
        BaselineEntry(
            "constant-velocity",
            needs_orientation=False,
            options=frozenset({"latency_s"}),
            module="simple",
        ),
    )
}


def recover(
    recording: Recording,
    graph: Recovery,
    method: str,
    orientation: str = DEFAULT_ORIENTATION,
    options: Mapping[str, Any] | None = None,
) -> Recovery:
    """Recover a recording by a baseline."""
    from .one_camera import of_best_camera
    from .scene import recovery_of, scenes_of

    options = dict(options or {})
    entries = BASELINES | LIVE_BASELINES
    if method not in entries:
        raise UnoccludeError(f"there is no method '{method}'; baselines: {', '.join(entries)}")
    if orientation not in ORIENTATIONS:
        raise UnoccludeError(
            f"there is no orientation '{orientation}'; choose one of: {', '.join(ORIENTATIONS)}"
        )
    entry = entries[method]
    if unknown := options.keys() - entry.options:
        raise UnoccludeError(f"{method} has no option {', '.join(sorted(unknown))}")
    recording, graph = of_best_camera(recording, graph)
    scenes = scenes_of(recording, graph, orientation if entry.needs_orientation else DEFAULT_ORIENTATION)
    baseline = entry.function(options)
    settings = {"orientation": orientation} if entry.needs_orientation else {}
    paths = [baseline(scene) for scene in scenes]
    return recovery_of(recording, graph, scenes, paths, method, settings | options)
