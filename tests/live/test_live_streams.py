"""Streams as they are: late, lost and back, clocks that are set; samples that cannot be right; signals."""

from __future__ import annotations

import numpy as np
import pytest
from live_play import simulated

from smoother.body import FOREARM
from smoother.live.buffers import CameraClock, FrameBuffer, Shift, ShiftCause, SkeletonFrame
from smoother.live.imu import ImuCheck, LiveImu
from smoother.live.signal import DoubtfulSignal, LiveSignal, increments_between, propagated
from smoother.measurements.inertial import InertialSignal, integrate, integrate_each
from smoother.recording import ImuStream
from smoother.rotation import Rotation, matrix_of, rotvec_of
from smoother.units import GRAVITY
from smoother.window.solution import NodeState


def batch(*times: float) -> ImuStream:
    t = np.array(times)
    return ImuStream("", t, np.outer(t, np.ones(3)), np.zeros((len(t), 3)))


def frame(t: float, arrival: float | None = None) -> SkeletonFrame:
    return SkeletonFrame(t, t + 0.1 if arrival is None else arrival, np.ones((5, 3)), np.full(5, 2, np.int8))


def test_late_samples_are_sorted_in_and_older_ones_counted():
    imu = LiveImu(FOREARM, 10.0)
    imu.add(batch(0.0, 0.01, 0.02, 0.3))
    assert imu.changed_s is None
    imu.add(batch(0.2, 0.1))
    assert imu.changed_s == 0.1
    np.testing.assert_array_equal(imu.t, [0.0, 0.01, 0.02, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(imu.stream(-np.inf).acc[:, 0], imu.t)
    imu.changed_s = None
    for times in ((1.0,), (0.4,), (1.0,), (np.nan,)):
        imu.add(batch(*times))
    assert imu.changed_s is None and (imu.late, imu.duplicate, imu.invalid) == (1, 1, 1)


def test_frames_out_of_order():
    frames = FrameBuffer(10.0)
    added = [frames.add(frame(t)) for t in (1.0, 1.2, 1.1, 1.1, 0.6, np.nan)]
    assert added == [True] * 3 + [False] * 3
    assert [each.t_s for each in frames.since(-np.inf)] == [1.0, 1.1, 1.2]
    assert (frames.late, frames.duplicate) == (2, 1)


def fed(frames: list[SkeletonFrame]) -> tuple[CameraClock, list[Shift], list[float]]:
    """A clock after 30 usual frames and these, its jumps and the stamps that it gave out."""
    clock, jumps, stamps = CameraClock(), [], []
    for each in [*(frame(k / 30) for k in range(30)), *frames]:
        taken, jump = clock.take(each)
        jumps += [] if jump is None else [jump]
        stamps += [one.t_s for one in taken]
    return clock, jumps, stamps[30:]


@pytest.mark.parametrize(
    "frames, cause, seconds",
    [
        *(
            ([frame(k / 30 + step_s, k / 30 + 0.1) for k in range(30, 45)], ShiftCause.CLOCK, -step_s)
            for step_s in (0.3, -0.3, 0.05)  # the stamps go on otherwise than before, the arrivals do not
        ),
        *(
            ([frame(k / 30, k / 30 + 0.1 + late_s) for k in range(30, 60)], ShiftCause.LATENCY, late_s)
            for late_s in (0.1, -0.06)
        ),
        ([frame(k / 30, k / 30 + 0.2) for k in range(40, 55)], ShiftCause.OPEN, 0.1),  # some were lost
    ],
)
def test_a_clock_that_is_set_and_a_latency_that_changes(frames, cause, seconds):
    clock, jumps, stamps = fed(frames)
    assert [jump.cause for jump in jumps] == [cause]
    assert jumps[0].seconds == pytest.approx(seconds, abs=1e-9)
    if cause is not ShiftCause.OPEN:
        np.testing.assert_allclose(stamps, np.arange(30, 30 + len(frames)) / 30)
    if cause is ShiftCause.LATENCY:
        assert clock.correction_s == 0.0 and clock.delay_s == pytest.approx(0.1 + seconds)


def test_a_jitter_of_arrivals_and_a_burst_are_no_jump():
    rng, clock = np.random.default_rng(2), CameraClock()
    assert not any(clock.take(frame(k / 30, k / 30 + 0.1 + rng.exponential(0.02)))[1] for k in range(400))
    held_up = [frame(k / 30, 50 / 30 + 0.1) for k in range(30, 50)]
    clock, jumps, stamps = fed([*held_up, frame(50 / 30)])
    assert not jumps and len(stamps) == 21 and clock.correction_s == 0.0


RNG = np.random.default_rng(5)
SECOND = np.arange(100) / 100.0


def moving() -> tuple[np.ndarray, np.ndarray]:
    """An arm that swings once a second, with the noise of a sensor."""
    phase = 2 * np.pi * SECOND
    acc = np.stack([3 * np.sin(phase), 2 * np.cos(phase), 9.8 + np.sin(2 * phase)], axis=1)
    gyro = np.stack([2 * np.cos(phase), np.sin(phase), 0.5 * np.sin(phase)], axis=1)
    return acc + RNG.normal(0.0, 0.03, acc.shape), gyro + RNG.normal(0.0, 0.005, gyro.shape)


def doubtful(acc, gyro) -> tuple[np.ndarray, np.ndarray]:
    found, _ = ImuCheck().doubt(SECOND, acc, gyro)
    return found[:, 0] > 0, found[:, 1] > 0


def checked(imu: ImuStream) -> LiveImu:
    """A buffer that samples came to by fives, each looked at."""
    made = LiveImu(FOREARM, 60.0)
    for first in range(0, len(imu), 5):
        made.add(imu.select(slice(first, first + 5)))
        made.check(0.0)
    return made


@pytest.mark.parametrize("seed", [1, 2])
def test_sound_samples_of_simulated_arms_are_not_doubted(seed: int):
    imu = simulated(seed, 20.0, ()).recording.imu
    doubted = (checked(imu).doubt(-np.inf) > 0).any(axis=1)
    assert doubted.sum() <= 0.002 * len(imu)  # an impact may look like a spike


@pytest.mark.parametrize("which", ["both", "acc", "gyro"])
def test_held_values_of_a_moving_arm(which):
    acc, gyro = moving()
    if which != "gyro":
        acc[40:80] = acc[40]
    if which != "acc":
        gyro[40:80] = gyro[40]
    force, rate = doubtful(acc, gyro)
    assert force[41:80].all() == (which != "gyro") and rate[41:80].all() == (which != "acc")
    assert not force[:38].any() and not rate[:38].any()


def test_what_rests_may_repeat_its_values_and_spikes_are_single_samples():
    force, rate = doubtful(np.tile([0.0, 0.0, 9.8], (100, 1)), np.zeros((100, 3)))
    assert not force.any() and not rate.any()
    acc, gyro = moving()
    acc[50] += [0.0, 60.0, 0.0]
    found, _ = ImuCheck().doubt(SECOND, acc, gyro)
    assert np.flatnonzero(found[:, 0]).tolist() == [50]
    # the velocity that is missing where it was a knock: 60 m/s^2 for 10 ms
    assert 0.2 < np.sqrt(found[50, 0]) / 0.6 < 0.6


def test_units_ranges_and_limits():
    acc, gyro = moving()
    assert doubtful(acc / 9.81, gyro)[0].mean() > 0.9
    assert doubtful(acc, gyro * 57.3)[1].mean() > 0.5
    assert doubtful(acc * 1e5, gyro)[0].all()
    acc[60:] = 0.0
    assert doubtful(acc, gyro)[0][62:].all()
    acc, gyro = moving()
    _, rate = doubtful(acc, np.clip(gyro, -1.6, 1.6))
    clipped = (np.abs(gyro) > 1.6).any(axis=1)
    assert rate[clipped].mean() > 0.9 and not rate[~clipped].any()


def test_a_doubtful_stretch_is_replaced_and_left_to_no_calibration():
    acc, gyro = moving()
    acc[40:80], gyro[40:80] = acc[40], gyro[40]
    buffer = checked(ImuStream("", SECOND, acc, gyro))
    assert np.abs(buffer.stream(-np.inf).gyro[45:75]).max() == 0.0
    assert len(buffer.sound_stream()) == 61
    assert not buffer.because or buffer.end_s - SECOND[80] < 0.5


DOWN = GRAVITY * np.array([0.0, 0.0, -1.0])
T = np.arange(0.0, 2.0, 0.01)
NODE = NodeState(1.0, np.eye(3), np.array([0.1, 0.2, 1.0]), np.array([0.3, 0.0, -0.1]))


def signal_of(t: np.ndarray = T) -> DoubtfulSignal:
    """Of a turning, accelerating arm."""
    acc = np.column_stack([np.sin(5.0 * t), np.cos(3.0 * t), GRAVITY + 0.5 * t])
    imu = LiveImu(FOREARM, 10.0)
    imu.add(ImuStream("", t, acc, np.column_stack([1.5 * np.sin(2.0 * t), np.ones_like(t), 0.3 * t])))
    return LiveSignal(imu, np.zeros((2, 3, 3))).since(0.5)


def test_there_and_back_is_where_it_began() -> None:
    signal, bias = signal_of(), np.zeros(6)
    back = propagated(propagated(NODE, 1.3, signal, bias, DOWN), NODE.t, signal, bias, DOWN)
    for name in "Rpv":
        np.testing.assert_allclose(getattr(back, name), getattr(NODE, name), atol=1e-9)


def test_missing_samples_leave_the_velocity_uncertain() -> None:
    whole, some = signal_of(), signal_of(T[(T < 1.02) | (T > 1.08)])
    sound, missing = (increments_between(signal, 1.0, 1.1, np.zeros(6)) for signal in (whole, some))
    assert missing.velocity_error[0] > sound.velocity_error[0] + 0.1  # about 6 cs at 4 m/s^2
    assert increments_between(some, 1.2, 1.3, np.zeros(6)).velocity_error[0] < 0.1


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 0.3, 1.5, 2.0, 2.2, 3.1, np.pi - 1e-9])
def test_one_rotation_is_that_of_the_stack(angle):
    rng = np.random.default_rng(3)
    for axis in rng.normal(size=(20, 3)):
        rotvec = angle * axis / np.linalg.norm(axis)
        matrix = matrix_of(rotvec)
        np.testing.assert_allclose(matrix, Rotation.from_rotvec(rotvec).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(rotvec_of(matrix), Rotation.from_matrix(matrix).as_rotvec(), atol=1e-11)


def test_intervals_one_by_one_are_those_of_the_loop():
    rng = np.random.default_rng(5)
    t = np.arange(200) / 100
    smooth = np.cumsum(rng.normal(size=(200, 6)), axis=0) * 0.3
    signal = InertialSignal(ImuStream("imu", t, smooth[:, :3] + [0, 0, 9.8], smooth[:, 3:]))
    bias = rng.normal(scale=0.05, size=6)
    edges = np.array([0.1, 0.101, 0.133, 0.2, 0.75, 1.4])
    expected, found = integrate(signal, edges, bias), integrate_each(signal, edges, bias)
    for name in ("delta_R", "delta_v", "delta_p", "dt"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
