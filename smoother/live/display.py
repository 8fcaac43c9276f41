"""What is shown: the arm now and a lag ago, and the change at once that is spread over a moment."""

from __future__ import annotations

from ..window.lag_solution import LagSolution
from .answer import Circumstances, estimate_of, shown_state
from .estimate import LiveEstimate
from .follower import Follower
from .jump import SPREAD_S, Jump
from .prediction import Prediction, predict


class Display:
    """Answers of a follower; where what is known changes at once, what is shown follows within `SPREAD_S`.

    Parameters
    ----------
    lag_s : float, s
        How long before the present `settled` is.
    """

    def __init__(self, lag_s: float) -> None:
        self._lag_s = lag_s
        self._jump: Jump | None = None

    def forget(self) -> None:
        """Nothing is shown any more that a change could be spread from."""
        self._jump = None

    def spread(self, before: Prediction, follower: Follower, now_s: float) -> None:
        """Spread the change from what was shown to what a follower knows now.

        Parameters
        ----------
        before : Prediction
            What was known, at the present.
        follower : Follower
            Solved.
        now_s : float, s
        """
        if follower.solution is not None:
            after = predicted(follower, follower.solution, now_s)
            self._jump = Jump.between(shown_state(before.state, self._jump), after.state)

    def now(
        self, follower: Follower, solution: LagSolution, now_s: float, clock_sigma_s: float, delay_s: float
    ) -> LiveEstimate:
        """The arm at the present.

        Parameters
        ----------
        follower : Follower
        solution : LagSolution
            Its last.
        now_s : float, s
        clock_sigma_s : float, s
            Of the camera's clock.
        delay_s : float, s
            How late frames are.
        """
        if self._jump is not None and now_s - self._jump.at_s > SPREAD_S:
            self._jump = None
        prediction = predicted(follower, solution, now_s)
        state, since_s = follower.history.state_now(now_s, delay_s)
        beyond_s = max(prediction.state.t - solution.newest.t, 0.0)
        shoulder = follower.noise.shoulder_walk**2 * beyond_s
        about = Circumstances("now", state, since_s, clock_sigma_s, shoulder, self._jump)
        return estimate_of(prediction, solution, follower.model, about)

    def settled(
        self, follower: Follower, solution: LagSolution, now_s: float, clock_sigma_s: float
    ) -> LiveEstimate | None:
        """The arm a lag ago; None where the window does not reach so far back. Parameters as of `now`."""
        settled_s = now_s - self._lag_s
        if settled_s < float(follower.window.t[0]):
            return None
        start = solution.settled
        prediction = predict(
            start, solution, follower.signal.since(start.t), max(settled_s, start.t), follower.noise
        )
        state, since_s = follower.history.state_at(settled_s)
        about = Circumstances("settled", state, since_s, clock_sigma_s, 0.0, None)
        return estimate_of(prediction, solution, follower.model, about)


def predicted(follower: Follower, solution: LagSolution, now_s: float) -> Prediction:
    """A solution's newest node propagated to the present."""
    return predict(solution.newest, solution, follower.signal.since(solution.newest.t), now_s, follower.noise)
