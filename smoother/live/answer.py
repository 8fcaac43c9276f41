"""An estimate from a solved window: joints, and covariances of all that is stated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..array_types import FloatArray
from ..linalg import skew
from ..recording import FOREARM_JOINTS, JOINTS
from ..recovery.samples import widen_turns
from ..rotation import Rotation
from ..selfcal.self_calibration import SelfCalibration
from ..window.constant_errors import JOINT_ERRORS
from ..window.lag_solution import LagSolution, NodeState
from .discontinuity import Discontinuity
from .estimate import LiveEstimate
from .live_state import LiveState
from .prediction import Prediction

_NEWEST = ("turn", "position", "velocity", "bias", "gravity")
_SETTLED = ("settled_turn", "settled_position", "settled_velocity", "bias", "gravity")


@dataclass(frozen=True)
class Circumstances:
    """What an estimate needs to know besides the solution.

    Attributes
    ----------
    kind : {"now", "settled"}
    state : LiveState
    since_s : float or None, s
        When the gap began.
    clock_sigma_s : float, s
        Of the camera's clock.
    shoulder_variance : float, m^2
        How far the shoulder may have gone since its knot.
    discontinuity : Discontinuity or None
        That is being spread.
    """

    kind: Literal["now", "settled"]
    state: LiveState
    since_s: float | None
    clock_sigma_s: float
    shoulder_variance: float
    discontinuity: Discontinuity | None


def estimate_of(
    prediction: Prediction, solution: LagSolution, model: SelfCalibration, about: Circumstances
) -> LiveEstimate:
    """The arm at a moment with its covariance.

    Parameters
    ----------
    prediction : Prediction
        From the solution's newest node or its settled one, as `about.kind` says.
    solution : LagSolution
    model : SelfCalibration
    about : Circumstances
    """
    joints = list(solution.levers)
    shoulder = ["shoulder"] if solution.shoulder is not None else []
    start = _NEWEST if about.kind == "now" else _SETTLED
    before = solution.block(*start, *joints, *shoulder)
    size = 9 + 3 * (len(joints) + len(shoulder))
    follows = np.zeros((size, len(before)))
    follows[:9, :18] = prediction.follows
    follows[9:, 18:] = np.eye(size - 9)
    covariance = follows @ before @ follows.T
    covariance[:9, :9] += prediction.noise
    state, common = prediction.state, common_error(model)
    # a clock that is off by a moment moves the whole path along itself
    common = common + about.clock_sigma_s**2 * np.outer(state.v, state.v)
    R, p, offset = state.R, state.p, np.zeros(3)
    if about.discontinuity is not None:
        share = about.discontinuity.share(state.t)
        offset, turn = share * about.discontinuity.offset, share * about.discontinuity.turn
        p, R = p + offset, Rotation.from_rotvec(turn).as_matrix() @ R
        common = common + np.outer(offset, offset)
        covariance[:3, :3] += np.outer(turn, turn)
    order = np.r_[3:6, 0:3]
    pose = covariance[order][:, order]
    pose[:3, :3] += common
    pose = widen_turns(pose[None])[0]
    places, spreads = {}, {}
    for k, joint in enumerate(joints):
        arm = R @ solution.levers[joint]
        rows = np.r_[0:6, 9 + 3 * k : 12 + 3 * k]
        jacobian = np.hstack([-skew(arm), np.eye(3), R])
        places[joint] = p + arm
        spreads[joint] = jacobian @ covariance[rows][:, rows] @ jacobian.T + common
    if solution.shoulder is not None:
        places["shoulder"] = solution.shoulder
        spreads["shoulder"] = covariance[-3:, -3:] + about.shoulder_variance * np.eye(3)
    return LiveEstimate(
        t_s=state.t,
        kind=about.kind,
        state=about.state,
        since_s=about.since_s,
        position=p,
        quaternion=Rotation.from_matrix(R).as_quat(scalar_first=True),
        velocity=state.v,
        pose_covariance=pose,
        joints=places,
        joint_covariance=spreads,
        offset=offset,
    )


def shown_state(state: NodeState, discontinuity: Discontinuity | None) -> NodeState:
    """The state as it is shown while a discontinuity is being spread."""
    if discontinuity is None:
        return state
    share = discontinuity.share(state.t)
    R = Rotation.from_rotvec(share * discontinuity.turn).as_matrix() @ state.R
    return NodeState(state.t, R, state.p + share * discontinuity.offset, state.v)


def common_error(model: SelfCalibration) -> FloatArray:
    """Covariance (3, 3), m^2, of what the camera's errors of the forearm's joints have in common."""
    if model.errors.considered is None:
        return np.eye(3) * model.joint_bias.sigma_m**2
    covariance = model.errors.considered.covariance[JOINT_ERRORS, JOINT_ERRORS]
    used = [JOINTS.index(joint) for joint in FOREARM_JOINTS if joint in model.joint_bias.joints]
    if not used:
        return np.eye(3) * model.joint_bias.sigma_m**2
    mean = np.zeros((3, covariance.shape[0]))
    for column in used:
        mean[:, 3 * column : 3 * column + 3] = np.eye(3) / len(used)
    return np.asarray(mean @ covariance @ mean.T)
