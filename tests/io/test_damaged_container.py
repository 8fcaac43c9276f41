"""Containers with damage inside: reading resumes behind it, and what is lost is counted and said."""

from __future__ import annotations

import random
import struct
import time
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from smoother.errors import RecordingError
from smoother.io.mcap.container import Container
from smoother.io.mcap.messages import plain_name
from smoother.io.mcap.records import CHUNK, HEAD, MAGIC, find
from smoother.io.mcap.top_level import LIMIT_NAME
from tools.faults.file_faults import places, put

COUNT = 300
Rows = list[tuple[str, int, bytes]]


def written(
    compression: CompressionType = CompressionType.ZSTD, chunked: bool = True, crcs: bool = True
) -> bytes:
    """A file of two topics in some ten chunks; channels stand in the first alone."""
    file = BytesIO()
    writer = Writer(
        file,
        chunk_size=2000,
        compression=compression,
        use_chunking=chunked,
        enable_crcs=crcs,
        index_types=IndexType.ALL,
    )
    writer.start()
    schema = writer.register_schema("text", "", b"")
    channels = [writer.register_channel(topic, "raw", schema) for topic in ("/a", "/b")]
    rng = random.Random(0)
    for number in range(COUNT):
        time_ns = 10**18 + number * 10**7
        writer.add_message(channels[number % 2], time_ns, rng.randbytes(40), time_ns, number)
    writer.finish()
    return file.getvalue()


def read(path: Path, data: bytes) -> tuple[Rows, Container]:
    path.write_bytes(data)
    container = Container(path)
    return [(m.topic.name, m.log_ns, bytes(m.data)) for m in container.messages()], container


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "damaged.mcap"


def test_a_damaged_first_chunk_costs_that_chunk_alone(path: Path):
    whole = written()
    chunks = places(whole, Opcode.CHUNK)
    everything, _ = read(path, whole)
    start = chunks[0] + HEAD.size + CHUNK.size + 4 + 8 + 100
    rows, container = read(path, put(whole, start, bytes([whole[start] ^ 1])))
    lost = [row for row in everything if row not in rows]
    assert 0 < len(lost) < COUNT / (len(chunks) - 2)
    assert rows == everything[len(lost) :]
    (loss,) = container.losses
    assert sum(loss.counts.values()) == sum(container.missing.values()) == len(lost)
    (note,) = [note for note in container.notes if "checksum" in note]
    assert f"{loss.counts['/a']} of /a" in note and "0.000 to" in note


@pytest.mark.parametrize("opcode", [0x02, 0x0F, 0x46, 0x86, 0x00])
def test_a_chunk_is_told_by_what_is_in_it(path: Path, opcode: int):
    whole = written()
    everything, sound = read(path, whole)
    assert not sound.notes
    rows, container = read(path, put(whole, places(whole, Opcode.CHUNK)[3], bytes([opcode])))
    assert rows == everything
    assert "opcode" in container.notes[0]


@pytest.mark.parametrize("length", [0, 5, 700, 10**5, 2**40, 2**63 + 1])
def test_a_damaged_length_costs_no_chunk(path: Path, length: int):
    whole = written()
    everything, _ = read(path, whole)
    for place in (len(MAGIC), places(whole, Opcode.CHUNK)[4]):  # the header's, and a chunk's
        rows, container = read(path, put(whole, place + 1, struct.pack("<Q", length)))
        assert rows == everything
        assert container.notes


@pytest.mark.parametrize("length", [10**5, 2**63 + 1, 2**64 - 1])
def test_a_cut_chunk_with_damaged_sizes_is_left_out(path: Path, length: int):
    """Its end, by the length it states, lies where no file reaches."""
    whole = written()
    start = places(whole, Opcode.CHUNK)[-1]
    everything, _ = read(path, whole)
    damaged = put(whole, start + 1, struct.pack("<Q", length))
    damaged = put(damaged, start + HEAD.size + 16, struct.pack("<Q", 2**62))  # bytes that it holds
    rows, container = read(path, damaged[: start + 500])
    assert 0 < len(rows) < COUNT and rows == everything[: len(rows)]
    (loss,) = container.losses
    assert "left out" in loss.what and loss.stop <= start + 500


