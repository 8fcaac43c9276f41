# ruff: noqa: E501 - tables of files
"""One fact, every reader: halves of an IMU, units, encodings, lines below the names, limits, remedies."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import device_files as made
import numpy as np
import pytest
import ros_bags as ros
import skeleton_files
from importers import as_workbook, turning, workbook
from library_files import ZERO

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import open_csv, open_recording, read_recording, write_recording
from smoother.io.files import ImuFiles, import_files
from smoother.io.recording.keypoints import TOPIC
from smoother.io.recording.streams import ImuSamples, RecordingFile
from smoother.io.registry import FileReader, recognise, unknown_file
from smoother.io.tables.describe import describe_file
from smoother.io.tables.table import LONGEST_LINE, MOST_COLUMNS, layout_of, read_head
from smoother.units import STANDARD_GRAVITY

T, ACC, GYRO = turning(1000, 100.0)
NOISE = np.random.default_rng(5).normal(0, 1e-3, ACC.shape)  # a sensor's values vary
ACC, GYRO = ACC + NOISE, GYRO + NOISE
Topics = dict[str, tuple[np.ndarray, np.ndarray]]


def ros2(path: Path, topics: Topics) -> None:
    with ros.Bag(path) as bag:
        for at, ns in enumerate((ZERO + np.rint(T * 1e9)).astype(int).tolist()):
            for topic, (acc, gyro) in topics.items():
                bag.imu(topic, ns, "imu", acc[at], gyro[at], ns)


def ours(path: Path, topics: Topics) -> None:
    stamp = ZERO + np.rint(T * 1e9).astype(np.int64)
    imus = [ImuSamples(topic, "imu", stamp, acc, gyro) for topic, (acc, gyro) in topics.items()]
    write_recording(RecordingFile(path, imus=imus), path, force=True)


def xdf(path: Path, topics: Topics) -> None:
    streams: list[dict[str, Any]] = []
    for topic, (acc, gyro) in topics.items():
        parts = [(a, u, v) for a, u, v in (("acc", "m/s^2", acc), ("gyro", "rad/s", gyro)) if v.any()]
        # of a half the stream's name alone says what it is
        form = "{0}_{1}" if len(parts) > 1 else "{1}"
        channels = [(form.format(name, axis), unit) for name, unit, _ in parts for axis in "xyz"]
        values = np.hstack([values for _, _, values in parts])
        stream = {"name": topic, "type": "IMU", "rate": 100, "t_s": T, "values": values, "channels": channels}
        streams.append(stream)
    skeleton_files.xdf(path, streams)


WRITERS: dict[str, Callable[[Path, Topics], None]] = {
    "ros2.mcap": ros2, "ours.mcap": ours, "lsl.xdf": xdf,
}  # fmt: skip
ZEROS = np.zeros_like(ACC)
HALVES = {"/camera/accel/sample": (ACC, ZEROS), "/camera/gyro/sample": (ZEROS, GYRO)}


def imported(path: Path, sensor: str = "") -> tuple[Any, list[str]]:
    file, _ = import_files([], [ImuFiles((path,), "forearm_right", sensor)])
    (imu,) = file.imus
    return imu, file.notes


@pytest.mark.parametrize("name", WRITERS)
def test_accelerometer_and_gyroscope_on_two_topics_are_one_imu(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    WRITERS[name](path, HALVES)
    imu, notes = imported(path)
    np.testing.assert_allclose(imu.acc, ACC, atol=1e-4)
    np.testing.assert_allclose(imu.gyro, GYRO, atol=1e-4)
    assert any("taken as one IMU" in note for note in notes)
    if not name.endswith("xdf"):
        for half in ("camera/accel/sample", "camera/accel/sample,#camera/gyro/sample"):
            assert len(imported(path, half)[0].acc) == len(ACC)


@pytest.mark.parametrize("half", HALVES)
@pytest.mark.parametrize("name", WRITERS)
def test_a_half_alone_is_never_read_with_zeros(tmp_path: Path, name: str, half: str) -> None:
    path = tmp_path / name
    WRITERS[name](path, {half: HALVES[half]})
    with pytest.raises(RecordingError, match=r"has no (accelerometer|gyroscope)|alone, and both are needed"):
        imported(path)
    if name.endswith("mcap"):
        with pytest.raises(RecordingError, match=half):
            read_recording(path)


@pytest.mark.parametrize(
    ("sensor", "factor", "unit"),
    [
        ("acc", 1 / STANDARD_GRAVITY, "g"),
        ("acc", 1000 / STANDARD_GRAVITY, "mg"),
        ("acc", 1000.0, "mm/s^2"),
        ("gyro", 180 / np.pi, "deg/s"),
    ],
)
@pytest.mark.parametrize("name", [*WRITERS, "recording.toml"])
def test_units_other_than_stated_are_converted_and_said(
    tmp_path: Path, name: str, sensor: str, factor: float, unit: str
) -> None:
    path, values = tmp_path / name, {"acc": ACC, "gyro": GYRO}
    values[sensor] = values[sensor] * factor
    if name in WRITERS:
        WRITERS[name](path, {"/wrist/imu": (values["acc"], values["gyro"])})
        imu, notes = imported(path)
    else:
        table(tmp_path / "imu.csv", f"{OWN},mx,my,mz", T, values["acc"], values["gyro"], 3 * ACC)
        text(path, '[imu.forearm_right]\nfile = "imu.csv"\n')
        (imu,), notes = (file := open_csv(tmp_path)).imus, file.notes
        np.testing.assert_allclose(imu.mag, 3 * ACC, rtol=1e-6)
    np.testing.assert_allclose(getattr(imu, sensor), {"acc": ACC, "gyro": GYRO}[sensor], atol=1e-5)
    assert any(f" is in {unit}, " in note and "converted" in note for note in notes)


@pytest.mark.parametrize("name", WRITERS)
def test_a_unit_in_recording_toml_holds_for_a_recording(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name, {"/wrist/imu": (ACC / STANDARD_GRAVITY, np.degrees(GYRO))})
    text = f'[imu.forearm_right]\nfile = "{name}"\n'
    for stated in ("", 'accelerometer_unit = "g"\n', 'accelerometer_unit = "g"\ngyroscope_unit = "deg/s"\n'):
        if name.endswith("xdf") and stated.count("\n") != 2:
            continue  # its channels state m/s^2 and rad/s, so both are to be overruled
        (tmp_path / "recording.toml").write_text(text + stated)
        (imu,) = open_csv(tmp_path).imus
        np.testing.assert_allclose(imu.acc, ACC, atol=1e-4)
        np.testing.assert_allclose(imu.gyro, GYRO, atol=1e-4)
    (tmp_path / "recording.toml").write_text(text + 'time_unit = "ms"\n')
    with pytest.raises(RecordingError, match=r"no table .*leave out time_unit"):
        open_csv(tmp_path)


def values_of(path: Path, key: str) -> list[np.ndarray]:
    importer = recognise(read_head(path))
    assert importer is not None and importer.key == key
    found = []
    for table in FileReader().read(path, importer):
        vectors = [table.acc, table.gyro] if hasattr(table, "acc") else list(table.position.values())
        found.append(np.concatenate([np.ravel(each) for each in vectors if each is not None]))
    return found


TABLES = [
    *("xsens-dot", "xsens-mt", "x-imu", "nilspod", "metamotion", "sensorlog", "phyphox", "android"),
    *("imu-table", "azure-kinect", "kinect-v2", "mediapipe", "joint-rows", "joint-table", "trc"),
]  # fmt: skip
ENCODINGS = ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32")
BELOW: dict[str, Callable[[int], list[str]]] = {
    "dashes": lambda n: ["-"] * n,
    "words": lambda n: ["[x]"] * n,
    "numbers": lambda n: [str(at + 1) for at in range(n)],
    "nothing": lambda n: [""] * n,
}


@pytest.mark.parametrize("key", TABLES)
def test_encodings_and_lines_below_the_names(tmp_path: Path, key: str) -> None:
    path = tmp_path / "a.dat"
    made.EXAMPLES[key](path)
    text, wanted = path.read_text("utf-8"), values_of(path, key)
    lines = text.split("\n")
    layout = layout_of(lines)
    assert layout is not None
    changed = {encoding: text.encode(encoding) for encoding in ENCODINGS}
    for name, cells in BELOW.items() if key != "trc" else ():  # whose header has a place of its own
        row = layout.separator.join(cells(layout.width))
        after = layout.header + 1
        changed[name] = "\n".join([*lines[:after], row, *lines[after:]]).encode()
    found = [values_of(as_workbook(path, tmp_path / "a.xlsx", layout.separator), key)] if key != "trc" else []
    for raw in changed.values():
        path.write_bytes(raw)
        found.append(values_of(path, key))
    for values in found:
        for mine, theirs in zip(values, wanted, strict=True):
            np.testing.assert_allclose(mine, theirs, atol=1e-9)


POINTS = ((0, "elbow_right", 600.0, 300.0, 0.9), (1, "wrist_right", 700.0, 310.0, 0.3))
LENS = (
    "intrinsics = {width = 1280, height = 720, fx = 900.0, fy = 900.0, cx = 639.5, cy = 359.5, k1 = -0.1}\n"
)


def plain_folder(folder: Path, encoding: str = "utf-8", below: str = "") -> None:
    """A recording from plain files: a skeleton, a second camera's keypoints, an IMU."""
    frames = np.arange(0, 10, 1 / 30)
    joints = [
        f"{t:.4f},{name},{x / 1000},{0.1 * np.sin(t):.4f},2.0,tracked"
        for t in frames
        for _, name, x, _, _ in POINTS
    ]
    points = [f"{t:.4f},{name},{x + t},{y},{score}" for t in frames for _, name, x, y, score in POINTS]
    imu = [
        f"{t:.4f},{','.join(map(repr, row))}"
        for t, row in zip(T, np.hstack([ACC, GYRO]).tolist(), strict=True)
    ]
    for name, header, rows in (
        ("skeleton.csv", "t_s,joint,x,y,z,state", joints),
        ("points.csv", "t_s,joint,u,v,score", points),
        ("imu.csv", "t_s,ax,ay,az,gx,gy,gz", imu),
    ):
        line = [",".join([below] * (header.count(",") + 1))] if below else []
        (folder / name).write_bytes("\n".join([header, *line, *rows, ""]).encode(encoding))
    (folder / "recording.toml").write_text(
        '[camera]\nframe = "kinect"\nskeleton = "skeleton.csv"\n'
        f'[camera.webcam]\nkeypoints = "points.csv"\n{LENS}[imu.forearm_right]\nfile = "imu.csv"\n'
    )


