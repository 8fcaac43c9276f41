"""The elbow's flexion without what noise adds to it: errors can only bend an arm that is nearly straight.

Flexion is the length of a vector, the bend, and errors of that vector make it longer: a straight arm known to
3 degrees an axis is 4 degrees bent on average and 12 at some time, and drawn motions, which have that error
twice, are bent still more. Squares of sines add up: from the answer's mean square the stated variance of the
error is taken, and all flexion is made smaller by the factor that this leaves. (The bias is that of the
magnitude of noisy complex images: Koay and Basser, J Magn Reson 179:317-322, 2006; to match the second moment
rather than each sample leaves extremes without bias: Louis, J Am Stat Assoc 79:393-398, 1984.) An elbow that
bends by tens of degrees loses some tenths of a degree.

How large the error is is itself only stated to a factor: each drawn motion is given another one that the
answer allows, so that an interval reaches down to what the recording does not exclude.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from .motion import Motion

#: Stated variances of the error are good to this factor (one standard deviation of its logarithm).
VARIANCE_FACTOR = 2.0
#: Parts of the bend that may be left, densely where hardly anything is taken.
_LEFT = np.concatenate([np.linspace(0.002, 0.5, 100), 1.0 - np.geomspace(0.495, 1e-7, 300)])
_STEP = np.gradient(_LEFT)


@dataclass(frozen=True)
class ElbowBend:
    """How far the elbow is bent in an answer, and the error of that.

    Attributes
    ----------
    square : float
        Mean square of the sine of the answer's flexion.
    variance : float, rad^2
        Of the error of the bend, by the draws, along each of its two axes.
    """

    square: float
    variance: float

    @classmethod
    def of(cls, answer: Motion, drawn: Iterable[Motion]) -> ElbowBend | None:
        """By an answer and some of its draws; None where the bend is not known."""
        if answer.bend is None or not np.isfinite(answer.bend).any():
            return None
        errors = [
            float(np.nanmean(((motion.bend - answer.bend) ** 2).sum(axis=1)))
            for motion in drawn
            if motion.bend is not None
        ]
        square = float(np.nanmean(np.sin(np.linalg.norm(answer.bend, axis=1)) ** 2))
        return cls(square, 0.5 * float(np.mean(errors))) if errors and square > 0.0 else None

    @property
    def of_draws(self) -> float:
        """What is left of a drawn motion's bend when the second error is taken from it, 0 to 1."""
        return float(1.0 / np.sqrt(1.0 + 2.0 * self.variance / self.square))

    def left(self, quantile: float) -> float:
        """What is left of the bend without the error's part, 0 to 1.

        Parameters
        ----------
        quantile : float, 0 to 1
            Of what the true bend may be: beforehand of any size up to the answer's, and the error's variance
            as stated to within a factor of two. 0.5 is the estimate.
        """
        if not self.variance > 0.0:
            return 1.0
        # An error across the bend lengthens it; one along it only where there is hardly a bend.
        axes = 2.0 - _LEFT**2
        factor = self.square * (1.0 - _LEFT**2) / (axes * self.variance)
        weight = np.exp(-0.5 * (np.log(factor) / np.log(VARIANCE_FACTOR)) ** 2) / factor * _STEP
        below = np.cumsum(weight)
        if not below[-1] > 0.0:  # the error is far too small to be seen
            return 1.0
        return float(np.interp(quantile * below[-1], below, _LEFT))

    def corrected(self, answer: Motion) -> Motion:
        """An answer with the flexion that is left."""
        return _lessened(answer, self.left(0.5))

    def corrected_draw(self, drawn: Motion, quantile: float) -> Motion:
        """A drawn motion with the flexion that is left; it has the error twice.

        Parameters
        ----------
        drawn : Motion
            The answer and another error.
        quantile : float, 0 to 1
            See `left`; another one for each draw.
        """
        return _lessened(drawn, self.left(quantile) * self.of_draws)

    def lower(self, low_deg: float) -> float:
        """The lower end of an angle's interval, where an error across the bend may have lengthened it."""
        cosine = np.cos(np.radians(max(low_deg, 0.0))) / np.cos(min(np.sqrt(self.variance), 1.5))
        return min(low_deg, float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def lessened(flexion: FloatArray, left: float) -> FloatArray:
    """Flexion (n,), degrees, of which a part is left: that part near straight, all of it from 90 degrees on.

    An error across the bend adds half its square times the cotangent of the angle: at a right angle it turns
    the plane of the arm and nothing else.
    """
    angle = np.radians(flexion)
    return np.asarray(np.degrees(angle - (1.0 - left) * 0.5 * np.maximum(np.sin(2.0 * angle), 0.0)))


def _lessened(motion: Motion, left: float) -> Motion:
    return replace(
        motion, angles=motion.angles | {"elbow_flexion": lessened(motion.angles["elbow_flexion"], left)}
    )
