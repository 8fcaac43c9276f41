"""Damaged files of every layout: a recording with sound units or one sentence, never anything else."""

from __future__ import annotations

import random
from importlib.util import find_spec
from pathlib import Path

import device_files as made
import numpy as np
import pytest
from imu_files import GRAVITY, motion, rows

from smoother.errors import RecordingError
from smoother.io.devices.files import import_files
from smoother.io.devices.folder import sort_files
from smoother.io.devices.registry import FileReader, formats, recognise
from smoother.io.recording.streams import RecordingFile
from smoother.io.tables.protocol import read_head

MUTANTS = 600


def imported(path: Path) -> RecordingFile:
    reader = FileReader()
    skeletons, imus, _ = sort_files([path], reader)
    return import_files(skeletons, imus, reader=reader)[0]


def mutant(raw: bytes, random_: random.Random) -> bytes:
    """A file with one to three kinds of damage."""
    for _ in range(random_.choice((1, 1, 1, 2, 3))):
        raw = random_.choice(DAMAGES)(raw, random_)
    return raw


def _flip(raw: bytes, random_: random.Random) -> bytes:
    out = bytearray(raw)
    for _ in range(random_.choice((1, 3, 20))):
        if out:
            out[random_.randrange(len(out))] = random_.randrange(256)
    return bytes(out)


def _header(raw: bytes, random_: random.Random) -> bytes:
    """Damage where the layout is stated."""
    cut = min(len(raw), 600)
    return _flip(raw[:cut], random_) + raw[cut:]


def _cut(raw: bytes, random_: random.Random) -> bytes:
    return raw[: random_.randrange(len(raw) + 1)]


def _headless(raw: bytes, random_: random.Random) -> bytes:
    return raw[random_.randrange(min(len(raw), 800) + 1) :]


def _lines(raw: bytes, random_: random.Random) -> bytes:
    """Lines left out, twice, or in another place."""
    lines = raw.split(b"\n")
    for _ in range(random_.choice((1, 5))):
        at = random_.randrange(len(lines))
        if random_.random() < 0.4:
            lines[at : at + 1] = []
        elif random_.random() < 0.5:
            lines.insert(random_.randrange(len(lines) + 1), lines[at])
        else:
            lines[at] = lines[at][: random_.randrange(len(lines[at]) + 1)]
        lines = lines or [b""]
    return b"\n".join(lines)


def _cells(raw: bytes, random_: random.Random) -> bytes:
    """Cells with something else in them."""
    for mark in (b",", b"\t", b";", b" "):
        parts = raw.split(mark)
        if len(parts) > 20:
            for _ in range(random_.choice((1, 10))):
                words = (b"", b"nan", b"-", b"1e400", b"abc", b"-124.874.1", b"0", b"9" * 30, b'"', b"inf")
                parts[random_.randrange(len(parts))] = random_.choice(words)
            return mark.join(parts)
    return raw


def _twice(raw: bytes, random_: random.Random) -> bytes:
    return raw + raw[random_.randrange(len(raw) + 1) :]


def _separators(raw: bytes, random_: random.Random) -> bytes:
    a, b = random_.sample([b",", b";", b"\t", b" ", b"."], 2)
    return raw.replace(a, b)


def _encoding(raw: bytes, random_: random.Random) -> bytes:
    try:
        return raw.decode("utf-8").encode(random_.choice(("utf-16", "utf-16-le", "utf-8-sig", "utf-16-be")))
    except UnicodeDecodeError:
        return raw[::-1]


DAMAGES = (_flip, _header, _cut, _headless, _lines, _cells, _twice, _separators, _encoding)


def test_every_format_has_an_example():
    known = {importer.key for importer in formats()}
    assert known == set(made.EXAMPLES) | made.MADE_ELSEWHERE


@pytest.mark.parametrize("key", sorted(made.EXAMPLES))
def test_the_examples_are_sound(tmp_path: Path, key: str):
    if key == "xdf":
        pytest.importorskip("pyxdf")
    path = tmp_path / "file"
    made.EXAMPLES[key](path)
    if key == "metamotion":
        made.metamotion(tmp_path / "gyro", made.DEG, "deg/s")
        reader = FileReader()
        skeletons, imus, _ = sort_files([tmp_path], reader)
        file, reports = import_files(skeletons, imus, reader=reader)
    else:
        reader = FileReader()
        skeletons, imus, _ = sort_files([path], reader)
        file, reports = import_files(skeletons, imus, reader=reader)
    assert reports[0].format == key
    sound_units(file, exactly=key != "axivity")


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


def test_damaged_files(tmp_path: Path):
    """600 of them over all layouts (`make fuzz`: more): no other exception, wrong unit or long message."""
    random_ = random.Random(15)
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
        path.write_bytes(mutant(originals[key], random_))
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
    assert recordings > 0.2 * MUTANTS and refused > 0.2 * MUTANTS


ACC, GYRO = motion(240)
TIME = np.arange(240) * 0.01
NANOS = (np.arange(240) * 10_000_000 + 123_456_789_000).astype(np.int64)


def named(form: str, *stems: str) -> str:
    return ",".join(form.format(stem, axis) for stem in stems for axis in "XYZ")


