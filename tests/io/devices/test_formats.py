"""All formats of devices: their table and pages, sound examples, and files that are damaged."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import device_files as made
import numpy as np
import pytest
from imu_files import rows

from smoother.errors import RecordingError
from smoother.io.files import import_files, sort_files
from smoother.io.recording.streams import RecordingFile
from smoother.io.registry import FileReader, format_named, formats, unknown_file
from smoother.io.tables.imu_formats import Device, imu_format
from smoother.io.tables.table import decode, read_head, read_table, shown
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
    "xsens-dot": {"t_s": 4.0, "name": "left wrist", "rate_hz": 100.0, "counter_wraps": 2**32},
    "xsens-mt": {"rate_hz": 100.0, "counter_wraps": 2**16, "units": "m/s^2, rad/s"},
    "shimmer": {"t_s": 1.6294033377807312e9, "name": "S", "units": "m/s^2, deg/s"},
    "apdm": {"t_s": 0.0, "name": "Right Wrist", "rate_hz": 100.0},
    "x-imu": {"t_s": 4.0, "units": "g, deg/s"},
    "nilspod": {"t_s": 0.0, "units": "m/s^2, deg/s"},
    "metamotion": {"t_s": 1.52e9, "units": "g"},
    "sensorlog": {"t_s": 7.0, "units": "g, rad/s"},
    "phyphox": {"t_s": 0.0, "units": "m/s^2, rad/s"},
    "android": {"t_s": 123.456789, "units": "m/s^2, rad/s"},
    "mvnx": {"t_s": 0.0, "name": "RightForeArm", "rate_hz": 100.0},
    "axivity": {"units": "g, deg/s"},
    "imu-table": {"t_s": 4.0, "units": "g, deg/s"},
}


def test_heads(tmp_path: Path):
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"):
        assert decode("t,x\n1,2\n".encode(encoding)) == "t,x\n1,2\n"
    assert decode(bytes(range(256))) == "" and decode("Zeit;Größe\n".encode("cp1252")) == "Zeit;Größe\n"
    assert len(shown("\x1b[31mred\x00" * 900)) <= 200 and shown("a\x1b\n\tb") == "a b"
    for name, said in (("none", "does not exist"), ("", "is a folder")):
        with pytest.raises(RecordingError, match=said):
            read_head(tmp_path / name)


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
