"""Containers that are damaged or cut at any byte: what is there is read, and what is not is said."""

from __future__ import annotations

import random
import struct
import time
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_records import places, put

from smoother.errors import RecordingError
from smoother.io.mcap.container import Container
from smoother.io.mcap.messages import Topic, plain_name
from smoother.io.mcap.records import CHUNK, HEAD, MAGIC

COUNT = 300
Rows = list[tuple[str, int, bytes]]


def written(
    compression: CompressionType = CompressionType.ZSTD, chunked: bool = True, crcs: bool = True
) -> bytes:
    """A file of two topics in some ten chunks; channels are in the first alone."""
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
    assert "head of the chunk" in container.notes[0]


@pytest.mark.parametrize("length", [0, 5, 700, 10**5, 2**40, 2**63 + 1])
def test_a_damaged_length_costs_a_chunk_at_most(path: Path, length: int):
    whole = written()
    everything, _ = read(path, whole)
    chunks = places(whole, Opcode.CHUNK)
    rows, container = read(path, put(whole, chunks[4] + 1, struct.pack("<Q", length)))
    assert rows == everything and container.notes
    rows, container = read(path, put(whole, len(MAGIC) + 1, struct.pack("<Q", length)))  # the header's
    lost = COUNT - len(rows)
    assert rows == everything[lost:] and lost < COUNT / (len(chunks) - 2) and container.notes


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


def test_a_damaged_length_outside_chunks_costs_some_messages(path: Path):
    whole = written(chunked=False)
    everything, _ = read(path, whole)
    for length in (23, 500, 2**50):
        damaged = put(whole, places(whole, Opcode.MESSAGE)[100] + 1, struct.pack("<Q", length))
        rows, container = read(path, damaged)
        assert rows[:100] == everything[:100] and rows[-180:] == everything[-180:] and container.notes


