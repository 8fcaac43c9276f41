"""Drawn motions at the samples of a section, with all that widens the answer's covariance there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..body import SEGMENTS
from ..linalg import interpolate, skew
from ..measurements.alignment import lever_of
from ..result.draws import JOINT, TURN
from ..rotation import Rotation
from ..selfcal.self_calibration import SelfCalibration
from ..splines import PiecewiseCubic, natural_spline
from ..window.draw_plan import DrawPlan, root_of
from ..window.problem import States
from ..window.shared import SharedLayout
from ..window.solution import SegmentSolution, Solution, WindowDraws
from .samples import (
    IMU_DELAY_S,
    LINEAR_RAD,
    SectionAnswer,
    Swing,
    large_rotation_uncertainty,
    moves_by,
    turning,
    unknown_mounting,
)


def sample_draws(
    answer: SectionAnswer,
    imu_t: FloatArray,  # (n,) s
    drawn: WindowDraws,
    solution: Solution,
    model: SelfCalibration,
    layout: SharedLayout,
    plan: DrawPlan,
) -> SectionAnswer:
    """The answer of a section with drawn motions at some of its samples."""
    first = -answer.samples.start % plan.every
    samples = np.arange(first, len(imu_t), plan.every)
    t, nodes = imu_t[samples], solution.t
    R_at_samples = Rotation.from_quat(answer.motion["quaternion"], scalar_first=True).as_matrix()
    R = R_at_samples[samples]
    v = answer.motion["velocity"][samples]
    #    From here on samples come before draws, (m, k, 3), as the columns have them.
    # 1. Between nodes: the cubic of position and velocity, a smooth curve through the turns.
    inside = np.clip(t, nodes[0], nodes[-1])
    places, speeds, rotations = (
        _nodes_first(each).reshape(len(nodes), -1)
        for each in (drawn.position, drawn.velocity, drawn.rotation)
    )
    p = PiecewiseCubic(nodes, places, speeds)(inside).reshape(len(t), -1, 3)
    r = natural_spline(nodes, rotations)(inside).reshape(len(t), -1, 3)
    # 2. Angles that are hardly known, widened as the covariance is, and positions by what depends on them.
    p, r = _widened(p, r, solution.forearm.pose_covariance_at(t))
    if (swing := Swing.of(solution, States(R, answer.motion["position"][samples], v), t)) is not None:
        p = swing.moved(p, r)
    # 3. A clock that is off by a moment moves the whole path along itself; an IMU that is late shows the pose
    #    of a moment ago.
    delay = IMU_DELAY_S * plan.once("delay", 1)
    p += (model.clock.local_sigma_s * plan.once("clock", 1) + delay) * v[:, None]
    r += delay * turning(imu_t, R_at_samples)[samples][:, None]
    # 4. Joints follow the pose; their lever arms have errors of their own.
    columns = {"position": p, "rotation": r}
    turns = {
        name: _turns(_nodes_first(drawn.turns[name]), motion, t)
        for name in drawn.turns
        if (motion := solution.of(name)) is not None
    }
    for joint in answer.joints:
        if joint == "shoulder":
            if drawn.shoulder is not None:
                columns[JOINT + joint] = interpolate(nodes, _nodes_first(drawn.shoulder), t)
        elif lever_of(model.estimate, joint) is not None:
            arm = R @ solution.lever(joint)
            columns[JOINT + joint] = p + _crossed(r, arm)
            if joint in drawn.levers:
                columns[JOINT + joint] += _turned(R, drawn.levers[joint])
            elif joint in model.estimate.lever_arms:  # no window has it
                sigma_m = model.estimate.lever_arms[joint].sigma_m
                columns[JOINT + joint] += _turned(R, sigma_m * plan.once(f"lever {joint}", 3))
            spread_m = moves_by(joint, [body.segment for body in solution.bodies], model)
            if spread_m:
                columns[JOINT + joint] += spread_m * plan.once(f"moves {joint}", 3)
    #    What a further segment carries hangs on the joint that it shares, and turns with its IMU.
    for segment in (SEGMENTS[name] for name in turns):
        quaternion = answer.further[segment.name]["quaternion"]
        known = np.isfinite(quaternion[samples]).all(axis=1)
        R_own = np.full((len(samples), 3, 3), np.nan)
        R_own[known] = Rotation.from_quat(quaternion[samples][known], scalar_first=True).as_matrix()
        own = model.estimate.mountings[segment.name].lever_arms
        for joint in segment.camera_joints:
            along = own[joint].position_m - own[segment.shared_joint].position_m
            a, b = (layout.lever(end, segment.name) for end in (joint, segment.shared_joint))
            of = drawn.shared_covariance
            both = of[a, a] + of[b, b] - of[a, b] - of[b, a]
            length = plan.once(f"length {segment.name} {joint}", 3) @ root_of(both)
            moved = _crossed(turns[segment.name], R_own @ along) + _turned(R_own, length)
            columns[JOINT + joint] = columns[JOINT + segment.shared_joint] + moved
    # 5. A sensor whose mounting the motion did not show.
    place_m, turn_rad = unknown_mounting(model)
    if place_m or turn_rad:
        columns["position"] = p + _turned(R, place_m * plan.once("mounting", 3))
        columns["rotation"] = r + _turned(R, turn_rad * plan.once("mounting turn", 3))
    columns |= {SEGMENTS[name].prefix + TURN: turned for name, turned in turns.items()}
    draws = {name: values.astype(np.float32) for name, values in columns.items()}
    return replace(answer, drawn=samples, draws=draws)


def _nodes_first(drawn: FloatArray) -> FloatArray:
    """Draws (k, n, 3) of a window as (n, k, 3)."""
    return np.ascontiguousarray(np.swapaxes(drawn, 0, 1))


def _crossed(turns: FloatArray, arm: FloatArray) -> FloatArray:
    """What small turns (m, k, 3) move the ends of arms (m, 3) by; `numpy.cross` takes three times as long."""
    return np.asarray(turns @ skew(arm))


def _turned(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (k, 3) in the axes of each of the rotations (m, 3, 3): (m, k, 3)."""
    return np.asarray(vectors @ np.swapaxes(R, 1, 2))


def _turns(rotation: FloatArray, motion: SegmentSolution, t: FloatArray) -> FloatArray:
    """Turns (m, k, 3) of a further IMU at times (m,); nan where it has no samples."""
    at_samples = interpolate(motion.t, rotation, t)
    covariance = motion.pose_covariance_at(t)
    known = np.isfinite(covariance).all(axis=(1, 2))
    at_samples[~known] = np.nan
    if known.any():
        nothing = np.zeros_like(at_samples[known])
        at_samples[known] = _widened(nothing, at_samples[known], covariance[known])[1]
    return at_samples


def _widened(p: FloatArray, r: FloatArray, pose_covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions and turns (m, k, 3) with the covariance that `widen_turns` makes of theirs."""
    wide = large_rotation_uncertainty(pose_covariance)
    if wide is None:
        return p, r
    grows = wide.axes @ ((wide.variance / LINEAR_RAD**2)[:, :, None] * np.swapaxes(wide.axes, 1, 2))
    more = r[wide.rows] @ np.swapaxes(grows, 1, 2)
    p, r = p.copy(), r.copy()
    r[wide.rows] += more
    p[wide.rows] += more @ np.swapaxes(wide.position_follows, 1, 2)
    return p, r
