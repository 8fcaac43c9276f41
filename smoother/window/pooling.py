"""The shared quantities by all windows together, and by all windows but one.

The windows that the first pass asks (all of a short recording, some of each minute of a long one) answer
with a Gaussian on the biases, gravity, the upper arm's length and the lever arms. In the second pass the
answers of the others are a window's prior (never its own answer, which would count twice), widened by how
much the windows differ beyond their stated covariance (a random-effects model; DerSimonian and Laird,
Control. Clin. Trials 1986).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import inverse
from .problem import Priors
from .shared import Gaussian
from .solution import Message

#: Slow change of the biases over a recording: m/s^2/sqrt(s) and rad/s/sqrt(s).
SLOW_WALK = np.array([2e-3] * 3 + [5e-5] * 3)


@dataclass(frozen=True)
class _Information:
    """A Gaussian in information form, or a stack of them: matrix (..., s, s) and vector (..., s)."""

    matrix: FloatArray
    vector: FloatArray

    def __len__(self) -> int:
        return len(self.matrix)

    def __add__(self, other: _Information) -> _Information:
        return _Information(self.matrix + other.matrix, self.vector + other.vector)

    def __getitem__(self, k: int) -> _Information:
        return _Information(self.matrix[k], self.vector[k])

    def among(self, rows: IntArray, count: int) -> _Information:
        """A stack of this many, these in their rows; the others carry no information."""
        matrix = np.zeros((count, *self.matrix.shape[1:]))
        vector = np.zeros((count, *self.vector.shape[1:]))
        matrix[rows], vector[rows] = self.matrix, self.vector
        return _Information(matrix, vector)

    def sum(self) -> _Information:
        """All of a stack together."""
        return _Information(self.matrix.sum(axis=0), self.vector.sum(axis=0))

    def gaussian(self) -> Gaussian:
        """Mean and covariance."""
        covariance = inverse(self.matrix)
        return Gaussian(covariance @ self.vector, covariance)


def leave_one_out_priors(
    messages: Sequence[Message],
    prior: Priors,
    t_s: FloatArray | None = None,  # (k,) s
    selected: IntArray | None = None,  # int (len(messages) )
) -> Iterator[Priors]:
    """The second pass's priors: what the first pass's prior and all other windows say."""
    t = np.array([message.t_s for message in messages]) if t_s is None else t_s
    walk = np.zeros(prior.layout.size)
    walk[prior.layout.bias] = SLOW_WALK
    for segment in prior.layout.further:
        walk[prior.layout.bias_of(segment)] = SLOW_WALK
    others = leave_one_out([message.shared for message in messages], prior.shared, t, walk, selected)
    return (replace(prior, shared=shared) for shared in others)


def pooled(messages: Sequence[Message], prior: Priors) -> Gaussian:
    """The constants of the arm (upper arm, lever arms) from all windows and the prior together."""
    rows = prior.layout.constants
    answers = [_marginal(message.shared, rows) for message in messages]
    start, widened, _ = _accumulated(answers, _marginal(prior.shared, rows))
    return (start + widened.sum()).gaussian()


def pooled_shared(messages: Sequence[Message], prior: Priors) -> Gaussian:
    """The whole shared vector from all windows and the prior together, as if biases were constant."""
    start, widened, _ = _accumulated([message.shared for message in messages], prior.shared)
    return (start + widened.sum()).gaussian()


def _marginal(gaussian: Gaussian, rows: slice) -> Gaussian:
    return Gaussian(gaussian.mean[rows], gaussian.covariance[rows, rows])


def _accumulated(
    answers: Sequence[Gaussian], prior: Gaussian
) -> tuple[_Information, _Information, FloatArray]:
    """The prior, each window's own data widened by the spread between windows, and that spread."""
    before = inverse(prior.covariance)
    start = _Information(before, before @ prior.mean)
    matrix = inverse(np.array([answer.covariance for answer in answers]))
    vector = np.einsum("kij,kj->ki", matrix, np.array([answer.mean for answer in answers]))
    # each answer without the prior
    own = _Information(_positive(matrix - start.matrix), vector - start.vector)
    spread = _between_window_variance(own)
    return start, _widen(own, np.diag(spread)), spread


def leave_one_out(
    answers: Sequence[Gaussian],
    prior: Gaussian,
    t: FloatArray,  # (k,) s
    walk: FloatArray,  # (s,) unit/sqrt(s)
    selected: IntArray | None = None,  # int (len(answers) )
) -> Iterator[Gaussian]:
    """For each window, what the prior and all other windows say."""
    start, own, spread = _accumulated(answers, prior)
    count, size = len(t), len(prior.mean)
    widened = own if selected is None else own.among(selected, count)

    def wander(information: _Information, step_s: float) -> _Information:
        return _widen(information, np.diag(walk**2) * step_s)

    after = _Information(np.zeros((size, size)), np.zeros(size))
    later = _Information(np.zeros((count, size, size)), np.zeros((count, size)))
    for k in range(count - 2, -1, -1):
        after = wander(after + widened[k + 1], t[k + 1] - t[k])
        later.matrix[k], later.vector[k] = after.matrix, after.vector

    def forward() -> Iterator[Gaussian]:
        earlier = _Information(np.zeros((size, size)), np.zeros(size))
        for k in range(count):
            if k:
                earlier = wander(earlier + widened[k - 1], t[k] - t[k - 1])
            others = (start + earlier + later[k]).gaussian()
            yield Gaussian(others.mean, others.covariance + np.diag(spread))

    return forward()


def _positive(matrix: FloatArray) -> FloatArray:
    """The nearest matrices without negative eigenvalues."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + np.swapaxes(matrix, -1, -2)))
    return (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _widen(information: _Information, covariance: FloatArray) -> _Information:
    """Add a covariance to what may have no information in some directions: (I + H C)^-1 H."""
    gain = np.linalg.inv(np.eye(len(covariance)) + information.matrix @ covariance)
    matrix = gain @ information.matrix
    vector = (gain @ information.vector[..., None])[..., 0]
    return _Information(0.5 * (matrix + np.swapaxes(matrix, -1, -2)), vector)


def _between_window_variance(own: _Information) -> FloatArray:
    """Variance between windows beyond what they state, (s,), axis by axis (DerSimonian and Laird 1986)."""
    size = own.matrix.shape[-1]
    if len(own) < 3:
        return np.zeros(size)
    total = own.sum()
    mean = _Information(total.matrix + 1e-9 * np.eye(size), total.vector).gaussian().mean
    # each window's own estimate along each axis, others held at the common mean
    weight = np.einsum("kii->ki", own.matrix)
    estimate = mean + (own.vector - own.matrix @ mean) / np.maximum(weight, 1e-12)
    spread = np.zeros(size)
    for axis in range(size):
        known = weight[:, axis] > 1e-6 * weight[:, axis].max()
        w, x = weight[known, axis], estimate[known, axis]
        if len(w) < 3:
            continue
        q = np.sum(w * (x - np.sum(w * x) / np.sum(w)) ** 2)
        scale = np.sum(w) - np.sum(w**2) / np.sum(w)
        spread[axis] = max(0.0, (q - (len(w) - 1)) / scale)
    return spread
