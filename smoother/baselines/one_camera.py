"""Baselines know one camera with depth: of several they get the one that saw the forearm most often."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cameras import join_cameras
from ..cameras.joining import FOREARM_M
from ..measurements.visibility import enough_joints, find_gaps, joints_needed
from ..recording import Recording
from ..result import Recovery


def of_best_camera(recording: Recording, graph: Recovery) -> tuple[Recording, Recovery]:
    """A recording and the graph's recovery of it with the frames of one camera, in the first one's frame.

    A camera without depth gets places on its rays as the graph does, by the forearm's length that it found.
    """
    if recording.arm.camera is None and (recording.cameras or recording.arm.pixel_rad is not None):
        recording, _ = join_cameras(recording, forearm_m=_forearm_m(graph))
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


def _forearm_m(graph: Recovery) -> float:
    """The length from elbow to wrist by the graph's lever arms."""
    levers = {} if graph.calibration is None else graph.calibration.lever_arms
    if not {"elbow", "wrist"} <= levers.keys():
        return FOREARM_M
    return float(np.linalg.norm(levers["wrist"].position_m - levers["elbow"].position_m))