def test_plain_files_with_keypoints_in_another_encoding(tmp_path: Path) -> None:
    plain_folder(tmp_path, "utf-16", "[x]")
    file = open_csv(tmp_path)
    (imu,), (body, webcam) = file.imus, file.arms
    np.testing.assert_allclose(imu.acc, ACC, atol=1e-9)
    assert len(body.stamp_ns) == 300 and body.position[0, 1].tolist() == [0.6, 0.0, 2.0]
    lens = file.lenses["/camera/webcam/keypoints_2d"].lens
    assert webcam.lens == lens and lens.distortion == (-0.1, 0.0, 0.0, 0.0, 0.0)
    assert webcam.position[30, 1].tolist() == [601.0, 300.0, 0.9] and webcam.state[0, 1:3].tolist() == [2, 1]


def test_the_first_camera_may_be_one_of_keypoints(tmp_path: Path) -> None:
    plain_folder(tmp_path)
    text = (tmp_path / "recording.toml").read_text()
    text = "[camera]\n" + text[text.index("keypoints") :]
    (tmp_path / "recording.toml").write_text(text)
    file = open_csv(tmp_path)
    assert [arm.topic for arm in file.arms] == [TOPIC] and TOPIC in file.lenses
    for old, new, said in (
        (LENS, "", "intrinsics are not whole"),
        ("fx = 900.0, ", "", "intrinsics are not whole"),
        ("fx = 900.0", "fx = -900.0", "above zero"),
        ("keypoints =", 'frame = "kinect"\nkeypoints =', "axes of the lens"),
        ("keypoints =", 'skeleton = "skeleton.csv"\nkeypoints =', r"a section \[camera.NAME\]"),
        ("keypoints =", 'frame = "kinect"\nskeleton =', "give keypoints = a file"),
    ):
        (tmp_path / "recording.toml").write_text(text.replace(old, new))
        with pytest.raises(RecordingError, match=said):
            open_csv(tmp_path)


