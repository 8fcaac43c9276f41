"""Messages of an MCAP file as columns, beside the mcap package; indexes that lie; files that end anywhere."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

from smoother.io.mcap.container import Container
from smoother.io.mcap.messages import Topic
from smoother.io.mcap.records import find

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


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
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


def index_of(places: list[int]) -> bytes:
    entries = np.array([[0, place] for place in places], "<u8").reshape(-1, 2).tobytes()
    return struct.pack("<HI", 0, len(entries)) + entries


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.just(-1) | st.integers(0, 93)), max_size=25),
    st.sets(st.integers(0, 24)),
    st.data(),
)
def test_the_records_count_where_an_index_says_otherwise(
    messages: list[tuple[int, int]], definitions: set[int], data: st.DataObject
):
    block, places, short = records(messages, definitions)
    walked = find(block, [])
    assert walked.place.tolist() == places
    assert walked.heads["sequence"].tolist() == [i for i, (_, size) in enumerate(messages) if size >= 0]
    assert len(walked.definitions) == len([i for i in definitions if i < len(messages)])
    lies = data.draw(st.sampled_from(["none", "fewer", "other", "bytes", "cut", "twice", "short"]))
    stated, index = list(places), b""
    if lies == "fewer" and stated:
        del stated[data.draw(st.integers(0, len(stated) - 1))]
    if lies in ("other", "twice"):
        stated += data.draw(st.lists(st.integers(0, max(len(block), 1)), max_size=3))
        stated += places[:1] if lies == "twice" else []
    stated += short if lies == "short" else []
    index = index_of(data.draw(st.permutations(stated)))
    if lies == "bytes":
        index = index[: data.draw(st.integers(0, len(index)))]
    if lies == "cut":
        block = block[: data.draw(st.integers(0, len(block)))]
    found, expected = find(block, [index]), find(block, [])
    assert found.place.tolist() == expected.place.tolist()
    assert found.heads.tobytes() == expected.heads.tobytes()
    assert (found.definitions, found.is_cut) == (expected.definitions, expected.is_cut)


def test_the_index_is_used_where_it_is_right(monkeypatch: pytest.MonkeyPatch):
    block, places, _ = records([(0, 50)] * 20, {0})
    sizes = []
    walk = find.__globals__["_walked"]
    monkeypatch.setitem(find.__globals__, "_walked", lambda *a: sizes.append(a[2] - a[1]) or walk(*a))
    assert find(block, [index_of(places[::2]), index_of(places[1::2])]).place.tolist() == places
    assert sum(sizes) == places[0]  # the channel's record alone


def test_messages_before_their_channel_are_of_nobody(tmp_path: Path):
    block, *_ = records([(0, 5), (1, 5), (0, 5), (1, 5)], {0, 2, 3})
    chunk = struct.pack("<QQQII", 0, 3, len(block), 0, 0) + struct.pack("<Q", len(block)) + block
    path = tmp_path / "late.mcap"
    end = struct.pack("<BQI", Opcode.DATA_END, 4, 0)
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", Opcode.CHUNK, len(chunk)) + chunk + end)
    assert [(row[0], row[3]) for row in by_chunks(path)] == [("/t0", 0), ("/t0", 2), ("/t1", 3)]
    container = Container(path)
    assert [sorted(batch) for batch in container.by_topic(lambda topic: topic.name == "/t1")] == [[1]]
    assert [topic.count for topic in container.topics] == [2, 1]


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
    assert [topic.name for topic in chunk.topics] == ["/b"] and set(chunk.topic.tolist()) == {0}
