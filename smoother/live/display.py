"""What is shown: the arm now and a lag ago, predicted by the IMU, its discontinuities spread."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..array_types import FloatArray
from ..recording import FOREARM_JOINTS, JOINTS
from ..recovery.samples import widen_turns
from ..rotation import Rotation
from ..selfcal.self_calibration import SelfCalibration
from ..window.shared import JOINT_ERRORS
from ..window.solution import LagSolution
from .answers import LiveEstimate, LiveState
from .prediction import Prediction, joint_at, predict
from .tracker import Tracker

#: A discontinuity is spread over this long, s.
SPREAD_S = 0.2
_POSE = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])


class Display:
    """Answers of a tracker; where what is known changes at once, what is shown follows within `SPREAD_S`."""

    def __init__(self, lag_s: float) -> None:
        self._lag_s = lag_s
        #: When what is known changed at once, and what was shown then less what is known: m, rad, in {K}
        self._jump: tuple[float, FloatArray, FloatArray] | None = None

    def forget(self) -> None:
        """Nothing is shown any more that a change could be spread from."""
        self._jump = None

    def spread(self, before: Prediction, tracker: Tracker, now_s: float) -> None:
        """Spread the change from what was shown to what a tracker knows now."""
        if tracker.solution is None:
            return
        shown, known = before.state, predict(tracker.solution, tracker.signal, now_s, tracker.noise).state
        offset, turn = self._left(shown.t)
        turned = Rotation.from_matrix(Rotation.from_rotvec(turn).as_matrix() @ shown.R @ known.R.T)
        self._jump = known.t, shown.p + offset - known.p, turned.as_rotvec()

    def now(
        self, tracker: Tracker, solution: LagSolution, now_s: float, clock_sigma_s: float, delay_s: float
    ) -> LiveEstimate:
        """The arm at the present; what the camera's clock is known to, and the frames' usual delay, s."""
        if self._jump is not None and now_s - self._jump[0] > SPREAD_S:
            self._jump = None
        prediction = predict(solution, tracker.signal, now_s, tracker.noise)
        t_s, known = prediction.state.t, tracker.history.state_now(now_s, delay_s)
        estimate = _estimate("now", known, prediction, tracker.model, clock_sigma_s, *self._left(t_s))
        if solution.shoulder is not None:  # how far it may have gone since its knot
            beyond_s = max(t_s - solution.newest.t, 0.0)
            estimate.joint_covariance["shoulder"] += tracker.noise.shoulder_walk**2 * beyond_s * np.eye(3)
        return estimate

    def settled(
        self, tracker: Tracker, solution: LagSolution, now_s: float, clock_sigma_s: float
    ) -> LiveEstimate | None:
        """The arm a lag ago; None where the window does not reach so far back."""
        settled_s = now_s - self._lag_s
        if settled_s < float(tracker.window.t[0]):
            return None
        at_s, known = max(settled_s, solution.settled.t), tracker.history.state_at(settled_s)
        prediction = predict(solution, tracker.signal, at_s, tracker.noise, settled=True)
        return _estimate("settled", known, prediction, tracker.model, clock_sigma_s, np.zeros(3), np.zeros(3))

    def _left(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Offset and turn that are left at a time: all at first, none after `SPREAD_S`, smooth between."""
        if self._jump is None:
            return np.zeros(3), np.zeros(3)
        at_s, offset, turn = self._jump
        u = float(np.clip((t_s - at_s) / SPREAD_S, 0.0, 1.0))
        share = 1.0 - u * u * (3.0 - 2.0 * u)
        return share * offset, share * turn


def _estimate(
    kind: Literal["now", "settled"],
    known: tuple[LiveState, float | None],  # visible or gap, and since when
    prediction: Prediction,
    model: SelfCalibration,
    clock_sigma_s: float,  # of the camera's clock
    offset: FloatArray,  # what of a change is still to be spread, m and rad
    turn: FloatArray,
) -> LiveEstimate:
    """The arm at a moment with its covariance."""
    solution, state = prediction.solution, prediction.state
    names = list(solution.levers)
    covariance = prediction.covariance([*names, *([] if solution.shoulder is None else ["shoulder"])])
    # a clock that is off by a moment moves the whole path along itself
    common = common_error(model) + clock_sigma_s**2 * state.v[:, None] * state.v
    common = common + np.outer(offset, offset)
    covariance[:3, :3] += np.outer(turn, turn)
    p, R = state.p + offset, Rotation.from_rotvec(turn).as_matrix() @ state.R
    pose = covariance[_POSE]
    pose[:3, :3] += common
    places, spreads = {}, {}
    for k, joint in enumerate(names):
        places[joint], spread = joint_at(R, p, solution.levers[joint], k, covariance)
        spreads[joint] = spread + common
    if solution.shoulder is not None:
        places["shoulder"], spreads["shoulder"] = solution.shoulder, covariance[-3:, -3:].copy()
    return LiveEstimate(
        t_s=state.t,
        kind=kind,
        state=known[0],
        since_s=known[1],
        position=p,
        quaternion=Rotation.from_matrix(R).as_quat(scalar_first=True),
        velocity=state.v,
        pose_covariance=widen_turns(pose[None])[0],
        joints=places,
        joint_covariance=spreads,
    )


def common_error(model: SelfCalibration) -> FloatArray:
    """Covariance (3, 3), m^2, of what the camera's errors of the forearm's joints have in common."""
    used = [JOINTS.index(joint) for joint in FOREARM_JOINTS if joint in model.joint_bias.joints]
    if model.errors.considered is None or not used:
        return np.eye(3) * model.joint_bias.sigma_m**2
    covariance = model.errors.considered.covariance[JOINT_ERRORS, JOINT_ERRORS]
    mean = np.zeros((3, covariance.shape[0]))
    for column in used:
        mean[:, 3 * column : 3 * column + 3] = np.eye(3) / len(used)
    return np.asarray(mean @ covariance @ mean.T)
