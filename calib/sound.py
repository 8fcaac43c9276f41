"""When a beep ends in a sound track: the event that links a microphone's clock to a buzzer's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import minimum_filter1d, uniform_filter1d
from scipy.optimize import OptimizeResult, least_squares
from scipy.signal import ShortTimeFFT, fftconvolve, find_peaks, get_window

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import parabola_vertex, runs

from .clock import Beep, Receptions

#: How long before the end of all sound the direct sound may have ended, s.
LOOK_BACK_S = 0.35
#: The time after the onset that is not searched, s; length of the means on both sides of a step, s.
ONSET_S, STEP_S = 0.02, 0.004
#: Steps of at least this part of the largest may be the end as well; the last of them is taken.
AS_LARGE = 0.75
#: Steps nearer to each other are one, s.
APART_S = 0.003
#: The buzzer itself rings out within these time constants, s; the tail within this one.
RING_S, TAIL_S = (1e-4, 0.006), 1.0


def direct_end(
    samples: FloatArray,  # (N,)
    rate_hz: float,
    tone_hz: float,
    start_s: float,
    end_s: float,
) -> tuple[float, float]:
    """The largest step of the tone's complex envelope before all sound has ended, to about a millisecond.

    And how far away an earlier step lies that is about as large; 0 where there is none.
    """
    low = max(start_s + ONSET_S, end_s - LOOK_BACK_S)
    first = max(int((low - 2 * STEP_S) * rate_hz), 0)
    last = min(int((end_s + 5 * STEP_S) * rate_hz), len(samples))
    t = np.arange(first, last) / rate_hz
    width = max(round(max(round(STEP_S * tone_hz), 2) / tone_hz * rate_hz), 8)  # whole periods
    if len(t) < 2 * width + 3:
        return end_s, 0.0
    total = np.concatenate([[0.0], np.cumsum(samples[first:last] * np.exp(-2j * np.pi * tone_hz * t))])
    mean = (total[width:] - total[:-width]) / width
    size = np.abs(mean[width:] - mean[:-width])
    at = t[width : width + len(size)]
    size = np.where(at >= low, size, 0.0)
    if not size.max() > 0:
        return end_s, 0.0
    peaks, _ = find_peaks(
        np.concatenate([[0.0], size, [0.0]]),
        height=AS_LARGE * size.max(),
        distance=max(int(APART_S * rate_hz), 1),
    )
    places = at[np.clip(peaks - 1, 0, len(at) - 1)]
    return float(places[-1]), float(places[-1] - places[0])


def fit_fall(
    envelope: np.ndarray, kernel: FloatArray, t: FloatArray, rate_hz: float, near_s: float, slack_s: float
) -> tuple[float, float, float, float, float]:
    """The end of a beep: before it a constant, after it the buzzer's ring and the room's tail.

    The step, s, and its variance; the tail's size against the beep, its time constant, s, and what stops at
    once against the beep.
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
    # neighbouring values of the envelope share the kernel: this many of them are worth one
    worth = max(1.5 * len(kernel) / 2, 1.0)
    variance = 2 * best.cost * worth / max(2 * len(envelope) - 7 * worth, 1.0)
    spread = np.linalg.pinv(best.jac.T @ best.jac) * variance
    _, weight = sizes(best.x)
    tail, drop = (abs(part) / max(abs(weight[0]), 1e-12) for part in (weight[1], weight[0] - weight[1]))
    return float(best.x[0]), float(spread[0, 0]), float(tail), float(np.exp(best.x[1])), float(drop)


#: Frames of the first search, s.
FRAME_S, HOP_S = 0.010, 0.0025
#: Buzzers sound in this range, Hz.
TONES_HZ = (400.0, 12_000.0)
#: A beep lasts at least this long, s, is this far above the quiet, dB, and ends when it fell this far, dB.
SHORTEST_S = 0.03
LOUD_DB = 18.0
FALL_DB = 8.0
KNEE_DB = 3.0
#: The quiet shows in this many frames in a row.
QUIET_FRAMES = 12
#: Two beeps nearer than this are one, s.
PAUSE_S = 0.05
#: Envelope: width of the low-pass, s, and how far before and after the end it is fitted, s.
SMOOTH_S = 0.0012
BEFORE_S, AFTER_S = 0.020, 0.060
#: The end lies so near to the largest step, s; with two as large, sigma is this part of their distance.
SLACK_S, DOUBT_PART = 0.012, 0.5
#: What a step with an exponential tail leaves out: in any case, s, and as a part of the tail's length, for a
#: tail as loud as what stops.
MODEL_SIGMA_S = 0.00015
TAIL_PART = 0.03
#: A tail as loud as this part of the beep, and this long, s, is the room's: its knee may hide the end.
LOUD_TAIL, LONG_TAIL_S = 0.45, 0.015
#: Batches of a long track, s.
BATCH_S = 60.0


