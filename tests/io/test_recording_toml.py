"""recording.toml: tables of any layout, the guess of `import describe`, and files of its own folder only."""

from __future__ import annotations

from pathlib import Path

import device_files as made
import numpy as np
import pytest
import skeleton_files
from commands import done
from imu_files import rows

from smoother.cli.run import run
from smoother.errors import RecordingError, UnoccludeError
from smoother.io import open_csv, open_recording

CAMERA = '[camera]\nframe = "optical"\n'


def described(folder: Path, imu: str, camera: str = CAMERA) -> Path:
    (folder / "recording.toml").write_text(f"{camera}[imu.forearm_left]\n{imu}\n")
    return folder


def test_columns_by_number_with_a_preamble(tmp_path: Path):
    lines = ["some device", "2021, 22", *rows(made.MICROS // 1000, made.GYRO, made.ACC, separator=";")]
    (tmp_path / "a.dat").write_text("\n".join(lines) + "\n")
    imu = (
        'file = "a.dat"\nskip_rows = 2\nseparator = ";"\ntime_unit = "ms"\n'
        "columns = { t = 1, gx = 2, gy = 3, gz = 4, ax = 5, ay = 6, az = 7 }\n"
    )
    file = open_csv(described(tmp_path, imu))
    assert np.allclose(file.imus[0].acc, made.ACC) and np.allclose(file.imus[0].gyro, made.GYRO)
    assert file.imus[0].stamp_ns[0] == 4_000_000_000 and file.imus[0].topic == "/imu/forearm_left"


def test_columns_by_name_units_and_dates(tmp_path: Path):
    stamps = [f"2024-03-01T10:00:{5 + t:09.6f}Z" for t in made.TIME]
    body = rows(made.DEG, made.ACC / made.GRAVITY)
    lines = ["When,Wx,Wy,Wz,F x,F y,F z", *(f"{s},{row}" for s, row in zip(stamps, body, strict=True))]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    imu = (
        'file = "a.csv"\ntime_unit = "iso"\naccelerometer_unit = "g"\ngyroscope_unit = "deg/s"\n'
        'columns = { t = "when", gx = "Wx", gy = "Wy", gz = "Wz", ax = "F x", ay = "F y", az = "F z" }\n'
    )
    file = open_csv(described(tmp_path, imu))
    assert np.allclose(file.imus[0].acc, made.ACC, atol=1e-5)
    assert np.allclose(file.imus[0].gyro, made.GYRO, atol=1e-7)
    assert file.imus[0].stamp_ns[0] == 1_709_287_205_000_000_000


@pytest.mark.parametrize(("t", "unit"), [("", ""), ('t = "n", ', 'time_unit = "counter"\n')])
def test_two_files_and_a_rate(tmp_path: Path, t: str, unit: str):
    for name, values in (("a", made.ACC), ("g", made.GYRO)):
        lines = [f"n,{name}x,{name}y,{name}z", *rows(np.arange(made.COUNT), values)]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    columns = "".join(f'{{ {t}{n}x = "{n}x", {n}y = "{n}y", {n}z = "{n}z" }},\n' for n in "ag")
    imu = f'file = ["a.csv", "g.csv"]\nrate_hz = 100\n{unit}columns = [\n{columns}]\n'
    file = open_csv(described(tmp_path, imu))
    assert np.allclose(file.imus[0].acc, made.ACC) and np.allclose(file.imus[0].stamp_ns / 1e9, made.TIME)


def test_skeletons_long_and_wide(tmp_path: Path):
    made.joint_rows(tmp_path / "long.csv")
    made.EXAMPLES["azure-kinect"](tmp_path / "wide.csv")
    made.nilspod(tmp_path / "imu.csv")
    columns = "".join(f'{kind[0]}{axis} = "{kind}_{axis}"\n' for kind in ("acc", "gyr") for axis in "xyz")
    imu = f'file = "imu.csv"\ngyroscope_unit = "deg/s"\n[imu.forearm_left.columns]\nt = "t"\n{columns}'
    long = (
        f'{CAMERA}skeleton = "long.csv"\n'
        'columns = { t = "time", joint = "joint", x = "x", y = "y", z = "z" }\n'
    )
    file = open_csv(described(tmp_path, imu, long))
    left = next(arm for arm in file.arms if arm.side == "left")
    assert np.allclose(left.position[:, 2], skeleton_files.part("LWrist", made.FRAMES))
    wide = (
        f'{CAMERA}skeleton = "wide.csv"\nposition_unit = "mm"\ntime_unit = "us"\n'
        'states = { "0" = "not_tracked", "1" = "inferred", "2" = "tracked" }\n[camera.columns]\n'
        't = "timestamp"\nbody = "body_idx"\n'
        'wrist_left = ["WRIST_LEFT (x)", "WRIST_LEFT (y)", "WRIST_LEFT (z)"]\n'
        'wrist_left_state = "WRIST_LEFT (c)"\n'
    )
    (arm,) = open_csv(described(tmp_path, imu, wide)).arms
    expected = skeleton_files.expected("wrist_left", made.FRAMES, "optical") + np.array([0.1, 0, 0])
    assert arm.body == 1 and np.allclose(arm.position[:, 2], expected) and arm.state[0, 2] == 2


RATE = 'file = "a.csv"\nrate_hz = 9\n'


@pytest.mark.parametrize(
    "imu, said",
    [
        ('file = "a.csv"\ncolumns = { ax = 5, ay = 6, az = 7 }', "no times by recording.toml; give its rate"),
        (RATE + 'columns = { ax = "acc" }', "has no column 'acc'"),
        (RATE + "columns = { ax = 40 }", "has no column 40"),
        (RATE + "columns = { ax = 5 }", "lack ay, az"),
        (RATE + "columns = { temperature = 5 }", "columns.temperature is not known"),
        (RATE + "skip_rows = 900", "no rows below the first 900"),
        ('file = "a.csv"\nrate_hz = -9', "rate_hz is -9"),
        ('file = "a.csv"\nseparator = "||"', "separator is"),
        ('file = "b.csv"\nrate_hz = 9', "does not exist"),
        ('file = "a.csv"\ntime_unit = "iso"\ncolumns = { t = "t" }', "no time in iso|neither an acc"),
        ('file = ["a.csv"]\ncolumns = [{}, {}]', "1 files have 2 tables"),
        ('file = "long.csv"', "has none|line of|should be|no column"),  # a long line is not echoed
        ('file = "longer.csv"', "is not a number|line 2"),
    ],
)
def test_wrong_keys_are_one_sentence(tmp_path: Path, imu: str, said: str):
    made.nilspod(tmp_path / "a.csv")
    (tmp_path / "long.csv").write_text("x" * 500_000 + ",y\n1,2\n")
    (tmp_path / "longer.csv").write_text("t_s,ax,ay,az,gx,gy,gz\n" + "x" * 500_000 + ",1,1,1,1,1,1\n")
    with pytest.raises(RecordingError, match=said) as error:
        open_csv(described(tmp_path, imu))
    assert len(str(error.value)) < 600


@pytest.mark.parametrize("key", ["nilspod", "xsens-dot", "x-imu", "shimmer", "phyphox", "xsens-mt"])
def test_a_described_table_goes_in(tmp_path: Path, key: str, capsys: pytest.CaptureFixture[str]):
    """What `import describe` prints is a recording.toml that gives what the file's own importer gives."""
    made.EXAMPLES[key](tmp_path / "imu.csv")
    done("import", "describe", tmp_path / "imu.csv")
    (tmp_path / "recording.toml").write_text(capsys.readouterr().out)
    done("import", "csv", tmp_path, "-o", tmp_path / "r.mcap")
    (imu,) = open_recording(tmp_path / "r.mcap").imus
    assert np.allclose(imu.acc, made.ACC, atol=1e-4) and np.allclose(imu.gyro, made.GYRO, atol=1e-4)
    assert np.allclose(np.diff(imu.stamp_ns), 1e7, atol=1e4) and imu.topic == "/imu/forearm_right"


def test_a_described_skeleton_and_what_is_unsure(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    made.EXAMPLES["azure-kinect"](tmp_path / "body.csv")
    (tmp_path / "numbers.csv").write_text("\n".join(rows(made.ACC, made.GYRO)) + "\n")
    (tmp_path / "words.csv").write_text("a,b\nx,y\n")
    for name, said in (
        ("body.csv", ('position_unit = "mm"', 'frame = "optical"', "# unsure: states")),
        ("numbers.csv", ("ax = 1", "gx = 4", "rate_hz is a guess")),
    ):
        done("import", "describe", tmp_path / name)
        text = capsys.readouterr().out
        assert all(each in text for each in said)
    assert run(["import", "describe", str(tmp_path / "words.csv")]) == 1


IMU = "t_s,ax,ay,az,gx,gy,gz\n" + "".join(f"{i / 100},0,0,9.81,0,0,0\n" for i in range(50))
SECRET = "admin:c0rrect-horse:battery,staple\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording's folder, with files beside it and a link to one of them in it."""
    (tmp_path / "secret.csv").write_text(SECRET)
    (tmp_path / "imu.csv").write_text(IMU)
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / "imu.csv").write_text(IMU)
    (tmp_path / "rec" / "link.csv").symlink_to("../imu.csv")
    return tmp_path / "rec"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('file = "../imu.csv"', r"lies outside its folder.*--outside"),
        ('file = "{outside}/imu.csv"', r"lies outside its folder.*--outside"),
        ('file = ["imu.csv", "../imu.csv"]', r"lies outside its folder.*--outside"),
        ('file = "link.csv"', r"lies outside its folder.*--outside"),
        ('file = "deeper/../../imu.csv"', r"lies outside its folder.*--outside"),
        ('file = "imu.csv"\n[truth]\nfile = "../imu.csv"', r"lies outside its folder.*--outside"),
        ('file = "imu.csv"\n[camera]\nframe = "kinect"\nskeleton = "../imu.csv"', r"outside.*--outside"),
        ('file = "imu\\u0000.csv"', "not a file's name"),
    ],
)
def test_files_elsewhere_need_a_word(folder: Path, keys: str, said: str):
    with pytest.raises(UnoccludeError, match=said):
        open_csv(described(folder, keys.format(outside=folder.parent), ""))


def test_with_the_word_they_are_read_and_a_folder_named_by_a_link_is_its_own(folder: Path):
    file = open_csv(described(folder, 'file = "../imu.csv"', ""), outside=True)
    assert len(file.imus[0].stamp_ns) == 50
    described(folder, 'file = "imu.csv"', "")
    (folder.parent / "other").symlink_to(folder)
    assert len(open_csv(folder.parent / "other").imus) == 1


@pytest.mark.parametrize("more", ["", "skip_rows = 0", 'separator = ","', "rate_hz = 100.0"])
def test_no_line_of_another_file_is_shown(folder: Path, more: str):
    with pytest.raises(UnoccludeError) as told:
        open_csv(described(folder, f'file = "../secret.csv"\n{more}', ""), outside=True)
    assert "secret.csv" in str(told.value)
    assert not any(word in str(told.value) for word in ("admin", "horse", "battery", "staple"))
