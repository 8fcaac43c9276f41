"""The end of a beep in a room, and sound that has none."""

from __future__ import annotations

import numpy as np
import pytest

from calib.clock.beeps import find_beeps
from smoother.errors import CalibrationError
from smoother.simulation.clocks import beep


@pytest.mark.parametrize(
    ("rate_hz", "quiet_db", "limit_s"), [(16000, 25.0, 1e-3), (44100, 25.0, 1e-3), (16000, 10.0, 2e-3)]
)
def test_the_end_to_a_millisecond(rate_hz: int, quiet_db: float, limit_s: float):
    """Also with a voice, an echo and a buzzer that rings out; noise at 10 dB is a running fan beside it."""
    errors, sigmas = [], []
    for seed in range(6):
        sound, end, tone = beep(seed, rate_hz, quiet_db)
        (found,) = find_beeps(sound, rate_hz)
        assert abs(found.frequency_hz - tone) < 20
        errors.append(found.end_s - end)
        sigmas.append(found.sigma_s)
    assert np.abs(errors).max() < limit_s
    assert np.mean(np.square(np.array(errors) / sigmas)) < 3


def test_several_beeps_in_order():
    first, end, _ = beep(1, room_s=0.2)
    (once,) = find_beeps(first, 16000)
    twice = find_beeps(np.concatenate([first, first]), 16000)
    assert len(twice) == 2
    assert twice[1].end_s - twice[0].end_s == pytest.approx(len(first) / 16000, abs=3e-4)
    assert abs(once.end_s - end) < 1e-3


def test_an_echo_as_loud_as_the_beep_costs_sigma():
    (found,) = find_beeps(beep(2, room_s=0.0)[0], 16000)
    assert not found.loud_room
    t = np.arange(16000 * 3) / 16000
    tail = np.where(t < 1.5, 1.0, 0.9 * np.exp(-(t - 1.5) / 0.08)) * (t > 1.0) * np.sin(2 * np.pi * 3000 * t)
    (loud,) = find_beeps(tail + 1e-3 * np.random.default_rng(0).normal(size=len(t)), 16000)
    assert loud.loud_room and loud.sigma_s > 0.01 and abs(loud.end_s - 1.5) < 3 * loud.sigma_s


@pytest.mark.parametrize(("delay_s", "gain"), [(0.015, 0.6), (0.04, 0.4), (0.08, 0.5)])
def test_a_single_echo_is_not_taken_for_the_beep(delay_s: float, gain: float):
    """An echo may cancel the direct sound in part: the loudness then stays as it was when the beep stops."""
    errors, sigmas = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        rate, end, tone = 16000, 1.5 + rng.uniform(0, 1e-3), rng.uniform(600, 4000)
        t = np.arange(int(2.5 * rate)) / rate
        ring = np.where(t < end, 1.0, np.exp(-np.maximum(t - end, 0) / 1e-3)) * (t > 0.8)
        direct = 0.5 * ring * np.sin(2 * np.pi * tone * t)
        sound, late = direct.copy(), int(delay_s * rate)
        sound[late:] += gain * direct[:-late]
        (found,) = find_beeps(sound + 3e-3 * rng.normal(size=len(t)), rate)
        errors.append(found.end_s - end)
        sigmas.append(found.sigma_s)
    assert np.abs(errors).max() < 1.5e-3
    assert (np.abs(errors) < 3 * np.array(sigmas)).all()


@pytest.mark.parametrize("rate_hz", [8000, 48000])
def test_a_track_that_is_nearly_all_beep(rate_hz: int):
    t = np.arange(int(2.1 * rate_hz)) / rate_hz
    sound = 0.5 * np.sin(2 * np.pi * 1500 * t) * ((t > 0.02) & (t < 2.0))
    (found,) = find_beeps(sound + 1e-3 * np.random.default_rng(0).normal(size=len(t)), rate_hz)
    assert abs(found.end_s - 2.0) < 5e-4


def test_the_tone_may_be_named():
    sound, end, tone = beep(4)
    t = np.arange(len(sound)) / 16000
    louder = sound + 4 * np.sin(2 * np.pi * 1200 * t) * ((t > 0.3) & (t < 0.6))
    (found,) = find_beeps(louder, 16000, tone_hz=tone)
    assert abs(found.end_s - end) < 1e-3


@pytest.mark.parametrize(
    ("sound", "said"),
    [
        (np.zeros(16000), "is silent"),
        (np.ones(100), "record at least a second"),
        (np.random.default_rng(0).normal(size=32000), "no beep stands out"),
        (
            np.sin(np.arange(32000)) * (np.arange(32000) > 16000) + 1e-3 * np.cos(0.1 * np.arange(32000)),
            "does not end",
        ),
    ],
)
def test_sound_without_a_beep_that_ends(sound: np.ndarray, said: str):
    with pytest.raises(CalibrationError, match=said):
        find_beeps(sound, 16000)
