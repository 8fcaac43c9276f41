"""Containers damaged or cut at any byte: what is there is read, and the times of what is not are said."""

from __future__ import annotations

import json
import random
import struct
import time
from collections.abc import Callable
from io import BytesIO
from operator import itemgetter
from pathlib import Path

import pytest
import zstandard
from commands import done
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_messages import places, put

from smoother.cli.run import run
from smoother.io import open_recording
from smoother.io.mcap.container import CHUNK, HEAD, MAGIC, Container
from smoother.io.mcap.merge import repair_container

COUNT = 300
TOPICS = ("/a", "/b", "/c")
Row = tuple[str, int, int, int, bytes]  # Topic, log and publish time, sequence, payload


def written(events: list[tuple[int, int, int]] | None = None, chunk_size: int = 2000, **how: object) -> bytes:
    """A file of messages (topic, log time, size); channels are made when they are first used."""
    rng = random.Random(0)
    if events is None:
        events = [(number % 2, 10**18 + number * 10**7, 40) for number in range(COUNT)]
    file = BytesIO()
    writer = Writer(file, chunk_size=chunk_size, **how)  # type: ignore[arg-type]
    writer.start()
    channels: dict[int, int] = {}
    for number, (topic, log_ns, size) in enumerate(events):
        if topic not in channels:
            schema = writer.register_schema(f"schema{topic}", "", b"text")
            channels[topic] = writer.register_channel(TOPICS[topic], "raw", schema)
        writer.add_message(channels[topic], log_ns, rng.randbytes(size), log_ns + 1, number)
    writer.finish()
    return file.getvalue()


def read(path: Path, data: bytes) -> tuple[list[Row], Container]:
    path.write_bytes(data)
    container = Container(path)
    rows: list[Row] = []
    for chunk in container.chunks():
        names = [container.topics[number].name for number in chunk.topic.tolist()]
        places = zip(chunk.start.tolist(), chunk.stop.tolist(), strict=True)
        payloads = [bytes(memoryview(chunk.chunk)[a:b]) for a, b in places]
        columns = (chunk.log_ns.tolist(), chunk.publish_ns.tolist(), chunk.sequence.tolist(), payloads)
        rows += zip(names, *columns, strict=True)
    return rows, container


def by_package(data: bytes) -> list[Row]:
    """All that can be had of a file, record by record, as the mcap package reads it."""
    channels: dict[int, str] = {}
    found = []
    try:
        for record in StreamReader(BytesIO(data), record_size_limit=1 << 26).records:
            if hasattr(record, "topic"):
                channels[record.id] = record.topic
            elif isinstance(record, McapMessage) and record.channel_id in channels:
                row = (record.log_time, record.publish_time, record.sequence, record.data)
                found.append((channels[record.channel_id], *row))
    except Exception:  # cut off, or whatever it makes of the damage
        pass
    return found


def is_named(row: Row, container: Container) -> bool:
    """Whether a damage's times contain a lost message's."""
    times = [(each.first_ns, each.last_ns) for each in container.damage]
    return any((a is None or a <= row[1]) and (b is None or row[1] <= b) for a, b in times)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "damaged.mcap"


def in_chunk(number: int, at: int, value: bytes) -> Callable[[bytes], bytes]:
    return lambda whole: put(whole, places(whole, Opcode.CHUNK)[number] + at, value)


def again(whole: bytes) -> bytes:
    """A chunk twice."""
    first, second = places(whole, Opcode.CHUNK)[4:6]
    return whole[:second] + whole[first:second] + whole[second:]


def without(whole: bytes) -> bytes:
    """Thirty bytes are gone."""
    second = places(whole, Opcode.CHUNK)[5]
    return whole[:second] + whole[second + 30 :]