def find_beeps(
    samples: FloatArray,  # (N,)
    rate_hz: float,
    tone_hz: float | None = None,
) -> list[Beep]:
    """All beeps of a track, in order."""
    samples = np.asarray(samples, dtype=float)
    if len(samples) < 0.1 * rate_hz:
        raise CalibrationError(
            f"the sound lasts {len(samples) / rate_hz:.2f} s only; record at least a second"
        )
    if not np.isfinite(samples).all() or not np.ptp(samples) > 0:
        raise CalibrationError("the sound is silent; check that the microphone is on")
    frames_t, frequency, power = _spectrogram(samples, rate_hz)
    level, at, above = _clearest(power, frequency, tone_hz)
    if above < LOUD_DB:
        raise CalibrationError(
            f"no beep is loud enough (the clearest tone, {frequency[at]:.0f} Hz, is {above:.0f} dB above"
            f" the background, {LOUD_DB:.0f} are needed); bring the buzzer nearer to the microphone"
        )
    beeps = []
    for first, last in _runs(level):
        # the room's answer may be loud for long: the beep ends where its own level is left
        plateau = float(np.median(level[first : last + 1]))
        held = first + int(np.flatnonzero(level[first : last + 1] > plateau - KNEE_DB)[-1])
        start, end = float(frames_t[first]), float(frames_t[held])
        tone = _tone(samples, rate_hz, start, end, float(frequency[at]))
        beeps.append(_fit_end(samples, rate_hz, start, end, tone, above))
    if not beeps:
        raise CalibrationError(
            "the sound contains a tone that does not end; also record the silence after it"
        )
    return beeps


