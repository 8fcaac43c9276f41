"""How smooth a movement is: spectral arc length, log dimensionless jerk, velocity peaks."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray, IntArray

#: As published (Balasubramanian et al. 2015): zero padding, highest frequency, threshold of the amplitude.
PAD_LEVEL, CUTOFF_HZ, LEAST_AMPLITUDE = 4, 10.0, 0.05
#: A shorter profile has no spectrum to speak of.
FEWEST_SAMPLES = 8


def spectral_arc_length(speed: FloatArray, rate_hz: float) -> float:
    """SPARC: minus the length of the curve of the speed's normalised amplitude spectrum; 0 = smoothest.

    Source: Balasubramanian, Melendez-Calderon, Burdet, IEEE Trans Biomed Eng 59:2126-2136 (2012);
    Balasubramanian, Melendez-Calderon, Roby-Brami, Burdet, J NeuroEng Rehabil 12:112 (2015), equation 9,
    with the parameters of the latter: the spectrum is padded to 2^4 times the next power of two, and ends at
    the last frequency below 10 Hz whose amplitude is 0.05 of the largest or more. So it depends neither on
    the movement's size nor on its duration, and noise beyond the movement's own band is left out.

    Parameters
    ----------
    speed : ndarray, shape (n,), m/s
        Of one movement from rest to rest.
    rate_hz : float, Hz
        Samples a second.

    Returns
    -------
    sparc : float
        Negative; nan for a profile of zeros or of fewer than 8 samples.
    """
    if len(speed) < FEWEST_SAMPLES or not np.isfinite(speed).all() or not speed.any():
        return float("nan")
    size = int(2 ** (np.ceil(np.log2(len(speed))) + PAD_LEVEL))
    frequency = np.arange(size // 2 + 1) * rate_hz / size
    amplitude = np.abs(np.fft.rfft(speed, size))
    amplitude /= amplitude.max()
    inside = np.flatnonzero((frequency <= CUTOFF_HZ) & (amplitude >= LEAST_AMPLITUDE))
    first, last = inside[0], inside[-1]
    if last == first:
        return float("nan")
    steps = np.diff(frequency[first : last + 1]) / (frequency[last] - frequency[first])
    return float(-np.hypot(steps, np.diff(amplitude[first : last + 1])).sum())


def log_dimensionless_jerk(speed: FloatArray, rate_hz: float) -> float:
    """LDLJ-V: minus the logarithm of the speed's squared jerk, made free of duration and peak.

    -ln(T^3 / v_peak^2 * integral of (d^2 v / dt^2)^2 dt): Balasubramanian et al., J NeuroEng Rehabil 12:112
    (2015), equations 4 and 5, of the tangential speed v. Nearer to zero = smoother; a movement of minimum
    jerk has -ln(204.8) = -5.32.

    Parameters
    ----------
    speed : ndarray, shape (n,), m/s
        Of one movement, low-passed: the second derivative of noise grows with the square of its frequency.
    rate_hz : float, Hz
        Samples a second.

    Returns
    -------
    ldlj : float
        nan for a profile without any change, or of fewer than 8 samples.
    """
    if len(speed) < FEWEST_SAMPLES or not np.isfinite(speed).all():
        return float("nan")
    jerk = np.diff(speed, 2) * rate_hz**2
    squared = float((jerk**2).sum()) / rate_hz
    peak = float(np.abs(speed).max())
    if squared <= 0.0 or peak <= 0.0:
        return float("nan")
    return float(-np.log((len(speed) / rate_hz) ** 3 / peak**2 * squared))


def velocity_peaks(speed: FloatArray, rate_hz: float, rise_m_s: float, apart_s: float) -> IntArray:
    """Rows of the maxima of a speed that stand out: movement units.

    A unit is a rise from a minimum to the next maximum by more than 20 mm/s, the maxima 150 ms or more
    apart: Alt Murphy, Willen, Sunnerhagen, Neurorehabil Neural Repair 25:71-80 (2011).

    Parameters
    ----------
    speed : ndarray, shape (n,), m/s
        Of one movement.
    rate_hz : float, Hz
        Samples a second.
    rise_m_s : float, m/s
        Least rise.
    apart_s : float, s
        Least time between two.

    Returns
    -------
    peaks : ndarray of int, shape (k,)
        In the order of time; of two that are too near the higher one stays.
    """
    from scipy.signal import find_peaks

    apart = max(round(apart_s * rate_hz), 1)
    edged = np.concatenate([[0.0], np.nan_to_num(speed), [0.0]])  # a maximum at an end is one, too
    peaks, _ = find_peaks(edged, prominence=rise_m_s, distance=apart)
    return np.asarray(peaks - 1, dtype=np.int64)
