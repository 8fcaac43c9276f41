"""Damaged files written anew: never less than the mcap package's own stream reader has of them."""

from __future__ import annotations

import json
import random
from io import BytesIO
from pathlib import Path

import pytest
from commands import done
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_records import places, put
from test_damaged_container import COUNT, read, written

from smoother.cli.run import run
from smoother.io import open_recording
from smoother.io.mcap.repair import repair_container


def by_package(data: bytes) -> set[tuple[int, int, bytes]]:
    """Messages that the package reads until it fails."""
    rows = set()
    try:
        for record in StreamReader(BytesIO(data), record_size_limit=1 << 26).records:
            if isinstance(record, Message) and record.channel_id in (1, 2):
                rows.add((record.log_time, record.sequence, record.data))
    except Exception:  # whatever it makes of the damage
        pass
    return rows


def in_order(path: Path) -> list[tuple[int, int, bytes]]:
    """Messages as the package reads a whole file, by its index."""
    with open(path, "rb") as file:
        return [(m.log_time, m.sequence, m.data) for _, _, m in make_reader(file).iter_messages()]


@pytest.mark.parametrize("way", [{}, {"chunked": False}, {"crcs": False}], ids=str)
def test_never_fewer_than_the_package_reads(tmp_path: Path, way: dict[str, bool]):
    whole, rng = written(**way), random.Random(5)
    path, output = tmp_path / "broken.mcap", tmp_path / "whole.mcap"
    least, original = COUNT, by_package(whole)
    for number in range(60):
        at = rng.randrange(60, len(whole))
        kind = ("cut", "bit", "zero")[number % 3]
        broken = {"cut": whole[:at], "bit": put(whole, at, bytes([whole[at] ^ 8]))}.get(kind)
        broken = broken or put(whole, at, bytes(min(300, len(whole) - at)))
        path.write_bytes(broken)
        expected = by_package(broken) & original  # the package takes a damaged payload for a message
        if not expected and kind == "cut":
            continue
        report = repair_container(path, output, force=True)
        rows = in_order(output)
        assert expected <= set(rows)
        assert [row[0] for row in rows] == sorted(row[0] for row in rows)
        assert sum(report.messages.values()) == len(rows)
        if len(rows) < COUNT:
            assert report.notes
        if kind != "cut":
            least = min(least, len(rows))
    assert least > COUNT - 60  # all whole chunks behind a damage


def test_a_whole_file_stays_as_it_is(tmp_path: Path):
    path, output = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(written())
    report = repair_container(path, output)
    assert not report.notes and not report.losses and not report.missing
    assert read(tmp_path / "c.mcap", output.read_bytes())[0] == read(path, path.read_bytes())[0]


def test_the_command_lists_what_was_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    whole = written()
    chunk = places(whole, Opcode.CHUNK)[5]
    path, output, figures = (tmp_path / name for name in ("a.mcap", "b.mcap", "c.json"))
    path.write_bytes(put(whole, chunk, bytes(1000)))
    done("repair", path, "-o", output, "--json", figures)
    lost = json.loads(figures.read_text())
    assert lost["missing"] and lost["losses"] and lost["notes"]
    assert sum(lost["messages"].values()) + sum(lost["missing"].values()) == COUNT
    out = capsys.readouterr().out
    assert "missing by its own count" in out and "left out" in out and "written:" in out
    # whoever reads the whole file learns of it
    assert any(note.startswith("damaged file that was repaired") for note in open_recording(output).notes)
    again = tmp_path / "again.mcap"
    done("repair", output, "-o", again)
    assert any(note.startswith("damaged file that was repaired") for note in open_recording(again).notes)


def test_what_cannot_be_repaired(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path, output = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(written()[:150])
    assert run(["repair", str(path), "-o", str(output)]) == 1
    assert "no complete message" in capsys.readouterr().err and not output.exists()
    path.write_bytes(b"something else")
    assert run(["repair", str(path), "-o", str(output)]) == 1
    assert run(["repair", str(path), "-o", str(path)]) == 1
