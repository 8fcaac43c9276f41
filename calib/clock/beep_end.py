"""Where the direct sound of a beep stops, when the room still answers.

An echo ends as abruptly as the beep does, only later and weaker. The tone's complex envelope changes at each
of these ends by what stops there, also where direct sound and echo had cancelled in part and the loudness
stays the same. So the end of the direct sound is the largest step of the complex envelope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.signal import fftconvolve, find_peaks

from smoother.array_types import FloatArray

#: How long before the end of all sound the direct sound may have ended, s.
LOOK_BACK_S = 0.35
#: Nothing is looked for so shortly after the onset, s; means on both sides of a step are so long, s.
ONSET_S, STEP_S = 0.02, 0.004
#: Steps of at least this part of the largest may be the end as well; the last of them is taken.
AS_LARGE = 0.75
#: Steps nearer to each other are one, s.
APART_S = 0.003
#: The buzzer itself rings out within these time constants, s; the tail within this one.
RING_S, TAIL_S = (1e-4, 0.006), 1.0


@dataclass(frozen=True)
class Step:
    """The step of the complex envelope at the end of the direct sound.

    Attributes
    ----------
    t_s : float, s
        Where it is, to about a millisecond.
    doubt_s : float, s
        How far away an earlier step lies that is about as large; 0 where there is none.
    """

    t_s: float
    doubt_s: float


def direct_end(samples: FloatArray, rate_hz: float, tone_hz: float, start_s: float, end_s: float) -> Step:
    """The largest step of the tone's complex envelope before all sound has ended.

    Parameters
    ----------
    samples : ndarray, shape (N,)
        The track.
    tone_hz : float, Hz
        The beep's tone.
    start_s, end_s : float, s
        Of all that sounds at that tone, to some 10 ms.

    Returns
    -------
    Step
    """
    low = max(start_s + ONSET_S, end_s - LOOK_BACK_S)
    first = max(int((low - 2 * STEP_S) * rate_hz), 0)
    last = min(int((end_s + 5 * STEP_S) * rate_hz), len(samples))
    t = np.arange(first, last) / rate_hz
    width = max(round(max(round(STEP_S * tone_hz), 2) / tone_hz * rate_hz), 8)  # whole periods
    if len(t) < 2 * width + 3:
        return Step(end_s, 0.0)
    total = np.concatenate([[0.0], np.cumsum(samples[first:last] * np.exp(-2j * np.pi * tone_hz * t))])
    mean = (total[width:] - total[:-width]) / width
    size = np.abs(mean[width:] - mean[:-width])
    at = t[width : width + len(size)]
    size = np.where(at >= low, size, 0.0)
    if not size.max() > 0:
        return Step(end_s, 0.0)
    peaks, _ = find_peaks(
        np.concatenate([[0.0], size, [0.0]]),
        height=AS_LARGE * size.max(),
        distance=max(int(APART_S * rate_hz), 1),
    )
    places = at[np.clip(peaks - 1, 0, len(at) - 1)]
    return Step(float(places[-1]), float(places[-1] - places[0]))


@dataclass(frozen=True)
class Fall:
    """A step to a decaying tail, fitted to a complex envelope.

    Attributes
    ----------
    end_s : float, s
        The step.
    variance_s2 : float, s^2
        The variance of it that the residuals leave.
    tail : float
        Size of the tail against the beep.
    decay_s : float, s
        Its time constant.
    drop : float
        What stops at once, against the beep; 1 without a tail.
    fitted : ndarray, shape (n,)
        The envelope's size as fitted.
    """

    end_s: float
    variance_s2: float
    tail: float
    decay_s: float
    drop: float
    fitted: FloatArray


def fit_fall(
    envelope: np.ndarray, kernel: FloatArray, t: FloatArray, rate_hz: float, near_s: float, slack_s: float
) -> Fall:
    """The end of a beep: before it a constant, after it the buzzer's ring and the room's tail.

    Beep and tail have a complex size each, for which the fit is linear (variable projection); end, ring and
    decay are looked for about several starts.

    Parameters
    ----------
    envelope : ndarray, shape (n,)
        Complex, the tone brought to zero frequency and low-passed with `kernel` (symmetric, m samples,
        sum 1); it begins m // 2 samples after `t` does and ends as much before.
    t : ndarray, shape (n + 2 (m // 2),), s
        Times of the samples that the envelope was made of.
    near_s, slack_s : float, s
        The end lies so near to this.

    Returns
    -------
    Fall
    """
    half = len(kernel) // 2
    inside = slice(half, len(t) - half)
    before = t[inside] < near_s - 0.003
    size = float(np.abs(np.median(envelope[before].real) + 1j * np.median(envelope[before].imag)))
    size = max(size, 1e-12)

    def parts(x: FloatArray) -> FloatArray:
        """(n, 2) what the beep and what the tail looks like."""
        end, decay, ring = x[0], np.exp(x[1]), np.exp(x[2])
        late = np.maximum(t - end, 0.0)
        after = np.clip((t - end) * rate_hz + 0.5, 0.0, 1.0)  # the part of a sample that lies behind the end
        fall = after * np.exp(-late / ring)
        shapes = np.stack([(1 - after) + fall, after * np.exp(-late / decay) - fall], axis=1)
        return np.stack([fftconvolve(shape, kernel, mode="same")[inside] for shape in shapes.T], axis=1)

    def sizes(x: FloatArray) -> tuple[FloatArray, np.ndarray]:
        seen = parts(x)
        weight = np.linalg.solve(seen.T @ seen + 1e-9 * np.eye(2), seen.T @ envelope)
        return seen, weight

    def left(x: FloatArray) -> FloatArray:
        seen, weight = sizes(x)
        rest = (seen @ weight - envelope) / size
        return np.concatenate([rest.real, rest.imag])

    low = [near_s - slack_s, np.log(RING_S[1]), np.log(RING_S[0])]
    high = [near_s + slack_s, np.log(TAIL_S), np.log(RING_S[1])]

    def fit(guess: FloatArray, steps: int) -> OptimizeResult:
        return least_squares(left, guess, bounds=(low, high), x_scale=[1e-3, 0.5, 0.5], max_nfev=steps)

    starts = [
        np.array([near_s + shift, np.log(decay), np.log(ring)])
        for decay, ring in ((0.01, 1e-3), (0.04, 3e-4), (0.04, 3e-3))
        for shift in (-0.002, 0.0)
    ]
    # a few steps from everywhere, the rest of the way from the two best places
    tried = sorted((fit(start, 6) for start in starts), key=lambda each: float(each.cost))
    best = min((fit(each.x, 40) for each in tried[:2]), key=lambda each: float(each.cost))
    # neighbouring values of the envelope share the kernel: so many of them are worth one
    worth = max(1.5 * len(kernel) / 2, 1.0)
    variance = 2 * best.cost * worth / max(2 * len(envelope) - 7 * worth, 1.0)
    spread = np.linalg.pinv(best.jac.T @ best.jac) * variance
    seen, weight = sizes(best.x)
    return Fall(
        end_s=float(best.x[0]),
        variance_s2=float(spread[0, 0]),
        tail=float(abs(weight[1]) / max(abs(weight[0]), 1e-12)),
        decay_s=float(np.exp(best.x[1])),
        drop=float(abs(weight[0] - weight[1]) / max(abs(weight[0]), 1e-12)),
        fitted=np.abs(seen @ weight),
    )