FILES = {
    "dot": [
        "sep=,",
        "OutputRate:,100Hz",
        "PacketCounter,SampleTimeFine," + named("{}_{}", "Acc", "Gyr"),
        *rows(np.arange(240), NANOS // 1000, ACC, np.degrees(GYRO)),
    ],
    "mtw": [
        "// Update Rate: 100.0Hz",
        "Counter," + named("{}_{}", "Acc", "Gyr"),
        *rows(np.arange(240), ACC, GYRO),
    ],
    "shimmer": [
        '"sep=,"',
        "Shimmer_1_Timestamp_Unix_CAL," + named("Shimmer_1_{}_{}_CAL", "Accel_WR", "Gyro") + ",",
        "ms" + ",m/(s^2)" * 3 + ",deg/s" * 3 + ",",
        *rows(1.6e12 + 1000 * TIME, ACC, np.degrees(GYRO), end=","),
    ],
    "ximu": [
        "Timestamp (us)," + named("Gyroscope {1} (deg/s)", "") + "," + named("Accelerometer {1} (g)", ""),
        *rows(NANOS // 1000, np.degrees(GYRO), ACC / GRAVITY),
    ],
    "phyphox": [
        "Time (s)," + named("Acceleration {1} (m/s^2)", "") + "," + named("Gyroscope {1} (rad/s)", ""),
        *rows(TIME, ACC, GYRO),
    ],
    "nilspod": ["t," + named("{}_{}", "gyr", "acc").lower(), *rows(TIME, np.degrees(GYRO), ACC)],
    "android": ["timestamp," + named("{}{}", "a", "g"), *rows(NANOS, ACC, GYRO)],
    "metamotion": ["epoch (ms),time (-13:00),elapsed (s)," + named("{1}-axis (g)", "")]
    + [
        f"{1_520_000_000_000 + 10 * k},2018-03-02T14.13.20,{row}"
        for k, row in enumerate(rows(TIME, ACC / GRAVITY))
    ],
}
WEIRD = (
    "",
    "abc",
    "nan",
    "inf",
    "1e400",
    "-",
    "9" * 400,
    '"',
    "\x00",
    "1,2,3",
    '"a\nb"',
    "1.2.3",
    "\x1b[31m",
)


def mutated(text: str, rng: random.Random) -> bytes:
    """A file that something happened to."""
    lines, kind = text.split("\n"), rng.randrange(9)
    if kind == 0:
        return text[: rng.randrange(1, len(text))].encode()
    if kind == 1:
        raw = bytearray(text.encode())
        for _ in range(rng.randrange(1, 30)):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
        return bytes(raw)
    if kind == 2:
        start = rng.randrange(len(text))
        return (text[:start] + text[start + rng.randrange(1, 4000) :]).encode()
    if kind == 3:
        return text.replace(",", rng.choice([";", "\t", " ", "|"])).encode(rng.choice(["utf-8", "utf-16"]))
    if kind == 4:
        gone = rng.randrange(8)
        return "\n".join(
            ",".join(c for k, c in enumerate(line.split(",")) if k != gone) for line in lines
        ).encode()
    if kind == 5:
        del lines[rng.randrange(4)]
    elif kind == 6:
        rng.shuffle(lines)
    elif kind == 7:
        for _ in range(rng.randrange(1, 20)):
            at = rng.randrange(len(lines))
            cells = lines[at].split(",")
            cells[rng.randrange(len(cells))] = rng.choice(WEIRD)
            lines[at] = ",".join(cells)
    else:
        return text.replace(",", ";").replace(".", ",").encode()
    return "\n".join(lines).encode()


@pytest.mark.parametrize("name", FILES)
def test_damaged_imus(tmp_path: Path, name: str):
    rng = random.Random(name)
    path = tmp_path / "a.csv"
    for _ in range(60):
        path.write_bytes(mutated("\n".join(FILES[name]) + "\n", rng))
        importer = recognise(read_head(path), ("imu",))
        if importer is None or importer.kind != "imu":
            continue
        try:
            tables = importer.read(path)
        except RecordingError as error:
            assert str(error).isprintable() and len(str(error)) < 600 + len(str(path))
            continue
        for table in tables:
            for values, whole in ((table.acc, ACC), (table.gyro, GYRO)):
                if values is None:
                    continue
                assert values.shape[1] == 3 and not np.isinf(values).any()
                finite = values[np.isfinite(values).all(axis=1)]
                if len(finite) > 60:
                    size = np.median(np.linalg.norm(finite, axis=1)) / np.median(
                        np.linalg.norm(whole, axis=1)
                    )
                    assert 0.3 < size < 3 or table.notes


def rewritten(lines: list[str], order: list[int], separator: str, comma: bool) -> str:
    """The table with its columns in another order and another separator; lines above it as they are."""
    body = []
    for line in lines:
        cells = line.split(",")
        if len(cells) < 6:  # above the header
            body.append(line)
            continue
        cells = [cells[at] for at in order]
        body.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells))
    return "\n".join(body) + "\n"


@pytest.mark.parametrize("name", FILES)
def test_columns_in_any_order_and_any_separator(tmp_path: Path, name: str):
    rng, path = random.Random(name), tmp_path / "a.csv"
    path.write_text("\n".join(FILES[name]) + "\n")
    importer = recognise(read_head(path), ("imu",))
    assert importer is not None
    expected = importer.read(path)[0]
    width = len(FILES[name][-1].split(","))
    for separator, comma in ((",", False), (";", False), (";", True), ("\t", True), ("|", True)):
        order = rng.sample(range(width), width)
        if name == "shimmer":  # its last cell, behind the last separator, is none
            order = [*rng.sample(range(width - 1), width - 1), width - 1]
        path.write_text(
            rewritten(FILES[name], order, separator, comma), encoding="utf-16" if comma else "utf-8"
        )
        again = recognise(read_head(path), ("imu",))
        assert again is not None and again.key == importer.key
        table = again.read(path)[0]
        for part in ("acc", "gyro", "t_s"):
            values = getattr(expected, part)
            if values is None:
                assert getattr(table, part) is None
            else:
                np.testing.assert_array_equal(getattr(table, part), values)