def _spectrogram(samples: FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frame centres (n,), frequencies (f,) and power (n, f) in the range of buzzers."""
    size, hop = max(int(FRAME_S * rate_hz), 16), max(int(HOP_S * rate_hz), 4)
    frames = ShortTimeFFT(get_window("hann", size), hop, rate_hz)
    band = (frames.f >= TONES_HZ[0]) & (frames.f <= min(TONES_HZ[1], 0.45 * rate_hz))
    first, last = -(-size // 2 // hop), (len(samples) - size // 2) // hop + 1
    step = max(int(BATCH_S / HOP_S), 1)
    parts = [
        frames.spectrogram(samples, p0=k, p1=min(k + step, last))[band].T.astype(np.float32)
        for k in range(first, last, step)
    ]
    return np.arange(first, last) * hop / rate_hz, np.asarray(frames.f[band]), np.concatenate(parts)


def _clearest(
    power: FloatArray, frequency: FloatArray, tone_hz: float | None
) -> tuple[FloatArray, int, float]:
    """Level (n,) dB of the clearest tone above its quiet, its place, and by how much it exceeds it, dB."""
    power = power + 1e-12 * float(power.max())
    # of a track that is nearly all beep, the quiet is what little there is beside it
    lasting = uniform_filter1d(power, QUIET_FRAMES, axis=0)
    quiet = np.minimum(np.percentile(power, 10, axis=0), np.percentile(lasting, 1, axis=0))
    # a tone has its power in one place, a voice or an impact has it everywhere
    share = power / power.sum(axis=1, keepdims=True)
    level = 10 * np.log10(power / quiet)
    frames = max(round((SHORTEST_S - FRAME_S) / HOP_S), 1)
    lasting = minimum_filter1d(level + 10 * np.log10(share), frames, axis=0)
    best = lasting.max(axis=0)
    if tone_hz is not None:
        best = np.where(np.abs(frequency - tone_hz) <= 1.5 * (frequency[1] - frequency[0]), best, -np.inf)
    at = int(np.argmax(best))
    frame = int(np.argmax(lasting[:, at]))
    return level[:, at], at, float(minimum_filter1d(level[:, at], frames)[frame])


def _runs(level: FloatArray) -> list[tuple[int, int]]:
    """First and last frame of every beep that also ends in the track."""
    top = float(np.percentile(level[level > level.max() - FALL_DB], 50))
    loud = level > max(top - FALL_DB, 0.5 * LOUD_DB)
    beeps: list[tuple[int, int]] = []
    for frames in runs(loud):
        first, last = frames.start, frames.stop - 1
        if beeps and (first - beeps[-1][1]) * HOP_S < PAUSE_S:
            beeps[-1] = (beeps[-1][0], last)
        else:
            beeps.append((first, last))
    return [
        (first, last)
        for first, last in beeps
        if (last - first) * HOP_S >= SHORTEST_S - FRAME_S and last < len(level) - 2
    ]


def _tone(samples: FloatArray, rate_hz: float, start_s: float, end_s: float, near_hz: float) -> float:
    """The tone's frequency inside the beep, Hz: the peak of a long transform, between bins by a parabola."""
    part = samples[int(start_s * rate_hz) : max(int(end_s * rate_hz), int(start_s * rate_hz) + 16)]
    size = 1 << int(np.ceil(np.log2(8 * len(part))))
    spectrum = np.abs(np.fft.rfft(part * np.hanning(len(part)), size))
    frequency = np.fft.rfftfreq(size, 1 / rate_hz)
    near = np.flatnonzero(np.abs(frequency - near_hz) < 1.5 / FRAME_S)
    return parabola_vertex(np.asarray(frequency[near], dtype=np.float64), -np.log(spectrum[near] + 1e-300))


def _fit_end(
    samples: FloatArray, rate_hz: float, start_s: float, end_s: float, tone_hz: float, above_db: float
) -> Beep:
    """The end of one beep: a step to a decaying tail, fitted to the complex envelope of its tone."""
    near, doubt = direct_end(samples, rate_hz, tone_hz, start_s, end_s)
    before = min(BEFORE_S, 0.6 * (near - start_s) + 0.5 * FRAME_S)
    first = max(int((near - before - SMOOTH_S) * rate_hz), 0)
    last = min(int((near + AFTER_S + SMOOTH_S) * rate_hz), len(samples))
    t = np.arange(first, last) / rate_hz
    # shortly before its end: the phase must not turn in the envelope that is fitted
    tone_hz = _tone(samples, rate_hz, max(start_s + 0.01, near - 0.1), near - 0.003, tone_hz)
    periods = max(round(SMOOTH_S * tone_hz), 3)
    kernel = np.hanning(max(round(periods / tone_hz * rate_hz), 5) + 2)[1:-1]
    kernel /= kernel.sum()
    mixed = 2 * samples[first:last] * np.exp(-2j * np.pi * tone_hz * t)
    half = len(kernel) // 2
    inside = slice(half, len(t) - half)
    envelope = fftconvolve(mixed, kernel, mode="same")[inside]
    end, variance, tail, decay_s, drop = fit_fall(envelope, kernel, t, rate_hz, near, SLACK_S)
    loud_room = tail > LOUD_TAIL and decay_s > LONG_TAIL_S
    # the buzzer stops somewhere in a period of its tone, and no tail is quite exponential: the less stops
    # at once, the more the tail's shape counts
    shape = TAIL_PART * min(decay_s, AFTER_S) * min(tail, 1.0) / max(drop, 0.05)
    doubt *= DOUBT_PART
    sigma = float(np.sqrt(variance + (1 / tone_hz) ** 2 / 12 + MODEL_SIGMA_S**2 + shape**2 + doubt**2))
    loud_room |= doubt > MODEL_SIGMA_S
    return Beep(start_s, end, sigma, tone_hz, above_db, loud_room)


#: Speed of sound in a room, m/s.
SOUND_M_S = 343.0


def beeps_of_tracks(
    tracks: Iterable[tuple[FloatArray, float, float]],  # samples (N,), their rate, Hz, the first's time, s
    tone_hz: float | None = None,
    start_s: float = 0.0,
) -> list[Beep]:
    """All beeps of a sound in tracks without a pause, on the clock of its stamps."""
    beeps: list[Beep] = []
    reason: CalibrationError | None = None
    for samples, rate_hz, first_s in tracks:
        try:
            found = find_beeps(samples, rate_hz, tone_hz)
        except CalibrationError as error:
            reason = error
            continue
        shift = first_s + start_s
        beeps += [replace(beep, start_s=beep.start_s + shift, end_s=beep.end_s + shift) for beep in found]
    if not beeps and reason is not None:
        raise reason
    return beeps


def beep_receptions(
    beeps: Sequence[Beep],
    event_times_s: Sequence[float],
    clocks: tuple[str, str] = ("camera", "base"),
    *,
    distance_m: float = 0.0,
    resolution_s: float = 0.3125e-3,
    source: str = "sound",
) -> Receptions:
    """The ends of beeps on both clocks (Jatesiktat & Ang, II-G.1)."""
    if len(beeps) != len(event_times_s):
        ends = ", ".join(f"{beep.end_s:.2f} s" for beep in beeps[:12]) + (", .." if len(beeps) > 12 else "")
        raise CalibrationError(
            f"beeps that end in it: {len(beeps)} ({ends}), event times given: {len(event_times_s)}; give one"
            " --event-time for each beep, cut the sound, or name the buzzer's tone with --tone-hz"
        )
    ends_s = np.array([beep.end_s for beep in beeps]) - distance_m / SOUND_M_S
    sigma = np.array([beep.sigma_s for beep in beeps])
    return Receptions(
        event=np.repeat(np.arange(len(beeps)), 2),
        node=list(clocks) * len(beeps),
        t_s=np.column_stack([ends_s, np.sort(event_times_s)]).ravel(),
        sigma_s=np.column_stack([sigma, np.full(len(beeps), resolution_s / np.sqrt(12))]).ravel(),
        source=source,
        estimate_noise=len(beeps) > 2,
    )


def buzzer_node(nodes: Iterable[str], usual: str = "base") -> str:
    """The one node of a broadcast that is called base something, whose buzzer the camera heard."""
    named = [name for name in dict.fromkeys(nodes) if usual in name.lower()]
    return named[0] if len(named) == 1 else usual
