"""What all windows together know of the shared quantities, and what each is told of it.

Each window of the first pass answers with a Gaussian on the biases, gravity, the upper arm's length
and the lever arms. A window is then told what the others found (never its own answer, which it would
count twice), widened by how much the windows differ beyond their stated covariance (a random-effects
model; DerSimonian and Laird, Control. Clin. Trials 1986).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .arrays import inverse
from .recording import FloatArray
from .shared import Gaussian
from .window import Message, Priors

#: Slow change of the biases over a recording: m/s^2/sqrt(s) and rad/s/sqrt(s).
SLOW_WALK = np.array([2e-3] * 3 + [5e-5] * 3)


@dataclass(frozen=True)
class _Information:
    """A Gaussian in information form: matrix and vector."""

    matrix: FloatArray
    vector: FloatArray

    def __add__(self, other: _Information) -> _Information:
        return _Information(self.matrix + other.matrix, self.vector + other.vector)

    def gaussian(self) -> Gaussian:
        covariance = inverse(self.matrix)
        return Gaussian(covariance @ self.vector, covariance)


def tell(messages: list[Message], prior: Priors) -> list[Priors]:
    """The second pass's priors, one a window.

    Parameters
    ----------
    messages : the first pass's answers in the order of time.
    prior : what the first pass was told, the same for all of its windows.
    """
    t = np.array([message.t_s for message in messages])
    walk = np.zeros(prior.layout.size)
    walk[prior.layout.bias] = SLOW_WALK
    told = _others([message.shared for message in messages], prior.shared, t, walk)
    return [replace(prior, shared=each) for each in told]


def combine(messages: list[Message], prior: Priors) -> Gaussian:
    """The constants of the arm (upper arm, lever arms) from all windows and the prior together."""
    part = prior.layout.constants
    answers = [_part(message.shared, part) for message in messages]
    start, widened, _ = _heard(answers, _part(prior.shared, part))
    total = start
    for each in widened:
        total = total + each
    return total.gaussian()


def _part(whole: Gaussian, part: slice) -> Gaussian:
    return Gaussian(whole.mean[part], whole.covariance[part, part])


def _heard(answers: list[Gaussian], prior: Gaussian) -> tuple[_Information, list[_Information], FloatArray]:
    """The prior, each window's own data widened by the spread between windows, and that spread."""
    before = inverse(prior.covariance)
    own = []
    for answer in answers:  # take the prior out of each answer
        matrix = inverse(answer.covariance)
        own.append(_Information(_positive(matrix - before), matrix @ answer.mean - before @ prior.mean))
    spread = _excess(own, len(prior.mean))
    start = _Information(before, before @ prior.mean)
    return start, [_widen(each, np.diag(spread)) for each in own], spread


def _others(answers: list[Gaussian], prior: Gaussian, t: FloatArray, walk: FloatArray) -> list[Gaussian]:
    """For each window, what the prior and all other windows say.

    Forward and backward filter in information form over the windows, each component wandering by
    `walk` (unit/sqrt(s), zero for a constant), each window's own deviation added.
    """
    size = len(prior.mean)
    start, widened, spread = _heard(answers, prior)
    nothing = _Information(np.zeros((size, size)), np.zeros(size))

    def sweep(order: range) -> list[_Information]:
        """What has been heard on the way to each window, in the sweep's order."""
        heard, out, last = nothing, {}, None
        for k in order:
            if last is not None:
                heard = _widen(heard, np.diag(walk**2) * abs(t[k] - t[last]))
            out[k] = heard
            heard, last = heard + widened[k], k
        return [out[k] for k in range(len(answers))]

    forward, backward = sweep(range(len(answers))), sweep(range(len(answers) - 1, -1, -1))
    told = []
    for a, b in zip(forward, backward, strict=True):
        each = (start + a + b).gaussian()
        told.append(Gaussian(each.mean, each.covariance + np.diag(spread)))
    return told


def _positive(matrix: FloatArray) -> FloatArray:
    """The nearest matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _widen(information: _Information, covariance: FloatArray) -> _Information:
    """Add a covariance to what may have no information in some directions: (I + H C)^-1 H."""
    gain = np.linalg.inv(np.eye(len(covariance)) + information.matrix @ covariance)
    matrix = gain @ information.matrix
    return _Information(0.5 * (matrix + matrix.T), gain @ information.vector)


def _excess(own: list[_Information], size: int) -> FloatArray:
    """Variance between windows beyond what they state, (size,)."""
    if len(own) < 3:
        return np.zeros(size)
    spread = np.zeros(size)
    for axis in range(size):
        weight = np.array([each.matrix[axis, axis] for each in own])
        total = _Information(
            np.sum([each.matrix for each in own], axis=0) + 1e-9 * np.eye(size),
            np.sum([each.vector for each in own], axis=0),
        ).gaussian()
        # each window's own estimate along the axis, others held at the common mean
        estimate = np.array(
            [
                total.mean[axis] + (each.vector - each.matrix @ total.mean)[axis] / max(w, 1e-12)
                for each, w in zip(own, weight, strict=True)
            ]
        )
        known = weight > 1e-6 * weight.max()
        w, x = weight[known], estimate[known]
        if len(w) < 3:
            continue
        mean = np.sum(w * x) / np.sum(w)
        q = np.sum(w * (x - mean) ** 2)
        scale = np.sum(w) - np.sum(w**2) / np.sum(w)
        spread[axis] = max(0.0, (q - (len(w) - 1)) / scale)
    return spread