def test_messages_before_their_channel(path: Path):
    """As the record that comes late describes it."""
    whole = written(chunked=False)
    everything, _ = read(path, whole)
    first, second = places(whole, Opcode.CHANNEL)[:2]
    length = HEAD.size + HEAD.unpack_from(whole, second)[1]
    late = places(whole, Opcode.MESSAGE)[10]
    moved = whole[:second] + whole[second + length : late] + whole[second : second + length] + whole[late:]
    assert first < second and len(moved) == len(whole)
    assert read(path, moved)[0] == everything
    rows, _ = read(path, moved[: len(moved) // 2])
    assert rows == everything[: len(rows)] and len(rows) > COUNT / 3


def test_channels_of_a_damaged_chunk(path: Path):
    """The first chunk has them and fails its checksum: the summary serves, else that chunk itself."""
    whole = written(CompressionType.NONE)
    chunks = places(whole, Opcode.CHUNK)
    damaged = put(whole, chunks[1] - 700, b"x")
    for end in (len(whole), chunks[5]):
        rows, container = read(path, damaged[:end])
        assert len(rows) > COUNT / 4 and any("taken from elsewhere" in note for note in container.notes)


def test_a_damaged_message_in_a_chunk_without_checksum(path: Path):
    whole = written(CompressionType.NONE, crcs=False)
    everything, _ = read(path, whole)
    chunk = places(whole, Opcode.CHUNK)[2]
    start = chunk + HEAD.size + CHUNK.size + 8
    message = start + 5 * (HEAD.size + 22 + 40)
    for value in (struct.pack("<Q", 2**33), bytes(9)):
        rows, container = read(path, put(whole, message + (len(value) == 8), value))
        assert COUNT - 30 < len(rows) < COUNT and set(rows) < set(everything)
        assert "passed over" in container.notes[0] and sum(container.missing.values()) == COUNT - len(rows)


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
def test_messages_that_were_put_in_or_taken_out_are_told(path: Path, chunked: bool):
    whole = written(chunked=chunked)
    everything, _ = read(path, whole)
    kind = Opcode.CHUNK if chunked else Opcode.MESSAGE
    first, second = places(whole, kind)[4:6]
    rows, container = read(path, whole[:second] + whole[first:second] + whole[second:])
    assert len(rows) > COUNT and set(rows) == set(everything)
    assert any("index at its end is damaged" in note for note in container.notes)
    rows, container = read(path, whole[:second] + whole[second + 30 :])
    assert len(rows) < COUNT and any("damaged and were left out" in note for note in container.notes)


TOPICS = ("/a", "/b", "/c")
INDEXED = IndexType.ALL
NOT_INDEXED = IndexType.ALL & ~IndexType.MESSAGE


def write(events: list[tuple[int, int, int]], **how: object) -> bytes:
    """A file of messages (topic, log time, size); channels are made when they are first used."""
    file = BytesIO()
    writer = Writer(file, **how)  # type: ignore[arg-type]
    writer.start()
    channels: dict[int, int] = {}
    for number, (topic, log_ns, size) in enumerate(events):
        if topic not in channels:
            schema = writer.register_schema(f"schema{topic}", "", b"text")
            channels[topic] = writer.register_channel(TOPICS[topic], "raw", schema)
        data = bytes((number + i) % 256 for i in range(size))
        writer.add_message(channels[topic], log_ns, data, log_ns + 1, number)
    writer.finish()
    return file.getvalue()


def by_package(data: bytes) -> list[tuple[str, int, int, int, bytes]]:
    """All that can be had of a file, record by record, as the mcap package reads it."""
    channels: dict[int, str] = {}
    found = []
    try:
        for record in StreamReader(BytesIO(data), record_size_limit=None).records:
            if hasattr(record, "topic"):
                channels[record.id] = record.topic
            elif isinstance(record, McapMessage):
                topic = channels[record.channel_id]
                row = (record.log_time, record.publish_time, record.sequence, record.data)
                found.append((topic, *row))
    except Exception:  # cut off
        pass
    return found


def by_chunks(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    found = []
    for chunk in Container(path).chunks(lambda topic: True):
        names = [chunk.topics[number].name for number in chunk.topic.tolist()]
        columns = chunk.log_ns.tolist(), chunk.publish_ns.tolist(), chunk.sequence.tolist(), chunk.data
        found += list(zip(names, *columns, strict=True))
    return found


def by_rows(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    container = Container(path)
    found: dict[str, list[tuple[int, bytes]]] = {}
    for batch in container.by_topic(lambda topic: True):
        for position, rows in batch.items():
            data = [rows.chunk[a:b] for a, b in zip(rows.start.tolist(), rows.stop.tolist(), strict=True)]
            found.setdefault(container.topics[position].name, []).extend(
                zip(rows.log_ns.tolist(), data, strict=True)
            )
    counts = {topic.name: (topic.count, topic.first_ns, topic.last_ns) for topic in container.topics}
    for name, messages in found.items():
        times = [log_ns for log_ns, _ in messages]
        assert counts[name] == (len(messages), min(times), max(times))
    return found


events = st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2**40), st.integers(0, 90)), max_size=60)
ways = st.fixed_dictionaries(
    {
        "compression": st.sampled_from([CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4]),
        "chunk_size": st.sampled_from([1, 300, 1 << 20]),
        "use_chunking": st.booleans(),
        "index_types": st.sampled_from([INDEXED, NOT_INDEXED]),
    }
)
quick = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@quick
@given(events, ways)
def test_all_messages_are_found(tmp_path: Path, events: list[tuple[int, int, int]], how: dict[str, object]):
    path = tmp_path / "a.mcap"
    path.write_bytes(write(events, **how))
    expected = by_package(path.read_bytes())
    assert len(expected) == len(events)
    assert by_chunks(path) == expected
    with open(path, "rb") as file:  # the package's other reader, by the index at the file's end
        logged = sorted(message.log_time for _, _, message in make_reader(file).iter_messages())
    assert logged == sorted(row[1] for row in expected)
    rows = by_rows(path)
    for name in TOPICS:
        assert rows.get(name, []) == [(row[1], row[4]) for row in expected if row[0] == name]


@quick
@given(events, ways, st.floats(0, 1))
def test_a_cut_file_gives_what_it_has(
    tmp_path: Path, events: list[tuple[int, int, int]], how: dict[str, object], part: float
):
    whole = write(events, **how)
    path = tmp_path / "a.mcap"
    path.write_bytes(whole[: 8 + int(part * (len(whole) - 8))])
    found, expected = by_chunks(path), by_package(path.read_bytes())
    # Of a chunk that is cut, the package gives nothing; what goes beyond must be of the whole file.
    assert found[: len(expected)] == expected
    assert found == by_package(whole)[: len(found)]
    rows = by_rows(path)
    assert sum(map(len, rows.values())) == len(found)


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4])
def test_a_file_may_be_cut_at_any_byte(tmp_path: Path, compression: CompressionType):
    """Also within a chunk's head, where the name of its compression stands."""
    whole = write([(i % 3, i, 40) for i in range(12)], compression=compression, chunk_size=300)
    path, expected = tmp_path / "a.mcap", by_package(whole)
    for stop in range(8, len(whole)):
        path.write_bytes(whole[:stop])
        found = by_chunks(path)
        assert found == expected[: len(found)]