def packed(path: Path, part: str, size: int) -> Path:
    """A workbook whose part unpacks to so many bytes."""
    workbook(path, [["a", "b"], [1, 2]])
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as parts, parts.open(part, "w") as file:
        for _ in range(size // 1_000_000):
            file.write(b"0" * 1_000_000)
    return path


def text(path: Path, content: str) -> Path:
    path.write_text(content)
    return path


LIMITS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "a million columns": (
        lambda folder: text(folder / "a.csv", (",".join(["1"] * 500_000) + "\n") * 2), "row of 500,000 columns"
    ),
    "columns parted by blanks": (
        lambda folder: text(folder / "a.txt", (" ".join(["1"] * (MOST_COLUMNS + 1)) + "\n") * 3), "10,001 columns"
    ),
    "a long line": (lambda folder: text(folder / "a.csv", "t,x\n" + "7" * (LONGEST_LINE + 1)), "has a line of"),
    "a wide workbook": (
        lambda folder: workbook(folder / "a.xlsx", [list(range(MOST_COLUMNS + 1))] * 3), "10,001 columns"
    ),
    "an unpacked workbook": (
        lambda folder: packed(folder / "a.xlsx", "xl/worksheets/sheet9.xml", 300_000_000), "MB unpacked"
    ),
    "texts of a workbook": (lambda folder: packed(folder / "a.xlsx", "xl/sharedStrings.xml", 60_000_000), "unpacked"),
    "deep JSON": (
        lambda folder: text(
            folder / "a.json", '[{"pose_keypoints_2d":' + "[" * 200_000 + "]" * 200_000 + "}]"
        ),
        "cut off or damaged",
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("limit", LIMITS)
def test_limits_have_a_sentence_and_little_memory(tmp_path: Path, limit: str) -> None:
    write, said = LIMITS[limit]
    path = write(tmp_path)
    code = (
        "import sys; from pathlib import Path; from smoother.io.tables.describe import *\n"
        "from smoother.io.registry import FileReader; path = Path(sys.argv[1])\n"
        "print(describe_file(path, FileReader()).error)\n"
        "try: guessed_table(path, FileReader())\nexcept Exception as error: print(error)\n"
        # the kernel's peak of this program alone; ru_maxrss begins with that of the program that started it
        "peak = next(line for line in open('/proc/self/status') if line.startswith('VmHWM'))\n"
        "print(int(peak.split()[1]) // 1024)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=120
    )
    *errors, megabytes = done.stdout.splitlines()
    assert done.returncode == 0 and int(megabytes) < 300, done.stderr
    assert any(said in error for error in errors), errors


def test_a_long_table_is_described_by_its_beginning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "imu.csv"
    made.EXAMPLES["nilspod"](path)
    whole = describe_file(path, FileReader())
    for raw in (path.read_bytes(), path.read_text().encode("utf-16-le")):
        path.write_bytes(raw)
        monkeypatch.setattr("smoother.io.tables.describe._BEGINNING", len(raw) // 2)
        short = describe_file(path, FileReader())
        assert not short.error and short.format == whole.format
        assert 0.4 < short.streams[0]["count"] / whole.streams[0]["count"] < 0.6
        assert "described by its beginning (50% of it)" in short.notes[-1]


def test_without_openpyxl_a_command_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = workbook(tmp_path / "a.xlsx", [["time_s", "acc_x"], [0, 1]])
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    for words in (["files", "--imu", str(path), "-o", str(tmp_path / "o.mcap")], ["describe", str(path)]):
        assert run(["import", *words]) == 1
        said = " ".join(capsys.readouterr().err.split())
        assert "pip install '.[xlsx]'" in said and "xsens-mt" not in said


def test_not_recognised_names_what(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", "when,wibble,wobble\n" + "".join(f"{at},1.5,2.5\n" for at in range(50)))
    assert "none of its columns when, wibble, wobble is recognised" in str(unknown_file(read_head(path)))
    rows = "".join(f"{t},{a[0]},{a[1]},{a[2]},1,2,3\n" for t, a in zip(T, ACC, strict=True))
    path = text(tmp_path / "b.csv", "time_s,acc_x_m/s^2,acc_y_m/s^2,acc_z_m/s^2,rota,rotb,rotc\n" + rows)
    with pytest.raises(
        RecordingError, match=r"no gyroscope that is recognised \(Not used: columns rota, rotb, rotc"
    ):
        imported(path)


#: Columns of an IMU's table.
IMU = "time_s,acc_x_{0},acc_y_{0},acc_z_{0},gyro_x_{1},gyro_y_{1},gyro_z_{1}".format("m/s^2", "rad/s")
CSV = ["import", "csv", ".", "-o", "o.mcap", "--force"]


def table(path: Path, header: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.7g")
    return path


def files(imu: str) -> list[str]:
    return ["import", "files", "--imu", imu, "-o", "o.mcap", "--force"]


SECTION = '[imu.forearm_right]\nfile = "{}"\n'
WHOLE, OWN = (ACC, GYRO), "t_s,ax,ay,az,gx,gy,gz"
TWO = {"/wrist/imu": WHOLE, "/arm/imu": WHOLE}
THREE = {"/arm/accel": (ACC, ZEROS), "/leg/accel": (ACC, ZEROS), "/k4a/gyro": (ZEROS, GYRO)}
HALF = {
    "acc.csv": (IMU[: IMU.index(",gyro")], T, ACC),
    "gyro.csv": ("time_s" + IMU[IMU.index(",gyro") :], T, GYRO),
}
COUNTED = ("n_samples,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z", np.arange(len(T)), np.degrees(GYRO), ACC)
#: Files with their topics or columns, and the command (of a recording.toml's folder).
REMEDIES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "two sensors": ({"a.mcap": TWO}, files("forearm_right=a.mcap")),
    "three halves": ({"a.mcap": THREE}, files("forearm_right=a.mcap")),
    "sensors in a section": ({"a.mcap": TWO}, CSV),
    "half a table": (HALF, files("forearm_right=acc.csv")),
    "outside": ({"../a.csv": (OWN, T, *WHOLE)}, CSV),
    "counted samples": ({"a.csv": COUNTED}, files("forearm_right=a.csv")),
    "other columns": ({"a.csv": (IMU, T, *WHOLE)}, CSV),
}


def remedied(said: str, first: list[str]) -> list[str]:
    """The command that a message names: an option, or what `import describe` prints as recording.toml."""
    if "--outside" in said:
        return [*first, "--outside"]
    if named := re.search(r"--imu ([^`\s]*[^`\s.])", said):
        return files(named.group(1))
    described = re.search(r"`unocclude import describe(?: (\S+))?`", said)
    assert described is not None, said
    command = "from smoother.cli import main; main()"
    words = [sys.executable, "-c", command, "import", "describe", described.group(1) or "a.csv"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    text(Path("recording.toml"), done.stdout)
    return CSV


@pytest.mark.slow
@pytest.mark.parametrize("case", REMEDIES)
def test_the_remedy_of_a_message_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    written, first = REMEDIES[case]
    for name, content in written.items():
        if isinstance(content, dict):
            ros2(Path(name), content)
        else:
            table(Path(name), *content)
    if first is CSV:
        text(Path("recording.toml"), SECTION.format(next(iter(written))))
    code = run(first)
    said = " ".join(capsys.readouterr().err.split())
    assert code != 0
    assert run(remedied(said, first)) == 0, (said, capsys.readouterr().err)
    (imu,) = open_recording("o.mcap").imus
    np.testing.assert_allclose(np.median(np.linalg.norm(imu.acc, axis=1)), 9.81, atol=0.05)
    np.testing.assert_allclose(np.abs(imu.gyro).max(), np.abs(GYRO).max(), rtol=0.01)
