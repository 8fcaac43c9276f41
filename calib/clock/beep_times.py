"""Beeps of a sound as events on two clocks: the microphone's and that of the buzzer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError

from .beeps import Beep, find_beeps
from .links import Receptions

#: Speed of sound in a room, m/s.
SOUND_M_S = 343.0


class SoundTrack(Protocol):
    """Sound without a pause in it: samples (N,), samples a second, time of the first sample in s."""

    @property
    def samples(self) -> FloatArray:
        """(N,) sound pressure in any unit."""
        ...

    @property
    def rate_hz(self) -> float:
        """Samples a second."""
        ...

    @property
    def start_s(self) -> float:
        """Time of the first sample."""
        ...


def beeps_of_tracks(
    tracks: Iterable[SoundTrack], tone_hz: float | None = None, start_s: float = 0.0
) -> list[Beep]:
    """All beeps of a sound, on the clock of its stamps.

    Parameters
    ----------
    tracks : iterable of SoundTrack
        The sound; tracks without a beep are passed over if another has one.
    tone_hz : float, Hz, optional
        The buzzer's tone, where it is known.
    start_s : float, s
        Added to the tracks' own start: for files that begin at zero.

    Returns
    -------
    beeps : list of Beep
        In order of the tracks.

    Raises
    ------
    CalibrationError
        No track holds a beep; the reason is that of the last one.
    """
    beeps: list[Beep] = []
    reason: CalibrationError | None = None
    for track in tracks:
        try:
            found = find_beeps(track.samples, track.rate_hz, tone_hz)
        except CalibrationError as error:
            reason = error
            continue
        shift = track.start_s + start_s
        beeps += [
            replace(beep, start_s=beep.start_s + shift, end_s=beep.end_s + shift, t_s=beep.t_s + shift)
            for beep in found
        ]
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
    """The ends of beeps on both clocks (Jatesiktat & Ang, II-G.1).

    Parameters
    ----------
    beeps : sequence of Beep
        In order of time, as the microphone heard them.
    event_times_s : sequence of float, s
        When each of them ended on the buzzer's clock; any order.
    clocks : tuple of str
        Names of the microphone's clock and the buzzer's.
    distance_m : float, m
        Buzzer to microphone.
    resolution_s : float, s
        Step of the event times.
    source : str
        What to call it in messages.

    Returns
    -------
    receptions : Receptions

    Raises
    ------
    CalibrationError
        There are more or fewer beeps than event times.
    """
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
