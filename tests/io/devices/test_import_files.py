"""All formats of devices: sound examples, damaged files, and `unocclude import files` as a person uses it."""

from __future__ import annotations

import json
import re
from importlib.util import find_spec
from pathlib import Path

import device_files as made
import numpy as np
import pytest
from commands import done
from imu_files import rows

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import open_recording
from smoother.io.files import ImuFiles, import_files, sort_files
from smoother.io.recording.streams import RecordingFile
from smoother.io.registry import FileReader, format_named, formats, unknown_file
from smoother.io.tables.imu_formats import Device, imu_format
from smoother.io.tables.table import read_head, read_table
from tools.fuzz import mutated

ROOT = Path(__file__).parents[3]


def test_every_importer_has_a_row_and_a_sentence():
    index = (ROOT / "docs" / "devices.md").read_text(encoding="utf-8")
    assert len({importer.key for importer in formats()}) == len(formats())
    assert {importer.key for importer in formats()} == set(made.EXAMPLES) | made.MADE_ELSEWHERE
    for importer in formats():
        assert f"`{importer.key}`" in index, importer.key
        assert importer.title and importer.recognised_by and importer.kind in ("imu", "skeleton", "recording")
        assert format_named(importer.key) is importer


#: What each layout states beside its samples: the first time, name, rate, counter and units.
STATED: dict[str, dict[str, object]] = {
    "xsens-dot": {"t_s": 4.0, "topic": "left wrist", "rate_hz": 100.0, "counter_wraps": 2**32},
    "xsens-mt": {"rate_hz": 100.0, "counter_wraps": 2**16, "units": "m/s^2, rad/s"},
    "shimmer": {"t_s": 1.6294033377807312e9, "topic": "S", "units": "m/s^2, deg/s"},
    "apdm": {"t_s": 0.0, "topic": "Right Wrist", "rate_hz": 100.0},
    "x-imu": {"t_s": 4.0, "units": "g, deg/s"},
    "nilspod": {"t_s": 0.0, "units": "m/s^2, deg/s"},
    "metamotion": {"t_s": 1.52e9, "units": "g"},
    "sensorlog": {"t_s": 7.0, "units": "g, rad/s"},
    "phyphox": {"t_s": 0.0, "units": "m/s^2, rad/s"},
    "android": {"t_s": 123.456789, "units": "m/s^2, rad/s"},
    "mvnx": {"t_s": 0.0, "topic": "RightForeArm", "rate_hz": 100.0},
    "axivity": {"units": "g, deg/s"},
    "imu-table": {"t_s": 4.0, "units": "g, deg/s"},
}


