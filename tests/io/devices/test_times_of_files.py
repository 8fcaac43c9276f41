"""Times of device tables: units, names, clocks that stray, packets, what is mended; columns that lack."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import device_files
import numpy as np
import pytest
import skeleton_files
from imu_files import motion, rows

from smoother.errors import RecordingError
from smoother.io.files import ImuFiles, import_files
from smoother.io.recording.clean import clean_imu
from smoother.io.recording.streams import ImuSamples, SkeletonTable
from smoother.io.registry import FileReader
from smoother.io.tables.imu import missing_axes, paired
from smoother.io.tables.times import Timed, count_from_zero, repaired_imu, repaired_skeleton, shifts

ROWS = 400
FORCE, TURN = motion(ROWS)
UNIX_S = 1.7e9
FILETIME, DOTNET = 116_444_736_000_000_000, 621_355_968_000_000_000


def _read(path: Path, kind: str, names: list[str], columns: np.ndarray, stamps: list[str]) -> Any:
    """A file's one stream, its times corrected."""
    lines = [",".join(cells) for cells in zip(stamps, rows(columns, form="{:.5f}"), strict=True)]
    path.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    reader = FileReader()
    (one,) = reader.read(path, reader.format_of(path, kind))
    return repaired_imu(one, str(path)) if isinstance(one, ImuSamples) else repaired_skeleton(one, str(path))


def imu(path: Path, stamps: list[str], name: str) -> Any:
    names = [f"{kind}_{axis}" for kind in ("acc", "gyr") for axis in "xyz"]
    return _read(path, "imu", [name, *names], np.hstack([FORCE, TURN]), stamps)


def skeleton(path: Path, stamps: list[str], name: str) -> Any:
    wave = 0.1 * np.sin(np.arange(len(stamps)) / 20.0)
    places = {"shoulder": 0.0, "elbow": -0.3, "wrist": -0.55}
    names = [f"right_{joint}_{axis}" for joint in places for axis in "xyz"]
    columns = [c for y in places.values() for c in (y * np.sin(wave), y * np.cos(wave), 2.0 + 0 * wave)]
    return _read(path, "skeleton", [name, *names], np.stack(columns, axis=1), stamps)


READERS = ((imu, 80.0), (skeleton, 30.0))


def counted(rate: float, per_s: float, start: int) -> list[str]:
    return [str(start + round(per_s * at / rate)) for at in range(ROWS)]


@pytest.mark.parametrize(("read", "rate"), READERS)
@pytest.mark.parametrize(
    ("per_s", "start"),
    [(1e7, round(UNIX_S * 1e7) + FILETIME), (1e7, round(UNIX_S * 1e7) + DOTNET)]
    + [(per_s, round(UNIX_S * per_s)) for per_s in (1e3, 1e6, 1e9)],
)
@pytest.mark.parametrize("name", ["timestamp", "TimeSpan", "hostTime", "captured_at", "epoch", "my_own_name"])
def test_units_by_rate_and_date(
    tmp_path: Path, read: Callable[..., Any], rate: float, per_s: float, start: int, name: str
) -> None:
    for one in (rate, 25.0):
        found = read(tmp_path / "a.csv", counted(one, per_s, start), name)
        assert 1 / np.diff(found.t_s).mean() == pytest.approx(one, rel=2e-3)
        assert found.t_s[0] == pytest.approx(UNIX_S, abs=0.1)
    if name == "my_own_name":
        assert "my_own_name was taken for the time" in " ".join(found.notes)


@pytest.mark.parametrize(
    ("read", "stamps"),
    [
        (imu, counted(80.0, 1e7, 0)),  # 8 Hz in us, or 80 in ticks
        (skeleton, counted(60.0, 1e7, 0)),
    ],
)
def test_what_is_not_certain_is_refused_by_name(
    tmp_path: Path, read: Callable[..., Any], stamps: list[str]
) -> None:
    with pytest.raises(RecordingError, match=r"column odd rises.*call it time_s"):
        read(tmp_path / "a.csv", stamps, "odd")
    # what the message names makes it readable
    assert np.diff(read(tmp_path / "a.csv", stamps, "time_ticks").t_s).mean() < 0.02


@pytest.mark.parametrize("many", [8, 80])
@pytest.mark.parametrize("repeated", [True, False])
def test_a_stamp_a_packet(tmp_path: Path, many: int, repeated: bool) -> None:
    packet = np.arange(ROWS) // many * many
    stamps = [str(10 * at) if repeated or at == row else "" for row, at in enumerate(packet.tolist())]
    found = imu(tmp_path / "a.csv", stamps, "timestamp")
    assert len(found) == ROWS
    np.testing.assert_allclose(np.diff(found.t_s), 0.01, atol=2e-4)


