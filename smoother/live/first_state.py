"""Where the arm is at a moment, before there is a window: from what camera and IMU say around it."""

from __future__ import annotations

import numpy as np

from ..linalg import interpolate
from ..measurements.clock import constant_clock
from ..measurements.segment import SegmentTraits, make_segment
from ..recording import FOREARM_JOINTS, JOINTS, ImuStream, JointTracks
from ..selfcal.self_calibration import SelfCalibration
from ..window.lag_solution import NodeState
from ..window.prepare import prepare

#: A first state is read from so much around it, s.
AROUND_S = 3.0


def first_state(
    imu: ImuStream, frames: JointTracks, model: SelfCalibration, offset_s: float, needed: int, t_s: float
) -> NodeState | None:
    """A state to begin with, from what camera and IMU say around it.

    Parameters
    ----------
    imu : ImuStream
        Without a pause.
    frames : JointTracks
        On the camera's clock.
    model : SelfCalibration
    offset_s : float, s
        t_imu = t_camera + offset.
    needed : int
        Joints of the forearm that make a frame visible.
    t_s : float, s
        About when, on the IMU's clock.

    Returns
    -------
    state : NodeState or None
        At the visible frame nearest to it; None where the camera sees too little around it.
    """
    samples = imu.select(np.abs(imu.t_s - t_s) < AROUND_S)
    clock = constant_clock(offset_s)
    rows = np.abs(frames.t_s + offset_s - t_s) < AROUND_S
    if len(samples) < 40 or rows.sum() < 10:
        return None
    arm = frames.select(rows)
    traits = SegmentTraits(model.initial.down, None, needed, False)
    segment = make_segment(samples, samples.t_s, arm, slice(0, len(arm)), traits)
    if segment is None:
        return None
    segment = model.errors.corrected(segment)
    ready = prepare(segment, model.estimate, clock, model.joint_sigma_m, AROUND_S)
    if ready is None:
        return None
    prepared, alignment = ready
    usable = prepared.frame_node >= 0
    usable &= prepared.accepted[:, [JOINTS.index(joint) for joint in FOREARM_JOINTS]].sum(axis=1) >= needed
    if usable.sum() < 6:
        return None
    candidates = prepared.frame_t_imu[usable]
    at = candidates[[int(np.argmin(np.abs(candidates - t_s)))]]
    if not samples.t_s[0] < at[0] < samples.t_s[-1]:
        return None
    R = (alignment.at(at) * segment.attitude.at(at)).as_matrix()[0]
    p, v = interpolate(prepared.t, prepared.start.p, at)[0], interpolate(prepared.t, prepared.start.v, at)[0]
    return NodeState(float(at[0]), R, p, v)