@pytest.mark.parametrize("chunked", [True, False])
def test_zeros_in_the_middle_cost_what_they_cover(path: Path, chunked: bool):
    whole = written(chunked=chunked)
    everything, _ = read(path, whole)
    for begin, size in ((3000, 200), (len(whole) // 2, 3000), (0, 2000)):
        rows, container = read(path, put(whole, begin, bytes(size)))
        assert len(set(rows) - set(everything)) <= (not chunked)  # zeros in a payload, without a checksum
        assert rows[-1] == everything[-1]
        assert len(rows) > COUNT - 120 and len(rows) < COUNT
        assert sum(container.missing.values()) == COUNT - len(rows)
        assert any("damaged" in note for note in container.notes)


@pytest.mark.parametrize("opcode", [0x02, 0x0F, 0x45, 0x00])
def test_one_message_outside_chunks_is_damaged(path: Path, opcode: int):
    whole = written(chunked=False)
    everything, _ = read(path, whole)
    rows, container = read(path, put(whole, places(whole, Opcode.MESSAGE)[100], bytes([opcode])))
    assert rows == everything[:100] + everything[101:]
    assert "damaged" in container.notes[0] and sum(container.missing.values()) == 1


def test_a_damaged_length_outside_chunks_costs_a_message(path: Path):
    whole = written(chunked=False)
    everything, _ = read(path, whole)
    for length in (23, 500, 2**50):
        damaged = put(whole, places(whole, Opcode.MESSAGE)[100] + 1, struct.pack("<Q", length))
        rows, container = read(path, damaged)
        assert rows == everything[:100] + everything[101:]
        assert container.notes


def test_messages_before_their_channel_are_counted(path: Path):
    """As the file's end describes it where there is one; else they are dropped, with a note."""
    whole = written(chunked=False)
    everything, _ = read(path, whole)
    first, second = places(whole, Opcode.CHANNEL)[:2]
    length = HEAD.size + HEAD.unpack_from(whole, second)[1]
    late = places(whole, Opcode.MESSAGE)[10]
    moved = whole[:second] + whole[second + length : late] + whole[second : second + length] + whole[late:]
    assert first < second and len(moved) == len(whole)
    rows, container = read(path, moved)
    assert rows == everything and "come before its record" in container.notes[0]
    rows, container = read(path, moved[: len(moved) // 2])
    assert [row for row in rows if row[0] == "/b"] == [r for r in everything if r[0] == "/b"][
        5 : 5 + len(rows)
    ][: sum(row[0] == "/b" for row in rows)]
    assert any("5 messages of channels that no record" in note for note in container.notes)


def test_a_chunk_that_is_there_twice_is_read_once(path: Path):
    whole = written()
    everything, _ = read(path, whole)
    first, second = places(whole, Opcode.CHUNK)[2:4]
    rows, container = read(path, whole[:second] + whole[first:second] + whole[second:])
    assert rows == everything and "twice" in container.notes[0]


def test_a_damaged_message_in_a_chunk_without_checksum(path: Path):
    whole = written(CompressionType.NONE, crcs=False)
    everything, _ = read(path, whole)
    chunk = places(whole, Opcode.CHUNK)[2]
    start = chunk + HEAD.size + CHUNK.size + 8
    message = start + 5 * (HEAD.size + 22 + 40)
    for value in (struct.pack("<Q", 2**33), bytes(9)):
        rows, container = read(path, put(whole, message + (len(value) == 8), value))
        assert len(rows) == COUNT - 1 and set(rows) < set(everything)
        assert "passed over" in container.notes[0]


def test_a_chunk_unpacks_to_no_more_than_it_may(path: Path, monkeypatch: pytest.MonkeyPatch):
    whole = written()
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 28))
    for size in (len(bomb) * 0 + (1 << 40), 100):
        content = CHUNK.pack(1, 2, size, 0, 4) + b"zstd" + struct.pack("<Q", len(bomb)) + bomb
        chunk = HEAD.pack(Opcode.CHUNK, len(content)) + content
        place = places(whole, Opcode.CHUNK)[1]
        begin = time.process_time()
        rows, container = read(path, whole[:place] + chunk + whole[place:])
        assert len(rows) == COUNT and time.process_time() - begin < 1
        assert container.notes
    monkeypatch.setenv(LIMIT_NAME, "0.1")
    with pytest.raises(Exception, match="is a number of megabytes"):
        read(path, whole)


def test_zeros_are_not_walked(path: Path):
    begin = time.process_time()
    records = find(bytes(50_000_000), [], True)
    assert not len(records.place) and records.damaged == 50_000_000
    assert time.process_time() - begin < 2  # one by one it takes a second each 4 MB


def test_bits_anywhere_are_never_silent(path: Path):
    """What is read is of the file, and what is not is said."""
    rng = random.Random(3)
    for way in ({}, {"chunked": False}, {"compression": CompressionType.LZ4}):
        whole = written(**way)  # type: ignore[arg-type]
        everything, _ = read(path, whole)
        for _ in range(60):
            at = rng.randrange(len(whole))
            try:
                rows, container = read(path, put(whole, at, bytes([whole[at] ^ 1 << rng.randrange(8)])))
            except RecordingError:
                pytest.fail(f"nothing was read with byte {at} changed")
            assert len(rows) == COUNT or container.notes
            if way != {"chunked": False}:  # which has no checksums
                assert set(rows) <= set(everything)
            assert len(rows) > COUNT - 60


def test_names_are_fit_for_a_message():
    assert plain_name("/imu/wrist") == "/imu/wrist"
    assert plain_name("/a\x1b[31m\nb") == r"/a\x1b[31m\x0ab"
    assert len(plain_name("x" * 10**6)) == 80


@pytest.mark.parametrize("chunked", [True, False])
def test_a_message_that_is_there_twice_is_told(path: Path, chunked: bool):
    """The file's own count is read also where bytes that were put in have moved it."""
    whole = written(chunked=chunked)
    everything, _ = read(path, whole)
    kind = Opcode.CHUNK if chunked else Opcode.MESSAGE
    first, second = places(whole, kind)[4:6]
    rows, container = read(path, whole[:second] + whole[first:second] + whole[second:])
    assert len(rows) == COUNT + (not chunked) and set(rows) == set(everything)
    assert any(("twice" if chunked else "beyond the file's own count") in note for note in container.notes)
    rows, container = read(path, whole[:second] + whole[second + 30 :])
    assert len(rows) < COUNT and sum(container.missing.values()) == COUNT - len(rows)
