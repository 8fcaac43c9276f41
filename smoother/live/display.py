"""What is shown: the arm now and a lag ago, and the change at once that is spread over a moment."""

from __future__ import annotations

from ..window.lag_solution import LagSolution
from .answer import Circumstances, estimate_of, shown_state
from .discontinuity import SPREAD_S, Discontinuity
from .estimate import LiveEstimate
from .prediction import Prediction, predict
from .tracker import Tracker


class Display:
    """Answers of a tracker; where what is known changes at once, what is shown follows within `SPREAD_S`.

    Parameters
    ----------
    lag_s : float, s
        How long before the present `settled` is.
    """

    def __init__(self, lag_s: float) -> None:
        self._lag_s = lag_s
        self._discontinuity: Discontinuity | None = None

    def forget(self) -> None:
        """Nothing is shown any more that a change could be spread from."""
        self._discontinuity = None

    def spread(self, before: Prediction, tracker: Tracker, now_s: float) -> None:
        """Spread the change from what was shown to what a tracker knows now.

        Parameters
        ----------
        before : Prediction
            What was known, at the present.
        tracker : Tracker
            Solved.
        now_s : float, s
        """
        if tracker.solution is not None:
            after = predicted(tracker, tracker.solution, now_s)
            self._discontinuity = Discontinuity.between(
                shown_state(before.state, self._discontinuity), after.state
            )

    def now(
        self, tracker: Tracker, solution: LagSolution, now_s: float, clock_sigma_s: float, delay_s: float
    ) -> LiveEstimate:
        """The arm at the present.

        Parameters
        ----------
        tracker : Tracker
        solution : LagSolution
            Its last.
        now_s : float, s
        clock_sigma_s : float, s
            Of the camera's clock.
        delay_s : float, s
            How late frames are.
        """
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
