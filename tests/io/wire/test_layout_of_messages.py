"""Messages of one layout together, against one by one; padded and plain varints; groups."""

from __future__ import annotations

import numpy as np
from mcap_messages import groups

from smoother.io.wire.layout import Grouper, MessageLayout


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
        found = list(groups(grouper, payloads))
        keys = [(block.shape[1], layout.counts["kind"]) for _, block, layout in found]
        assert len(keys) == len(set(keys)) == 9
        indices = [i for index, _, _ in found for i in index.tolist()]
        broken = [i for i, each in enumerate(payloads) if each[0] == 0]
        assert sorted(indices + broken) == list(range(300)) and len(set(indices)) == len(indices)
        assert grouper.broken == len(broken)
        for index, block, layout in found:
            for i, row in zip(index.tolist(), block, strict=True):
                assert row.tobytes() == payloads[i] and payloads[i][0] == layout.counts["kind"]
