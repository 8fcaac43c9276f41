"""Gaps as messages: an event each, and a line of a log, which more programs show."""

from __future__ import annotations

from collections.abc import Sequence

from ...array_types import IntArray
from ...measurements.visibility import Gap
from ..wire.schemas import message_class


def gap_messages(
    gaps: Sequence[Gap], start_ns: IntArray, end_ns: IntArray, side: str
) -> tuple[list[bytes], list[bytes]]:
    """Events (`foxglove.Event`) and lines (`foxglove.Log`), encoded.

    Parameters
    ----------
    gaps : sequence of Gap
        Of the forearm.
    start_ns, end_ns : ndarray of int, shape (n,), ns
        Stamps of their ends.
    side : str
        Of the arm; "" where it is not known.

    Returns
    -------
    events, lines : list of bytes
        One of each a gap.
    """
    events, lines = [], []
    for gap, start, end in zip(gaps, start_ns.tolist(), end_ns.tolist(), strict=True):
        event = message_class("foxglove.Event")()
        event.start_time.FromNanoseconds(start)
        event.end_time.FromNanoseconds(end)
        values = {"kind": "occluded", "length_s": f"{gap.length_s:.3f}"}
        values |= {"side": side} if side else {}
        values |= {"open": "start"} if gap.open_start else {}
        values |= {"open": "end"} if gap.open_end else {}
        for key, value in values.items():
            event.metadata.add(key=key, value=value)
        events.append(event.SerializeToString(deterministic=True))
        line = message_class("foxglove.Log")()
        line.timestamp.FromNanoseconds(start)
        line.level = line.WARNING
        line.message = f"{side} forearm occluded for {gap.length_s:.2f} s".lstrip()
        line.name = "unocclude"
        lines.append(line.SerializeToString(deterministic=True))
    return events, lines