FAR = struct.pack("<Q", 2**63 + 1)
REST = 99  # Chunks: all behind the damage
#: What is damaged, how many chunks that costs at the most, and a part of a note.
DAMAGES: dict[str, tuple[Callable[[bytes], bytes], float, str]] = {
    "payload": (in_chunk(0, 200, b"\xff\xfe\xfd"), 1, "left out (from 0.000 s to"),
    "compression": (in_chunk(3, HEAD.size + CHUNK.size + 1, b"x"), 1, "is damaged and was left out"),
    **{f"opcode {code}": (in_chunk(3, 0, bytes([code])), REST, "left out") for code in (2, 15, 70, 0)},
    "a private opcode": (in_chunk(3, 0, bytes([134])), 1, "is not there and was left out"),
    **{
        f"length {length}": (
            in_chunk(4, 1, struct.pack("<Q", length)),
            REST,
            "are damaged or cut and were left out",
        )
        for length in (0, 5, 700, 10**5, 2**40, 2**63 + 1)
    },
    "the header's length": (
        lambda whole: put(whole, len(MAGIC) + 1, FAR),
        REST,
        "are damaged or cut and were left out",
    ),
    "zeros": (
        lambda whole: put(whole, len(whole) // 2, bytes(3000)),
        REST,
        "are damaged or cut and were left out",
    ),
    "zeros from the start": (
        lambda whole: put(whole, 0, bytes(2000)),
        REST,
        "are damaged or cut and were left out",
    ),
    "index": (lambda whole: put(whole, len(whole) - 200, bytes(9)), 0, "index at its end is damaged"),
    "a chunk twice": (again, 0, "index at its end is damaged"),
    "bytes gone": (without, REST, "`mcap recover` may find more in them"),
    "a stated size": (in_chunk(4, HEAD.size + 16, FAR), 1, "is damaged and was left out"),
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damage_costs_what_it_covers(path: Path, kind: str):
    damage, most, note = DAMAGES[kind]
    whole = written()
    everything, sound = read(path, whole)
    assert len(everything) == COUNT and not sound.notes and not sound.damage
    rows, container = read(path, damage(whole))
    assert set(rows) <= set(everything)
    lost = [row for row in everything if row not in rows]
    assert (len(lost) > 0) == (most > 0) and len(lost) <= most * COUNT / (
        len(places(whole, Opcode.CHUNK)) - 2
    )
    assert all(is_named(row, container) for row in lost)
    assert any(note in each for each in container.notes), container.notes
    if lost and kind != "bytes gone":  # whose index is off as well
        assert sum(container.missing.values()) == len(lost)


@pytest.mark.slow
@pytest.mark.parametrize("way", [{}, {"use_chunking": False}, {"compression": CompressionType.LZ4}], ids=str)
def test_bits_anywhere_are_never_silent(path: Path, tmp_path: Path, way: dict[str, object]):
    """What is read is of the file, what is not is said; a repaired file has all that the package reads."""
    rng = random.Random(3)
    whole = written(**way)  # type: ignore[arg-type]
    everything, _ = read(path, whole)
    for number in range(60):
        at = rng.randrange(len(whole))
        broken = put(whole, at, bytes([whole[at] ^ 1 << rng.randrange(8)]))
        rows, container = read(path, broken)
        lost = [row for row in everything if row not in rows]
        assert len(rows) == COUNT or container.notes
        if way != {"use_chunking": False}:  # which has no checksums
            assert set(rows) <= set(everything)
            assert all(is_named(row, container) for row in lost)
        if number % 3 == 0 and rows:
            report = repair_container(path, tmp_path / "whole.mcap", force=True)
            with open(tmp_path / "whole.mcap", "rb") as file:
                repaired = [
                    (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
                    for _, channel, message in make_reader(file).iter_messages()
                ]
            more = set(by_package(broken)) & set(everything) - set(repaired)
            assert all(is_named(row, container) for row in more)
            assert set(rows) <= set(repaired) and [r[1] for r in repaired] == sorted(r[1] for r in repaired)
            assert sum(report["messages"].values()) == len(repaired)


def test_a_schema_or_channel_in_a_damaged_first_chunk(path: Path):
    """The file's end has them too; without it messages are dropped, and that is said."""
    whole = written(compression=CompressionType.NONE)
    chunks = places(whole, Opcode.CHUNK)
    damaged = put(whole, chunks[1] - 700, b"x")
    rows, container = read(path, damaged)
    assert len(rows) > COUNT - 60 and any(
        "is missing before its messages" in note for note in container.notes
    )
    rows, container = read(path, damaged[: chunks[5]])
    assert not rows and any("no record describes" in note for note in container.notes)


def test_a_damaged_message_in_a_chunk_without_checksum(path: Path):
    whole = written(compression=CompressionType.NONE, enable_crcs=False)
    everything, _ = read(path, whole)
    message = places(whole, Opcode.CHUNK)[2] + HEAD.size + CHUNK.size + 8 + 5 * (HEAD.size + 22 + 40)
    for value in (struct.pack("<Q", 2**33), bytes(9)):
        rows, container = read(path, put(whole, message + (len(value) == 8), value))
        assert COUNT - 30 < len(rows) < COUNT and set(rows) < set(everything)
        assert "passed over" in container.notes[0] and sum(container.missing.values()) == COUNT - len(rows)


def test_a_chunk_unpacks_to_no_more_than_it_may(path: Path):
    whole = written()
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 28))
    for size in (1 << 40, 100):
        content = CHUNK.pack(1, 2, size, 0, 4) + b"zstd" + struct.pack("<Q", len(bomb)) + bomb
        place = places(whole, Opcode.CHUNK)[1]
        begin = time.process_time()
        chunk = HEAD.pack(Opcode.CHUNK, len(content)) + content
        rows, container = read(path, whole[:place] + chunk + whole[place:])
        assert len(rows) == COUNT and time.process_time() - begin < 1
        assert container.notes


event = st.tuples(st.integers(0, 2), st.integers(0, 2**40), st.integers(0, 90))
events = st.lists(event, max_size=60)
events |= events.map(lambda drawn: sorted(drawn, key=itemgetter(1)))
ways = st.fixed_dictionaries(
    {
        "compression": st.sampled_from([CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4]),
        "chunk_size": st.sampled_from([1, 300, 1 << 20]),
        "use_chunking": st.booleans(),
        "index_types": st.sampled_from([IndexType.ALL, IndexType.ALL & ~IndexType.MESSAGE]),
    }
)


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(events, ways, st.floats(0, 1))
def test_all_messages_are_found_and_a_cut_file_gives_what_it_has(
    path: Path, events: list[tuple[int, int, int]], how: dict[str, object], part: float
):
    whole = written(events, **how)  # type: ignore[arg-type]
    expected = by_package(whole)
    assert len(expected) == len(events)
    rows, container = read(path, whole)
    assert rows == expected
    for topic in container.topics:
        times = [row[1] for row in expected if row[0] == topic.name]
        assert (topic.count, topic.first_ns, topic.last_ns) == (len(times), min(times), max(times))
    cut = whole[: 8 + int(part * (len(whole) - 8))]
    found, container = read(path, cut)
    assert found == by_package(cut) == expected[: len(found)]
    is_cut = len(cut) <= places(whole, Opcode.DATA_END)[0]
    assert not is_cut or any("ends in the middle" in note for note in container.notes)
    if container.damage and len(found) < len(expected) and events == sorted(events, key=itemgetter(1)):
        assert is_named(expected[len(found)], container)  # a cut chunk's times are named


def test_messages_before_their_channel_in_a_chunk(path: Path):
    block = bytearray()
    for number, channel in enumerate([0, 1, 0, 1]):
        if number in (0, 2, 3):
            name = f"/t{channel}".encode()
            content = struct.pack("<HHI", channel, 0, len(name)) + name + struct.pack("<II", 0, 0)
            block += struct.pack("<BQ", Opcode.CHANNEL, len(content)) + content
        block += struct.pack("<BQHIQQ", Opcode.MESSAGE, 27, channel, number, number, number) + b"x" * 5
    chunk = struct.pack("<QQQII", 0, 3, len(block), 0, 0) + struct.pack("<Q", len(block)) + block
    end = struct.pack("<BQI", Opcode.DATA_END, 4, 0)
    rows, container = read(path, MAGIC + struct.pack("<BQ", Opcode.CHUNK, len(chunk)) + chunk + end)
    assert [(row[0], row[3]) for row in rows] == [("/t0", 0), ("/t1", 1), ("/t0", 2), ("/t1", 3)]
    assert [topic.count for topic in container.topics] == [2, 2]


def test_what_is_not_wanted_is_counted_and_passed_over(path: Path):
    path.write_bytes(written([(i % 3, 10 * i, 1000 * (i % 3 == 2)) for i in range(300)], chunk_size=1 << 20))
    container = Container(path)
    found = [each.log_ns for each in container.messages(lambda topic: topic.name == "/b")]
    assert found == [10 * i for i in range(1, 300, 3)]
    assert [(topic.name, topic.count) for topic in container.topics] == [(name, 100) for name in TOPICS]


def test_repair(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """What was lost is listed, and whoever reads the whole file learns of it."""
    output, figures = tmp_path / "b.mcap", tmp_path / "c.json"
    everything, _ = read(path, written())
    report = repair_container(path, output)
    assert not report["notes"] and not report["losses"] and not report["missing"]
    assert read(tmp_path / "c.mcap", output.read_bytes())[0] == everything
    whole = written()
    path.write_bytes(put(whole, places(whole, Opcode.CHUNK)[5], bytes(1000)))
    done("repair", path, "-o", output, "--json", figures, "--force")
    lost = json.loads(figures.read_text())
    assert lost["missing"] and lost["losses"] and lost["notes"]
    assert sum(lost["messages"].values()) + sum(lost["missing"].values()) == COUNT
    out = capsys.readouterr().out
    assert "missing" in out and "left out" in out and "written:" in out
    done("repair", output, "-o", tmp_path / "again.mcap")
    for repaired in (output, tmp_path / "again.mcap"):
        notes = open_recording(repaired).notes
        assert any(note.startswith("damaged file that was repaired") for note in notes)
    for data, said in ((written()[:150], "no complete message"), (b"something else", "")):
        path.write_bytes(data)
        assert run(["repair", str(path), "-o", str(tmp_path / "none.mcap")]) == 1
        assert said in capsys.readouterr().err and not (tmp_path / "none.mcap").exists()
    assert run(["repair", str(path), "-o", str(path)]) == 1
