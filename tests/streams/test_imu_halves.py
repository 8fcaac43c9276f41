"""An accelerometer and a gyroscope of two streams become one IMU, causally."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.streams.arrivals import ImuRows
from smoother.streams.channels import ImuChannels, StreamLabels, belongs, half_of
from smoother.streams.lsl_source import ImuHalves


def rows(t_s: np.ndarray, late_s: float = 0.004) -> ImuRows:
    """A half whose values are linear in time."""
    values = np.stack([t_s, 2.0 * t_s, -t_s], axis=1)
    return ImuRows(t_s, values, values, t_s + late_s)


def played(acc: ImuRows, gyro: ImuRows, step_s: float = 0.033) -> tuple[ImuRows, list[str], list[float]]:
    """All joined samples, what was said, and the time at which each came out, played by arrival."""
    halves, out, said, came = ImuHalves("acc", "gyro"), [], [], []
    last = max(acc.arrival_s[-1], gyro.arrival_s[-1])
    for now in np.arange(0.0, last + 2 * step_s, step_s):
        parts = [
            each.select(np.flatnonzero((each.arrival_s > now - step_s) & (each.arrival_s <= now)))
            for each in (acc, gyro)
        ]
        joined, events = halves.joined(*parts)
        out.append(joined)
        said += events
        came += [now] * len(joined)
    return ImuRows.joined(out), said, came


def test_other_rates_and_stamps_are_interpolated_at_the_gyroscopes():
    acc, gyro = rows(0.003 + np.arange(0.0, 4.0, 1 / 52)), rows(np.arange(0.0, 4.0, 1 / 100))
    joined, said, came = played(acc, gyro)
    assert not said
    inside = gyro.t_s[(gyro.t_s >= acc.t_s[0]) & (gyro.t_s <= acc.t_s[-1])]
    np.testing.assert_array_equal(joined.t_s, inside)
    np.testing.assert_allclose(joined.acc[:, 0], joined.t_s, atol=1e-12)  # linear in time: exact
    np.testing.assert_allclose(joined.gyro[:, 1], 2.0 * joined.t_s, atol=1e-12)
    assert (np.array(came) - joined.t_s).max() < 1 / 52 + 0.004 + 2 * 0.033  # nothing waits longer


def test_nothing_is_made_up_where_the_accelerometer_pauses():
    acc, gyro = rows(np.arange(0.0, 4.0, 0.02)), rows(np.arange(0.0, 4.0, 0.01))
    paused = acc.select(np.flatnonzero((acc.t_s < 1.0) | (acc.t_s > 2.0)))
    joined, _, _ = played(paused, gyro)
    assert not ((joined.t_s > 1.0) & (joined.t_s < 2.0)).any()
    assert ((joined.t_s > 2.1) & (joined.t_s < 3.9)).sum() > 150


def test_a_half_that_never_comes_holds_no_memory():
    halves = ImuHalves("acc", "gyro")
    for start in range(60):
        joined, _ = halves.joined(ImuRows(), rows(start + np.arange(0.0, 1.0, 0.01)))
        assert not len(joined)
    assert len(halves._gyro) <= 201  # two seconds


def test_each_halfs_clock_is_put_right():
    acc, gyro = rows(np.arange(0.0, 6.0, 0.02)), rows(np.arange(0.0, 6.0, 0.01))
    stepped = acc.stamped(acc.t_s + np.where(acc.t_s > 3.0, 50.0, 0.0))
    joined, said, _ = played(stepped, gyro)
    assert len(said) == 1 and "the clock of acc stepped by +50.0" in said[0]
    assert joined.t_s[-1] > 5.9
    np.testing.assert_allclose(joined.acc[:, 0], joined.t_s, atol=0.011)  # to an interval's accuracy


def stream(kind: str, labels: str = "XYZ", unit: str = "g", name: str = "Muse") -> StreamLabels:
    return StreamLabels(name, kind, list(labels), [""] * len(labels), [unit] * len(labels))


def test_what_a_stream_is_shows_in_its_name_and_type():
    assert (half_of(stream("ACC")), half_of(stream("GYRO")), half_of(stream("EEG"))) == ("acc", "gyro", "")
    assert belongs("Muse", "GYRO", "Muse")
    assert belongs("phone_gyroscope", "", "phone_accelerometer")
    assert not belongs("watch_gyroscope", "", "phone_accelerometer")
    acc = ImuChannels.of(stream("ACC"), "acc")
    np.testing.assert_allclose(acc.values(np.array([[0.0, 0.0, 1.0]]))["acc"], [[0.0, 0.0, 9.80665]])
    with pytest.raises(RecordingError, match="cannot be used as gyroscope: its channels are X, Y, Z; gyro_x"):
        ImuChannels.of(stream("ACC"), "gyro")
    with pytest.raises(RecordingError, match="unit of its accelerometer is missing"):
        ImuChannels.of(stream("ACC", unit=""), "acc")
