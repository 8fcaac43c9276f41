"""The baselines by name, and `recover`: one of them over a whole recording, of its best camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cameras import join_cameras
from ..errors import UnoccludeError
from ..measurements.visibility import enough_joints, find_gaps, joints_needed
from ..recording import Recording
from ..result import Recovery

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
    """One method to compare with.

    Attributes
    ----------
    name : str
        As users call it; the function is the module's of that name, with underscores.
    words : str
        What it is, and whose, in a paper's sentence; keys as in `manuscript.references`.
    needs_orientation : bool
        The answer depends on the orientation filter.
    options : frozenset of str
        Keyword arguments of the function that a user may set.
    module : str
        Where the function is; the module of its own name where "".
    """

    name: str
    words: str = ""
    needs_orientation: bool = True
    options: frozenset[str] = frozenset()
    module: str = ""

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
    """Recover a recording by a baseline.

    Parameters
    ----------
    recording : Recording
        One arm and its forearm IMU; its truth is not looked at. Of several cameras the best one counts.
    graph : Recovery
        The graph's recovery of this very recording, of which a baseline gets calibration, clock, accepted
        samples, gravity and gaps.
    method : str
        One of `BASELINES` or `LIVE_BASELINES`.
    orientation : str
        One of `ORIENTATIONS`.
    options : mapping, optional
        Of the method, by name, see `BaselineEntry.options`.

    Returns
    -------
    recovery : Recovery

    Raises
    ------
    UnoccludeError
        Method, orientation or option is unknown, or nothing can be recovered; in one sentence.
    """
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


def of_best_camera(recording: Recording, graph: Recovery) -> tuple[Recording, Recovery]:
    """A recording and the graph's recovery of it with the frames of one camera, in the first one's frame.

    Parameters
    ----------
    recording : Recording
    graph : Recovery
        Of this very recording.

    Returns
    -------
    recording : Recording
        With one camera.
    graph : Recovery
        With that camera's frames, residuals and gaps; the motion stays that of all cameras.
    """
    if recording.arm.camera is None and recording.cameras:
        recording, _ = join_cameras(recording)
    if graph.arm.camera is None or recording.arm.camera is None or len(graph.arm) != len(recording.arm):
        return recording, graph
    residuals = graph.residuals
    needed = joints_needed(graph.arm)
    used = recording.arm.state > 0 if residuals is None else np.asarray(residuals.used)
    rows = max(graph.arm.rows_by_camera, key=lambda own: int(enough_joints(used[own], needed).sum()))
    arm = replace(graph.arm.select(rows), camera=None)
    visible = enough_joints(used[rows], needed)
    gaps = find_gaps(np.asarray(arm.t_s), visible, float(graph.t_s[0]), float(graph.t_s[-1]))
    if residuals is not None:
        residuals = replace(
            residuals,
            t_s=residuals.t_s[rows],
            residual=residuals.residual[rows],
            used=residuals.used[rows],
            reason=residuals.reason[rows],
        )
    own = replace(recording.arm.select(rows), camera=None)
    return replace(recording, arm=own), replace(graph, arm=arm, residuals=residuals, gaps=gaps)
