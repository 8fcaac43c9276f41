"""Messages of one layout together, against one by one; padded and plain varints; groups."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.io.wire import layout as module
from smoother.io.wire.layout import Grouper, MessageLayout, axes, copy_runs, cut_out, joined


def rows(*payloads: bytes) -> np.ndarray:
    return np.array([np.frombuffer(each, np.uint8) for each in payloads])


@pytest.mark.parametrize(
    ("raw", "value"),
    [
        (b"\x05", 5),
        (b"\x80\x01", 128),
        (b"\xac\x02", 300),
        (b"\x85\x80\x80\x00", 5),
        (b"\xff" * 9 + b"\x01", -1),
        (b"\xff" * 8 + b"\x7f", 2**63 - 1),
    ],
)
def test_a_varint(raw: bytes, value: int) -> None:
    data = b"ab" + raw + b"c"
    layout = MessageLayout.of(data)
    layout.varints["n"] = (2, len(raw))
    block = rows(data, data)
    assert layout.integer(block, "n").tolist() == [value, value]
    assert layout.integer(block, "absent").tolist() == [0, 0]
    assert layout.integer(block, "n").dtype == np.int64


def test_fields_of_several_rows() -> None:
    """First occurrence, all occurrences, and doubles that protobuf left out."""
    numbers = np.array([[1.5, 2.5, -3.0, 4.0], [5.0, 6.0, 7.0, 8.0], [0.0, -0.5, 1e300, 2.0]])
    payloads = [b"xyz" + each.astype("<f8").tobytes() + b"\x07\0" for each in numbers]
    block = rows(*payloads)
    layout = MessageLayout.of(payloads[0])
    layout.add("pair", 3, "<f8", 2)
    layout.add("pair", 19, "<f8", 2)
    layout.add("p.x", 3, "<f8", 1)
    layout.add("p.z", 11, "<f8", 1)
    layout.add("n", 35, "<u2", 1)
    np.testing.assert_array_equal(layout.get(block, "pair"), numbers[:, :2])
    np.testing.assert_array_equal(layout.many(block, "pair"), numbers.reshape(3, 2, 2))
    np.testing.assert_array_equal(layout.get(block, "n"), [[7]] * 3)
    expected = np.column_stack([numbers[:, 0], np.zeros(3), numbers[:, 1]])
    np.testing.assert_array_equal(layout.vector(block, axes("p")), expected)
    assert layout.get(block[:0], "pair").shape == (0, 2) and layout.get(block[:0], "pair").dtype == np.float64
    values = layout.get(block, "pair")
    values[:] = 0.0  # a copy: the message stays
    np.testing.assert_array_equal(layout.get(block, "pair"), numbers[:, :2])


def test_names_of_components() -> None:
    assert axes("p") == ["p.x", "p.y", "p.z"] and axes("q", "wz") == ["q.w", "q.z"]


def test_only_what_was_fixed_is_compared() -> None:
    """Whole bytes, or some bits of them, that were fixed one after the other."""
    layout = MessageLayout.of(b"\x81\x42\x10\x33")
    layout.fix(0, 1, 0x80)
    layout.fix(3, 4)
    layout.fix(0, 1, 0x01)
    layout.finish()
    block = rows(b"\x81\0\0\x33", b"\xff\0\0\x33", b"\x80\0\0\x33", b"\x01\0\0\x33", b"\x81\0\0\x32")
    assert layout.matches(block).tolist() == [True, True, False, False, False]


def walk(data: bytes) -> MessageLayout:
    """The first byte decides; one that is zero cannot be walked."""
    if data[0] == 0:
        raise ValueError("no message")
    layout = MessageLayout.of(data)
    layout.fix(0, 1)
    layout.counts["kind"] = data[0]
    return layout


def test_groups_hold_every_message_once() -> None:
    rng = np.random.default_rng(0)
    payloads = [
        bytes([int(rng.integers(0, 4))]) + bytes(rng.integers(0, 256, int(rng.integers(0, 3))).tolist())
        for _ in range(300)
    ]
    grouper = Grouper(walk)
    assert grouper.broken == 0
    for _ in range(2):  # the second time all layouts are known
        grouper.broken = 0
        groups = list(grouper.groups(payloads))
        keys = [(block.shape[1], layout.counts["kind"]) for _, block, layout in groups]
        assert len(keys) == len(set(keys)) == 9
        indices = [i for index, _, _ in groups for i in index.tolist()]
        broken = [i for i, each in enumerate(payloads) if each[0] == 0]
        assert sorted(indices + broken) == list(range(300)) and len(set(indices)) == len(indices)
        assert grouper.broken == len(broken)
        for index, block, layout in groups:
            for i, row in zip(index.tolist(), block, strict=True):
                assert row.tobytes() == payloads[i] and payloads[i][0] == layout.counts["kind"]


def test_payloads_inside_a_buffer() -> None:
    data = b"--\x01ab-\x01cd\x02e-"
    start, stop = np.array([2, 6, 9]), np.array([5, 9, 11])
    groups = list(Grouper(walk).groups_in(data, start, stop))
    assert [(index.tolist(), block.tobytes()) for index, block, _ in groups] == [
        ([2], b"\x02e"),
        ([0, 1], b"\x01ab\x01cd"),
    ]
    assert list(Grouper(walk).groups([])) == []


def test_a_stream_without_regularity_is_not_remembered() -> None:
    """Sixty-four layouts of a size, no more: the rest are walked again each time."""
    walked = []

    def counting(data: bytes) -> MessageLayout:
        walked.append(data[0])
        return walk(data)

    payloads = [bytes([kind]) for kind in range(1, 71)]
    grouper = Grouper(counting)
    assert sum(len(index) for index, _, _ in grouper.groups(payloads)) == 70 and len(walked) == 70
    assert sum(len(index) for index, _, _ in grouper.groups(payloads)) == 70
    assert walked[70:] == list(range(65, 71))


@pytest.mark.parametrize("error", module.BROKEN)
def test_what_a_walk_may_raise_is_counted(error: type[Exception]) -> None:
    def failing(data: bytes) -> MessageLayout:
        raise error("broken")

    grouper = Grouper(failing, 5)
    assert list(grouper.groups([b"a", b"bb"])) == [] and grouper.broken == 7
    with pytest.raises(KeyError):
        list(Grouper(lambda _: {}["no walk"]).groups([b"a"]))


def test_bytes_cut_out_of_a_buffer() -> None:
    np.testing.assert_array_equal(cut_out(b"abcdef", np.array([3, 0]), 2), rows(b"de", b"ab"))
    assert cut_out(b"abc", np.array([1, 2]), 0).shape == (2, 0)
    nothing = cut_out(b"", np.zeros(0, np.int64), 4)
    assert nothing.shape == (0, 4) and nothing.dtype == np.uint8
    assert cut_out(b"abc", np.array([0]), 3).tobytes() == b"abc"


@pytest.mark.parametrize("seed", range(3))
def test_bytes_put_together_in_another_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.bytes(500)
    size = rng.choice([0, 1, 7, 40], 60)
    start = rng.integers(0, 501 - size)
    parts = [source[a : a + n] for a, n in zip(start.tolist(), size.tolist(), strict=True)]
    target, begin, end = joined(source, start, start + size)
    assert bytes(target) == b"".join(parts)
    assert [bytes(target[a:b]) for a, b in zip(begin, end, strict=True)] == parts
    order = rng.permutation(60)
    ends = np.cumsum(size[order])
    place = np.empty_like(ends)
    place[order] = ends - size[order]
    out = memoryview(bytearray(int(size.sum())))
    copy_runs(source, start, size, out, place)
    assert bytes(out) == b"".join(parts[k] for k in order.tolist())
    assert bytes(joined(b"", np.zeros(0, int), np.zeros(0, int))[0]) == b""
