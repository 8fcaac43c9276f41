"""What is shown: the arm now and a lag ago, predicted by the IMU, its discontinuities spread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..array_types import FloatArray
from ..linalg import skew_of
from ..recording import FOREARM_JOINTS, JOINTS
from ..recovery.samples import widen_turns
from ..rotation import Rotation
from ..selfcal.self_calibration import SelfCalibration
from ..window.shared import JOINT_ERRORS
from ..window.solution import LagSolution, NodeState
from .answers import LiveEstimate, LiveState
from .monitor import joint_rows
from .prediction import Prediction, predict
from .tracker import Tracker

#: A discontinuity is spread over this long, s.
SPREAD_S = 0.2


@dataclass(frozen=True)
class Discontinuity:
    """What was shown less what is known now, at the moment of the change."""

    at_s: float  # When it happened
    offset: FloatArray  # (3,) m: of the position in {K}
    turn: FloatArray  # (3,) rad: of the orientation in {K}

    @classmethod
    def between(cls, shown: NodeState, known: NodeState) -> Discontinuity:
        """From what was shown to what is known now, at the same moment."""
        turn = Rotation.from_matrix(shown.R @ known.R.T).as_rotvec()
        return cls(known.t, shown.p - known.p, turn)

    def share(self, t_s: float) -> float:
        """How much of it is left at a time: 1 at first, 0 after `SPREAD_S`, smooth between."""
        u = float(np.clip((t_s - self.at_s) / SPREAD_S, 0.0, 1.0))
        return 1.0 - u * u * (3.0 - 2.0 * u)


_ONE, _POSE = np.eye(3), np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
_NEWEST = ("turn", "position", "velocity", "bias", "gravity")
_SETTLED = ("settled_turn", "settled_position", "settled_velocity", "bias", "gravity")


@dataclass(frozen=True)
class Circumstances:
    """What an estimate needs to know besides the solution."""

    kind: Literal["now", "settled"]
    state: LiveState
    since_s: float | None  # When the gap began
    clock_sigma_s: float  # Of the camera's clock
    shoulder_variance: float  # m^2: how far the shoulder may have gone since its knot
    discontinuity: Discontinuity | None  # That is being spread


def estimate_of(
    prediction: Prediction, solution: LagSolution, model: SelfCalibration, about: Circumstances
) -> LiveEstimate:
    """The arm at a moment with its covariance."""
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
    common = common + about.clock_sigma_s**2 * state.v[:, None] * state.v
    R, p, offset = state.R, state.p, np.zeros(3)
    if about.discontinuity is not None:
        share = about.discontinuity.share(state.t)
        offset, turn = share * about.discontinuity.offset, share * about.discontinuity.turn
        p, R = p + offset, Rotation.from_rotvec(turn).as_matrix() @ R
        common = common + np.outer(offset, offset)
        covariance[:3, :3] += np.outer(turn, turn)
    pose = covariance[_POSE]
    pose[:3, :3] += common
    pose = widen_turns(pose[None])[0]
    places, spreads = {}, {}
    for k, joint in enumerate(joints):
        arm = R @ solution.levers[joint]
        jacobian = np.concatenate([-skew_of(arm), _ONE, R], axis=1)
        places[joint] = p + arm
        spreads[joint] = jacobian @ covariance[joint_rows(k)] @ jacobian.T + common
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


class Display:
    """Answers of a tracker; where what is known changes at once, what is shown follows within `SPREAD_S`."""

    def __init__(self, lag_s: float) -> None:
        self._lag_s = lag_s
        self._discontinuity: Discontinuity | None = None

    def forget(self) -> None:
        """Nothing is shown any more that a change could be spread from."""
        self._discontinuity = None

    def spread(self, before: Prediction, tracker: Tracker, now_s: float) -> None:
        """Spread the change from what was shown to what a tracker knows now."""
        if tracker.solution is not None:
            after = predicted(tracker, tracker.solution, now_s)
            self._discontinuity = Discontinuity.between(
                shown_state(before.state, self._discontinuity), after.state
            )

    def now(
        self, tracker: Tracker, solution: LagSolution, now_s: float, clock_sigma_s: float, delay_s: float
    ) -> LiveEstimate:
        """The arm at the present."""
        if self._discontinuity is not None and now_s - self._discontinuity.at_s > SPREAD_S:
            self._discontinuity = None
        prediction = predicted(tracker, solution, now_s)
        state, since_s = tracker.history.state_now(now_s, delay_s)
        beyond_s = max(prediction.state.t - solution.newest.t, 0.0)
        shoulder = tracker.noise.shoulder_walk**2 * beyond_s
        about = Circumstances("now", state, since_s, clock_sigma_s, shoulder, self._discontinuity)
        return estimate_of(prediction, solution, tracker.model, about)

    def settled(
        self, tracker: Tracker, solution: LagSolution, now_s: float, clock_sigma_s: float
    ) -> LiveEstimate | None:
        """The arm a lag ago; None where the window does not reach so far back. Parameters as of `now`."""
        settled_s = now_s - self._lag_s
        if settled_s < float(tracker.window.t[0]):
            return None
        start = solution.settled
        prediction = predict(
            start, solution, tracker.signal.since(start.t), max(settled_s, start.t), tracker.noise
        )
        state, since_s = tracker.history.state_at(settled_s)
        about = Circumstances("settled", state, since_s, clock_sigma_s, 0.0, None)
        return estimate_of(prediction, solution, tracker.model, about)


def predicted(tracker: Tracker, solution: LagSolution, now_s: float) -> Prediction:
    """A solution's newest node propagated to the present."""
    return predict(solution.newest, solution, tracker.signal.since(solution.newest.t), now_s, tracker.noise)