def test_words_of_times_that_are_not_read_are_shown(tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match=r"column time \('Sep 24 1'\) are not for certain s, .* nor dates"
    ):
        imu(tmp_path / "a.csv", [f"Sep 24 {at + 1}" for at in range(ROWS)], "time")


def test_a_counter_is_no_time(tmp_path: Path) -> None:
    found = skeleton(tmp_path / "a.csv", [str(at) for at in range(ROWS)], "packet_no")
    assert "packet_no counts rows" in " ".join(found.notes) and "assumed 30 frames" in " ".join(found.notes)
    with pytest.raises(RecordingError, match=r"no column of times.*packet_no"):
        imu(tmp_path / "a.csv", [str(at) for at in range(ROWS)], "packet_no")


@pytest.mark.parametrize(("read", "rate"), READERS)
@pytest.mark.parametrize(
    ("rows", "by_s", "says"),
    [
        (slice(100, 180), -1.42e9, "placed between"),
        (slice(100, 180), 7200.0, "placed between"),
        (slice(100, 180), 7.3, "placed between"),
        (slice(200, None), 3600.0, "it was set"),
        (slice(200, None), 5000.0, "taken for a pause"),
        (slice(None, 50), -1.7e9 + 40, "it was set"),
        (slice(300, None), 8e7, "left out"),
    ],
)
def test_clocks_that_stray_or_leap(
    tmp_path: Path, read: Callable[..., Any], rate: float, rows: slice, by_s: float, says: str
) -> None:
    t = np.arange(ROWS) / rate
    stamp = UNIX_S + t
    stamp[rows] += by_s
    found = read(tmp_path / "a.csv", [f"{one:.6f}" for one in stamp], "timestamp")
    assert says in " ".join(found.notes)
    if says == "left out":
        assert len(found.t_s) == 300
    elif "pause" not in says:
        np.testing.assert_allclose(found.t_s, UNIX_S + t, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("apart_s", [0.0, 1e-6, 1e-4])
@pytest.mark.parametrize("size", [2, 6, 12])
@pytest.mark.parametrize("kind", ["file", "recording"])
def test_packets_stamped_on_arrival(apart_s: float, size: int, kind: str) -> None:
    rate, count = 102.4, 2400
    t = np.arange(count) / rate
    late = 0.02 + np.random.default_rng(size).uniform(0, 0.3 * size / rate, count // size)
    stamp = np.repeat(t[size - 1 :: size] + late, size) + np.tile(np.arange(size) * apart_s, count // size)
    acc, gyro = motion(count)
    if kind == "file":
        found = repaired_imu(ImuSamples("", t_s=stamp, acc=acc, gyro=gyro), "a.csv").t_s
    else:
        nanos = np.rint(stamp * 1e9).astype(np.int64)
        found = clean_imu(ImuSamples("/imu/a", "a", nanos, acc, gyro, None), "a.mcap")[0].stamp_ns / 1e9
    assert found is not None and len(found) == count
    if size == 12 or not apart_s or kind == "file":  # shorter ones make no pauses
        assert np.diff(found).max() < 3 / rate and np.std(found - t) < 0.01


N = 2000
T = np.arange(N) / 100.0
RNG = np.random.default_rng(0)
ACC = RNG.normal(0, 1, (N, 3)) + np.array([0, 0, 9.81])
GYRO = RNG.normal(0, 1, (N, 3))


def table(**changes: object) -> ImuSamples:
    return replace(ImuSamples("", t_s=T.copy(), acc=ACC.copy(), gyro=GYRO.copy()), **changes)


def reordered(order: np.ndarray) -> ImuSamples:
    return table(t_s=T[order], acc=ACC[order], gyro=GYRO[order])


def test_sound_tables_and_rows_without_numbers():
    corrected = repaired_imu(table(), "a.csv")
    assert not corrected.notes and np.array_equal(corrected.t_s, T) and np.array_equal(corrected.acc, ACC)
    acc, gyro = ACC.copy(), GYRO.copy()
    acc[:2], gyro[:2], acc[100, 1], gyro[700, 0] = 0, 0, np.nan, np.inf
    corrected = repaired_imu(table(acc=acc, gyro=gyro), "a.csv")
    assert len(corrected.t_s) == N - 4 and corrected.t_s[0] == T[2]
    assert corrected.notes == [
        "Rows of zeros at the start, left out: 2.",
        "Samples that are not numbers, left out: 2.",
    ]


def test_a_watch_with_repeated_stamps_becomes_usable():
    stamps = T.copy()
    again = np.sort(RNG.choice(np.arange(1, N), N * 15 // 100, replace=False))
    stamps[again] = stamps[again - 1]
    corrected = repaired_imu(table(t_s=stamps), "watch.csv")
    assert len(corrected.t_s) == N and np.abs(corrected.t_s - T).max() < 0.01
    assert "even rate of 100." in corrected.notes[0] and "of 2000; the samples" in corrected.notes[0]


TWICE = np.repeat(np.arange(N), np.where(np.arange(N) % 100 == 7, 2, 1))
FIVE = np.r_[0:500, 504:499:-1, 505:N]


@pytest.mark.parametrize(
    ("order", "said"),
    [
        (TWICE, "repeat the one before, left out: 20."),
        (FIVE, "out of order"),
        (np.r_[0:800, 820:840, 800:820, 840:N], "out of order"),  # packets that overtook one another
        (np.r_[0:500, 1000:1500, 500:1000, 1500:N], "out of order"),  # pages of a memory
        (np.r_[1000:N, 0:1000], "out of order"),  # the second half first
        (np.r_[0:800, 700:N], ""),  # written twice
    ],
)
def test_rows_twice_or_out_of_order_are_no_clock_that_was_set_back(order: np.ndarray, said: str):
    corrected = repaired_imu(reordered(order), "a.csv")
    assert np.allclose(corrected.t_s, T) and np.array_equal(corrected.acc, ACC) and said in corrected.notes[0]


@pytest.mark.parametrize("by_s", [0.1, 0.237, 0.5, 1.0, 2.0, 60.0, 3600.0])
@pytest.mark.parametrize("jitter_s", [0.0, 1e-3])
def test_a_clock_that_was_set_back_goes_on(by_s: float, jitter_s: float):
    """Sorted, its rows would be mixed or change places; each must stay where it was measured."""
    stamps = T + RNG.uniform(-jitter_s, jitter_s, N)
    corrected = repaired_imu(table(t_s=np.where(T < 8, stamps, stamps - by_s)), "a.csv")
    assert np.array_equal(corrected.acc, ACC) and np.abs(corrected.t_s - stamps).max() < 0.0001 + 3 * jitter_s
    said = f"{by_s:.1f}" if by_s >= 1 else f"{by_s:.2f}"
    (note,) = corrected.notes
    assert jitter_s or note == (
        f"The clock was set back by {said} s at 8.0 s: the following samples continue at the usual interval."
    )
    twice = repaired_imu(table(t_s=T - by_s * (T >= 5) - 0.5 * (T >= 12)), "a.csv")
    assert np.abs(twice.t_s - T).max() < 1e-6 and ", by 0.50 s at 12.0 s" in twice.notes[0]
    frames = np.arange(0, N, 4)
    skeleton = SkeletonTable(0, np.where(T < 8, T, T - by_s)[frames], {"wrist": ACC[frames]}, {})
    frames_mended = repaired_skeleton(skeleton, "k.csv")
    if by_s > 0.1:  # three frames of a camera are no clock
        assert np.abs(frames_mended.t_s - T[frames]).max() < 1e-6
        assert np.array_equal(frames_mended.position["wrist"], ACC[frames])


@pytest.mark.parametrize(
    ("stamped", "said"), [(False, "misses stay missing: 41"), (True, "nothing is put there: 41")]
)
def test_lost_packets_stay_missing(stamped: bool, said: str):
    keep = np.delete(np.arange(N), np.r_[300:340, 900])
    counter = {"counter": (keep + 65_000) % 65_536, "counter_wraps": 65_536}
    times = {"t_s": T[keep]} if stamped else {"t_s": None, "rate_hz": 100.0}
    corrected = repaired_imu(table(acc=ACC[keep], gyro=GYRO[keep], **times, **counter), "a.txt")
    assert np.allclose(corrected.t_s, T[keep]) and said in corrected.notes[0]


@pytest.mark.parametrize("row", [0, 700, N - 1])
@pytest.mark.parametrize("stamp", [1e11, -1e11, 1e300])
def test_a_stamp_that_no_file_can_hold_is_left_out(row: int, stamp: float):
    """As nanoseconds it would wrap: a first one like that made every other stamp wrong."""
    stamps = T.copy()
    stamps[row] = stamp
    mended = repaired_imu(table(t_s=stamps), "a.csv")
    assert np.array_equal(mended.t_s, np.delete(T, row)) and len(mended.acc) == N - 1
    assert mended.notes == ["Samples without a time, left out: 1."]
    unset = np.where(np.arange(N) < 3, 0.0, 1.7e9 + T)
    assert repaired_imu(table(t_s=unset), "a.csv").t_s[0] == 1.7e9 + T[3]
    frames = repaired_skeleton(SkeletonTable("", stamps, {"wrist_right": ACC.copy()}, {}), "a.csv")
    assert np.array_equal(frames.t_s, np.delete(T, row))


MIX = np.random.default_rng(1)
SHUFFLED = np.cumsum(MIX.exponential(0.01, N)) - 3 * (MIX.random(N) < 0.4)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"t_s": None}, r"neither times nor a rate.*import describe a.csv"),
        ({"t_s": SHUFFLED}, "stamps repeat or go back"),
        ({"acc": np.full((N, 3), np.nan)}, r"too few usable samples \(0\)"),
    ],
)
def test_what_cannot_be_mended_is_said(changes: dict[str, object], said: str):
    with pytest.raises(RecordingError, match=said):
        repaired_imu(table(**changes), "a.csv")


def test_frames():
    t, state = np.arange(300) / 30, {"wrist_left": np.full(300, 2, np.int8)}
    body = SkeletonTable(0, None, {"wrist_left": RNG.normal(0, 1, (300, 3))}, state, rate_hz=30.0)
    assert np.allclose(repaired_skeleton(body, "k.csv").t_s, t)
    wrapped = np.mod(t + 2**32 * 1e-6 - 4, 2**32 * 1e-6)
    assert np.allclose(np.diff(repaired_skeleton(replace(body, t_s=wrapped), "k.csv").t_s), 1 / 30)


def test_two_files_of_a_sensor():
    slow_t = np.arange(0.5, 19, 1 / 50)
    slow_t = slow_t[(slow_t < 8) | (slow_t > 9)]  # a pause of the accelerometer
    force = np.stack([slow_t, 0 * slow_t, 9.81 + 0 * slow_t], axis=1)
    slow = ImuSamples("", t_s=slow_t, acc=force, units="g")
    fast = ImuSamples("", t_s=T, gyro=GYRO, units="deg/s")
    joined = paired([slow, fast], "acc.csv, gyro.csv")
    assert joined.t_s[0] >= 0.5 and not ((joined.t_s > 8.01) & (joined.t_s < 8.99)).any()
    assert np.allclose(joined.acc[:, 0], joined.t_s) and joined.units == "g, deg/s"
    assert "50.0 Hz" in joined.notes[0] and "without accelerometer, left out" in joined.notes[1]
    late = [slow, replace(fast, t_s=T + 100)]
    for wrong, said in (([fast], "no acc"), ([slow, slow], "2 accelerometers"), (late, "share too few")):
        with pytest.raises(RecordingError, match=said):
            paired(wrong, "acc.csv")


def test_clocks_with_nothing_in_common_start_at_zero():
    camera = Timed("camera", 1.7e9 + np.arange(0, 20, 1 / 30), False)
    wrist, arm = (Timed(name, 300 + at + T, True) for name, at in (("wrist", 0.0), ("arm", 0.5)))
    shift, (sentence,) = shifts([camera, wrist, arm])
    assert shift == [-1.7e9, -300.0, -300.0]  # the two IMUs share a clock
    assert "is unrelated to" in sentence and "2023-11-14" in sentence
    assert shifts([camera, Timed("wrist", 1.7e9 + 4.8 + T, True)]) == ([0.0, 0.0], [])
    assert shifts([camera, wrist], imu_starts_at_s=-2.5)[0] == [0.0, 1.7e9 - 302.5]
    further = Timed("left", 300 + camera.t_s - 1.7e9, False, is_further=True)  # the wrist's clock by chance
    assert shifts([camera, further, wrist])[0] == [-1.7e9, 0.0, -300.0]


def test_files_that_each_count_from_zero():
    camera, wrist = Timed("camera", np.arange(0, 20, 1 / 30), False, "a"), Timed("wrist", 0.3 + T, True, "b")
    assert count_from_zero([camera, wrist])
    assert not count_from_zero([camera, replace(wrist, source="a")])  # one file, one clock
    longer = replace(camera, t_s=np.arange(0, len(T) * (T[1] - T[0]) + 15, 1 / 30))
    assert count_from_zero([longer, replace(wrist, t_s=7.0 + T)])  # from its own start, and of another length
    of_one = replace(camera, t_s=np.linspace(0, T[-1] - T[0], 600))
    assert not count_from_zero([of_one, replace(wrist, t_s=7.0 + T)])
    assert not count_from_zero([longer, replace(wrist, t_s=700.0 + T)])
    assert not count_from_zero([camera]) and not count_from_zero([])


#: Columns of example files that are taken away, of sensors and of joints.
MISSING = {
    "xsens_dot": ("Acc_Z",),
    "xsens_mt": ("Gyr_Z",),
    "shimmer": ("S_Accel_WR_Z_CAL", "S_Gyro_X_CAL"),
    "ximu": ("Gyroscope Z (deg/s)", "Accelerometer Y (g)"),
    "nilspod": ("gyr_z", "acc_x"),
    "metamotion": ("z-axis (g)",),
    "sensorlog": ("accelerometerAccelerationZ(G)",),
    "phyphox": ("Acceleration Z (m/s^2)", "Gyroscope X (rad/s)"),
    "android": ("az", "gy"),
    "kinect_v2": ("WristRight_z",),
    "mediapipe": ("right_wrist_z",),
    "joint_table": ("right_elbow_x",),
    "azure_csv": ("WRIST_RIGHT (z)",),
}


def without(path: Path, column: str) -> Path:
    """The table of a file without a column."""
    lines = path.read_text(encoding="utf-8").splitlines()
    mark = next((one for one in "\t;" if any(one in line for line in lines)), ",")
    cells = [line.split(mark) for line in lines]
    names = [[name.strip('"') for name in row] for row in cells]
    header = next(at for at, row in enumerate(names) if column in row)
    for row in cells[header:]:
        del row[names[header].index(column)]
    path.write_text("\n".join(mark.join(row) for row in cells) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("made", "column"), [(made, one) for made, each in MISSING.items() for one in each])
def test_a_missing_axis_is_named(tmp_path: Path, made: str, column: str) -> None:
    """It was "has no gyroscope", of a file with two thirds of one, or "the wrist was never tracked"."""
    path = tmp_path / "a.csv"
    getattr(device_files if hasattr(device_files, made) else skeleton_files, made)(path)
    streams = ([], [ImuFiles((without(path, column),), "forearm_right")])
    with pytest.raises(RecordingError) as told:
        import_files(*(([path], []) if list(MISSING).index(made) > 8 else streams))
    assert f"has no column {column} beside " in str(told.value)
    assert str(told.value).endswith("; export it again with all three axes.")


def test_a_second_sensor_without_an_axis_is_said(tmp_path: Path) -> None:
    path = tmp_path / "opal.csv"
    device_files.apdm(path)
    file, _ = import_files([], [ImuFiles((without(path, "Sternum/Angular Velocity/Z"),))])
    assert len(file.imus) == 1
    assert any("no column Sternum/Angular Velocity/Z beside" in note for note in file.notes)


def test_numbered_landmarks_rows_of_joints_and_places_in_the_image(tmp_path: Path) -> None:
    path, names = tmp_path / "a.csv", [f"{axis}{number}" for number in range(33) for axis in "xyz"]
    lines = [",".join(f"{value:.5f}" for value in frame.ravel()) for frame in skeleton_files.landmarks(30)]
    path.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    assert import_files([path], [])[0].arms
    with pytest.raises(RecordingError, match="has no column z16 beside x16 and y16"):
        import_files([without(path, "z16")], [])
    device_files.joint_rows(path)
    with pytest.raises(RecordingError, match=r"an unknown format \(it has no column z beside x and y\)"):
        import_files([without(path, "z")], [])
    skeleton_files.azure_csv(path)  # and its place in the image
    lines = path.read_text(encoding="utf-8").splitlines()
    lines = [f"{lines[0]},Wrist.Right.x,Wrist.Right.y", *(f"{line},100,200" for line in lines[1:])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert import_files([path], [])[0].arms


def test_only_two_of_three_are_a_vector_without_one() -> None:
    assert missing_axes(["t", "index", "max", "ax", "ay", "az", "Quat_X", "roll_x"]) == {}
    assert list(missing_axes(["LWrist.Y", "LWrist.Z", "x1", "z1"])) == ["LWrist.X", "y1"]
