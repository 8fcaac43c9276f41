"""Damaged files of every layout: a recording with sound units or one sentence, never anything else."""

from __future__ import annotations

import random
from importlib.util import find_spec
from pathlib import Path

import device_files as made
import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.io.devices.files import import_files
from smoother.io.devices.folder import sort_files
from smoother.io.devices.registry import FileReader, formats
from smoother.io.recording.streams import RecordingFile

MUTANTS = 2000


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
            upper = np.nanmedian(np.linalg.norm(arm.position[:, 1] - arm.position[:, 0], axis=1))
            assert not upper > 1.0 and not upper < 0.05


def test_damaged_files(tmp_path: Path):
    """2,000 of them over all layouts: no other exception, no wrong unit, no long message."""
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