def test_the_example_of_contributing(tmp_path: Path):
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(Device\(.*?\n\))\n```", text, re.DOTALL)
    importer = imu_format(eval(code, {"Device": Device}))
    body = rows(np.arange(made.COUNT), made.ACC / made.GRAVITY * 1000, made.DEG)
    path = tmp_path / "acme.csv"
    path.write_text("\n".join(["tick,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z", *body, ""]))
    assert importer.recognises(read_head(path))
    (table,) = importer.read(path)
    assert np.allclose(table.acc, made.ACC, atol=1e-6) and np.allclose(table.gyro, made.GYRO, atol=1e-6)
    assert np.allclose(table.t_s, np.arange(made.COUNT) * 1e-3)


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (b"PK\x03\x04\x14\x00\x00\x00\x08\x00[Content_Types].xml", "an Excel workbook that cannot be read"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "is an Excel workbook of the old kind; save it as .xlsx"),
        (b"PK\x03\x04\x14\x00\x00\x00\x08\x00mimetype", "is an archive"),
        (b"SampleTimeFine,Acc_X,Acc_Y,Acc_Z\n", "has no rows; export it again"),
        (b"Zeit (s);Beschleunigung x (m/s^2)\r\n\r\n", "has no rows; export it again"),
    ],
)
def test_workbooks_archives_and_headers_alone(tmp_path: Path, raw: bytes, said: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(raw)
    assert said in str(unknown_file(read_head(path)))
    with pytest.raises(RecordingError, match=said):
        read_table(path)


MUTANTS = 600


def imported(path: Path) -> RecordingFile:
    reader = FileReader()
    skeletons, imus, _ = sort_files([path], reader)
    return import_files(skeletons, imus, reader=reader)[0]


@pytest.mark.parametrize("key", sorted(made.EXAMPLES))
def test_the_examples_are_sound(tmp_path: Path, key: str):
    if key == "xdf":
        pytest.importorskip("pyxdf")
    made.EXAMPLES[key](tmp_path / "file")
    if key == "metamotion":
        made.metamotion(tmp_path / "gyro", made.DEG, "deg/s")
    reader = FileReader()
    skeletons, imus, _ = sort_files([tmp_path], reader)
    file, reports = import_files(skeletons, imus, reader=reader)
    assert reports[0].format == key
    sound_units(file, exactly=key != "axivity")
    for imu in file.imus:
        assert np.allclose(np.diff(imu.stamp_ns), 1e7, atol=1e5)
    table = reader.read(tmp_path / "file", format_named(key))[0]
    for what, value in STATED.get(key, {}).items():
        found = table.t_s[0] if what == "t_s" and table.t_s is not None else getattr(table, what)
        assert found == (value if isinstance(value, str) else pytest.approx(value, rel=1e-12, abs=1e-9))


def sound_units(file: RecordingFile, exactly: bool = False) -> None:
    """Values are those of the motion, in SI units, as far as damage leaves them."""
    for imu in file.imus:
        turning = np.median(np.linalg.norm(imu.gyro, axis=1))
        force = np.median(np.linalg.norm(imu.acc, axis=1))
        assert 0.4 < turning / np.median(np.linalg.norm(made.GYRO, axis=1)) < 2.5
        assert 0.7 < force / 9.81 < 1.4
        if exactly:
            assert np.allclose(imu.acc[: made.COUNT], made.ACC, atol=1e-4)
            assert np.allclose(imu.gyro[: made.COUNT], made.GYRO, atol=1e-4)
    for arm in file.arms:
        if arm.side and arm.tracked > made.FRAMES // 2:  # a row cut in two may make a body of its own
            lengths = np.linalg.norm(arm.position[:, 1] - arm.position[:, 0], axis=1)
            lengths = lengths[np.isfinite(lengths)]
            assert not len(lengths) or 0.05 <= np.median(lengths) <= 1.0


@pytest.mark.slow
def test_damaged_files(tmp_path: Path):
    """600 of them over all layouts (`make fuzz`: more): no other exception, wrong unit or long message."""
    rng = np.random.default_rng(15)
    originals = {}
    for key, make in made.EXAMPLES.items():
        if key == "xdf" and find_spec("pyxdf") is None:
            continue
        path = tmp_path / key
        make(path)
        originals[key] = path.read_bytes()
    keys = sorted(originals)
    recordings, refused = 0, 0
    for number in range(MUTANTS):
        key = keys[number % len(keys)]
        path = tmp_path / "damaged"
        path.write_bytes(mutated(originals[key], rng))
        try:
            file = imported(path)
        except RecordingError as error:
            text = str(error)
            assert len(text) < 2600 and "\n" not in text and text.isprintable(), (key, text)
            refused += 1
            continue
        try:
            sound_units(file)
        except AssertionError as error:
            (tmp_path / "wrong").write_bytes(path.read_bytes())
            raise AssertionError(f"mutant {number} of {key} has a wrong unit") from error
        recordings += 1
    assert recordings > 0.2 * MUTANTS and refused > 0.05 * MUTANTS


@pytest.fixture
def files(tmp_path: Path) -> Path:
    made.EXAMPLES["azure-kinect"](tmp_path / "body.csv")
    made.xsens_dot(tmp_path / "dot.csv")
    made.apdm(tmp_path / "opal.csv")
    made.metamotion(tmp_path / "a.csv")
    made.metamotion(tmp_path / "g.csv", made.DEG, "deg/s")
    return tmp_path


def test_a_line_a_file_and_the_recording(files: Path, capsys: pytest.CaptureFixture[str]):
    out, figures = files / "rec.mcap", files / "rec.json"
    named = f"forearm_right={files / 'dot.csv'}"
    done("import", "files", "--skeleton", files / "body.csv", "--imu", named, "-o", out, "--json", figures)
    printed = capsys.readouterr().out
    assert "dot.csv: Xsens DOT export, 100.0 Hz, 80 samples, m/s^2, deg/s" in printed
    assert "body.csv: Azure Kinect" in printed and "12 frames, 1 body, mm" in printed
    assert "is unrelated to" in printed  # 4 s against 0.2 s
    file = open_recording(out)
    assert [imu.topic for imu in file.imus] == ["/imu/forearm_right"] and str(file.camera_frame) == "optical"
    assert np.allclose(file.imus[0].gyro, made.GYRO, atol=1e-6) and file.imus[0].stamp_ns[0] == 0
    reports = json.loads(figures.read_text())["files"]
    assert [report["format"] for report in reports] == ["azure-kinect", "xsens-dot"]
    assert reports[1]["topics"] == ["/imu/forearm_right"] and reports[1]["count"] == 80
    assert file.clocks_unrelated
    imu = ImuFiles((files / "dot.csv",), "forearm_right")
    stated, _ = import_files([files / "body.csv"], [imu], imu_starts_at_s=0.1)
    assert not stated.clocks_unrelated  # the user said how they relate


def test_two_files_of_one_sensor_and_one_of_several(files: Path):
    out, pair = files / "rec.mcap", f"wrist_left={files / 'a.csv'},{files / 'g.csv'}"
    done("import", "files", "--imu", pair, "--imu", f"base={files / 'opal.csv'}#Sternum", "-o", out)
    base, wrist = open_recording(out).imus
    assert [base.topic, wrist.topic] == ["/imu/base", "/imu/wrist_left"]
    assert np.allclose(wrist.acc, made.ACC, atol=1e-4)


def test_a_folder(files: Path, capsys: pytest.CaptureFixture[str]):
    (files / "notes.md").write_text("# Session of Monday\nleft arm\n")
    made.bare_kinect(files / "empty.csv")
    (files / "empty.csv").write_text("")
    out = files / "rec.mcap"
    done("import", "files", files, "-o", out)
    printed = capsys.readouterr().out
    assert "notes.md has an unknown format and was skipped" in printed
    # a.csv and g.csv are the two files of one sensor
    assert {i.topic for i in open_recording(out).imus} == {
        *("/imu/Right_Wrist", "/imu/Sternum", "/imu/dot", "/imu/g")
    }
    assert run(["import", "files", str(files), "-o", str(out)]) == 1  # it is there already


def test_file_names_decide_nothing(tmp_path: Path):
    made.xsens_dot(tmp_path / "azure_left_hand.trc")
    file, reports = import_files([], [ImuFiles((tmp_path / "azure_left_hand.trc",))])
    assert reports[0].format == "xsens-dot" and file.imus[0].topic == "/imu/sensor"


@pytest.mark.parametrize(
    "arguments, said",
    [
        ("--imu {0}/nothing.csv", "does not exist"),
        ("--imu {0}", "is a folder"),
        ("--imu {0}/body.csv", "name it with --skeleton"),
        ("--skeleton {0}/dot.csv", "name it with --imu"),
        ("--imu forearm={0}/opal.csv", r"2 sensors \(Right Wrist, Sternum\).*opal.csv#Right Wrist"),
        ("--imu x={0}/opal.csv#Pelvis", "has no sensor Pelvis; it has Right Wrist, Sternum"),
        ("--imu {0}/a.csv", "has no gyroscope"),
        ("--imu {0}/dot.csv --imu-format dot", "dot is not a format; formats are xdf"),
        ("--imu {0}/dot.csv --imu-format shimmer", "is not of Shimmer"),
        ("--imu ={0}/dot.csv", "give NAME=FILE"),
        ("", "nothing to import"),
        ("--imu {0}/dot.csv --truth {0}/truth.csv", "do not overlap"),
    ],
)
def test_wrong_ways(files: Path, arguments: str, said: str, capsys: pytest.CaptureFixture[str]):
    (files / "truth.csv").write_text("t_s,x,y,z\n90,0,0,0\n91,0,0,0\n")
    out = files / "out.mcap"
    assert run(["import", "files", *(a.format(files) for a in arguments.split()), "-o", str(out)]) == 1
    assert re.search(said, " ".join(capsys.readouterr().err.split())) and not out.exists()


def test_an_unknown_file_is_shown_shortly(tmp_path: Path):
    path = tmp_path / "x.bin"
    for content in (b"\x1b[31m" + bytes(range(256)) * 400, b"hello " * 90_000, "pulse;Ä\n".encode() * 9):
        path.write_bytes(content)
        with pytest.raises(RecordingError) as error:
            import_files([], [ImuFiles((path,))])
        text = str(error.value)
        assert "import describe" in text and "Known are" in text and text.isprintable()
        assert len(text.split("it begins with: ")[1].split(" Known are")[0]) <= 202


def test_imu_starts_at(files: Path):
    file, _ = import_files([files / "body.csv"], [ImuFiles((files / "dot.csv",))], imu_starts_at_s=-3.0)
    assert file.imus[0].stamp_ns[0] == file.arms[0].stamp_ns[0] - 3_000_000_000
    assert "3 s before the camera's first frame" in " ".join(file.notes)


def test_truth(files: Path, capsys: pytest.CaptureFixture[str]):
    (files / "truth.csv").write_text("t_s,x,y,z\n4.1,0,0,1\n4.2,0,0,2\n")
    made.trc(files / "mocap.trc")
    for number, name in enumerate(("truth.csv", "mocap.trc")):
        out = files / f"{number}.mcap"
        done("import", "files", "--imu", files / "dot.csv", "--truth", files / name, "-o", out)
    printed = capsys.readouterr().out
    assert "poses of the truth, 2 rows" in printed and "unocclude validate RESULT.mcap --truth" in printed
    assert len(open_recording(files / "0.mcap").poses) == 1


@pytest.mark.slow
@pytest.mark.real
def test_every_real_file_that_holds_raw_data(datasets: Path):
    """No option but file names; what cannot be used is refused with what to record."""
    refused = {"xsens_dot_fusion_only.csv": "Custom mode 5", "keraal_blazepose.json": "pose_world_landmarks"}
    for path in sorted((datasets / "devices").iterdir()):
        if path.name == "README.md":
            continue
        if path.name in refused:
            with pytest.raises(RecordingError, match=refused[path.name]):
                sort_files([path], FileReader())
            continue
        skeletons, imus, _ = sort_files([path], FileReader())
        file, reports = import_files(skeletons, imus)
        assert file.imus or (file.arms and reports[0].rate_hz > 10)
        for imu in file.imus:
            assert 0.8 < np.median(np.linalg.norm(imu.acc, axis=1)) / 9.81 < 1.2
            assert np.median(np.linalg.norm(imu.gyro, axis=1)) < 8.0  # rad/s
        for arm in file.arms:
            assert 0.15 < np.nanmedian(np.linalg.norm(arm.position[:, 1] - arm.position[:, 2], axis=1)) < 0.4
