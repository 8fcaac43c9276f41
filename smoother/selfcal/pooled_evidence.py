"""What all windows together say of errors that are constant over a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray, IntArray
from ..window.constant_errors import SIZE
from ..window.problem import Priors, Window
from ..window.solution import Solution


@dataclass(frozen=True)
class PooledEvidence:
    """Information on [gravity of each recording, the arm's constants; the errors].

    Attributes
    ----------
    information : ndarray, shape (k + SIZE, k + SIZE)
    vector : ndarray, shape (k + SIZE,)
        Information times mean, of the errors as a change of `before`.
    before : ndarray, shape (SIZE,)
        What was taken off the windows' data.
    recordings : int
        How many directions of gravity come first.
    """

    information: FloatArray
    vector: FloatArray
    before: FloatArray
    recordings: int

    @classmethod
    def of(
        cls,
        windows: Sequence[Window],
        solutions: Sequence[Solution],
        prior: Priors,
        recording_of_window: IntArray,
        before: FloatArray,
    ) -> PooledEvidence:
        """Add the windows up, and the prior on what they share once.

        Parameters
        ----------
        windows, solutions : sequence of Window, sequence of Solution
            Of one round, with their evidence.
        prior : Priors
            The windows' own, the same for all.
        recording_of_window : ndarray of int, shape (k,)
            Recordings share the arm; each has its own direction of gravity.
        before : ndarray, shape (SIZE,)
            What was taken off the windows' data.
        """
        recordings = int(recording_of_window.max(initial=0)) + 1
        constants = 2 * recordings + np.arange(prior.layout.size - prior.layout.constants.start)
        errors = 2 * recordings + len(constants) + np.arange(SIZE)
        information, vector = np.zeros((errors[-1] + 1, errors[-1] + 1)), np.zeros(errors[-1] + 1)
        for window, solution, recording in zip(windows, solutions, recording_of_window, strict=True):
            assert solution.evidence is not None
            # neighbours overlap by their margins: what both have seen counts once
            share = min((window.core_end_s - window.core_start_s) / (window.t[-1] - window.t[0]), 1.0)
            rows = np.concatenate([2 * recording + np.arange(2), constants, errors])
            information[np.ix_(rows, rows)] += share * solution.evidence.information
            vector[rows] += share * solution.evidence.vector
        own, mean = np.linalg.inv(prior.shared.covariance[6:, 6:]), prior.shared.mean
        for recording in range(recordings):
            gravity = 2 * recording + np.arange(2)
            information[np.ix_(gravity, gravity)] += own[:2, :2]
            vector[gravity] += own[:2, :2] @ mean[prior.layout.gravity]
        information[np.ix_(constants, constants)] += own[2:, 2:]
        vector[constants] += own[2:, 2:] @ mean[prior.layout.constants]
        return cls(information, vector, before, recordings)

    def posterior(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (SIZE,) and covariance (SIZE, SIZE) of the errors, of a prior about zero with a covariance."""
        errors = slice(len(self.vector) - SIZE, None)
        before = np.linalg.inv(covariance)
        information, vector = self.information.copy(), self.vector.copy()
        information[errors, errors] += before
        vector[errors] -= before @ self.before
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
        return self.before + (inverse @ vector)[errors], inverse[errors, errors]

    def shared_sensitivity(self) -> FloatArray:
        """How the shared vector follows the errors, (s, SIZE); gravity of the first recording."""
        others, errors = slice(0, len(self.vector) - SIZE), slice(len(self.vector) - SIZE, None)
        follows = -np.linalg.solve(self.information[others, others], self.information[others, errors])
        return np.concatenate([np.zeros((6, SIZE)), follows[:2], follows[2 * self.recordings :]])
