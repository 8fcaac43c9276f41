"""An accelerometer and a gyroscope of two streams become one IMU, causally."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.streams.arrivals import Rows
from smoother.streams.channels import ImuChannels, StreamLabels, belongs, is_accelerometer
from smoother.streams.lsl import ImuHalves


def sent(rate_hz: float, begin_s: float = 0.0, step_s: float = 0.0) -> Rows:
    """A half of 6 s whose values are linear in time, and whose clock steps at 3 s."""
    t = begin_s + np.arange(0.0, 6.0, 1 / rate_hz)
    values = np.stack([t, 2.0 * t, -t], axis=1)
    return Rows(t + np.where(t > 3.0, step_s, 0.0), t + 0.004, {"values": values})


def played(acc: Rows, gyro: Rows) -> tuple[Rows, list[str]]:
    """All joined samples, and what was said, played by arrival."""
    halves, out, said = ImuHalves("acc", "gyro"), [], []
    for now in np.arange(0.0, 6.2, 0.033):
        new = [each.select((each.arrival_s > now - 0.033) & (each.arrival_s <= now)) for each in (acc, gyro)]
        joined, events = halves.joined(*new)
        out.append(joined)
        said += events
    assert max(map(len, halves._waiting)) <= 201  # two seconds
    return Rows.joined(out), said


def test_the_accelerometer_is_interpolated_at_the_gyroscopes_stamps_but_not_where_it_pauses():
    acc, gyro = sent(52, begin_s=0.003), sent(100)
    acc = acc.select((acc.t_s < 1.0) | (acc.t_s > 2.0))
    joined, said = played(acc, gyro)
    t, first, second = gyro.t_s, *acc.t_s[np.searchsorted(acc.t_s, 1.5) + np.array([-1, 0])]
    inside = (t >= acc.t_s[0]) & (t <= acc.t_s[-1]) & ((t <= first) | (t >= second))
    assert not said
    np.testing.assert_array_equal(joined.t_s, t[inside])
    np.testing.assert_allclose(joined["values"][:, :3], gyro["values"][inside], atol=1e-12)  # linear: exact
    np.testing.assert_array_equal(joined["values"][:, 3:], gyro["values"][inside])
    assert not len(played(Rows(), gyro)[0])


def test_each_halfs_clock_is_put_right():
    joined, said = played(sent(50, step_s=50.0), sent(100))
    assert len(said) == 1 and "the clock of acc stepped by +50.0" in said[0]
    assert joined.t_s[-1] > 5.9
    np.testing.assert_allclose(joined["values"][:, 0], joined.t_s, atol=0.011)  # to an interval's accuracy


def stream(kind: str, unit: str = "g") -> StreamLabels:
    return StreamLabels("Muse", kind, list("XYZ"), [""] * 3, [unit] * 3)


def test_what_a_stream_is_shows_in_its_name_and_type():
    assert [is_accelerometer(stream(kind)) for kind in ("ACC", "GYRO", "EEG")] == [True, False, False]
    assert belongs("Muse", "GYRO", "Muse")
    assert belongs("phone_gyroscope", "", "phone_accelerometer")
    assert not belongs("watch_gyroscope", "", "phone_accelerometer")
    halves = ImuChannels.of(stream("ACC"), "acc"), ImuChannels.of(stream("GYRO", "deg/s"), "gyro")
    values = halves[0].with_gyroscope(halves[1], 3).values(np.array([[0.0, 0.0, 1.0, 180.0, 0.0, 0.0]]))
    np.testing.assert_allclose(np.hstack([values["acc"], values["gyro"]]), [[0, 0, 9.80665, np.pi, 0, 0]])
    with pytest.raises(RecordingError, match="cannot be used as gyroscope: its channels are X, Y, Z; gyro_x"):
        ImuChannels.of(stream("ACC"), "gyro")