def records(messages: list[tuple[int, int]], definitions: set[int]) -> tuple[bytes, list[int], list[int]]:
    """A chunk of messages (channel, size), with channel records before some; where messages begin.

    A message of size -1 is too short to be one; where those begin comes third.
    """
    block, places, short = bytearray(), [], []
    for number, (channel, size) in enumerate(messages):
        if number in definitions:
            name = f"/t{channel}".encode()
            content = struct.pack("<HHI", channel, 0, len(name)) + name + struct.pack("<II", 0, 0)
            block += struct.pack("<BQ", Opcode.CHANNEL, len(content)) + content
        if size < 0:
            short.append(len(block))
            block += struct.pack("<BQ", Opcode.MESSAGE, 10) + bytes(10)
            continue
        places.append(len(block))
        block += struct.pack("<BQHIQQ", Opcode.MESSAGE, 22 + size, channel, number, number, number)
        # Payloads that look like records themselves.
        block += (struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, 1, 0, 0, 0) * 3)[:size]
    return bytes(block), places, short


def test_messages_before_their_channel_in_a_chunk(tmp_path: Path):
    block, *_ = records([(0, 5), (1, 5), (0, 5), (1, 5)], {0, 2, 3})
    chunk = struct.pack("<QQQII", 0, 3, len(block), 0, 0) + struct.pack("<Q", len(block)) + block
    path = tmp_path / "late.mcap"
    end = struct.pack("<BQI", Opcode.DATA_END, 4, 0)
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", Opcode.CHUNK, len(chunk)) + chunk + end)
    expected = [("/t0", 0), ("/t1", 1), ("/t0", 2), ("/t1", 3)]
    assert [(row[0], row[3]) for row in by_chunks(path)] == expected
    container = Container(path)
    assert [sorted(batch) for batch in container.by_topic(lambda topic: topic.name == "/t1")] == [[1]]
    assert [topic.count for topic in container.topics] == [2, 2]


def test_what_is_not_wanted_is_counted_and_passed_over(tmp_path: Path):
    path = tmp_path / "a.mcap"
    path.write_bytes(write([(i % 3, 10 * i, 1000 * (i % 3 == 2)) for i in range(300)]))

    def wanted(topic: Topic) -> bool:
        return topic.name == "/b"

    container = Container(path)
    batches = list(container.batches(wanted))
    assert [message.log_ns for batch in batches for message in batch[1]] == [10 * i for i in range(1, 300, 3)]
    assert all(list(batch) == [1] for batch in batches)
    assert [(topic.name, topic.count) for topic in container.topics] == [(name, 100) for name in TOPICS]
    (chunk,) = Container(path).chunks(wanted)
    assert set(chunk.topic.tolist()) == {1} and len(chunk.chunk) == 0
