"""Gaps as messages: an event each, and a line of a log, which more programs show."""

from __future__ import annotations

from collections.abc import Sequence

from ...array_types import IntArray
from ...measurements.visibility import Gap
from ...result import GapVerdict
from ..wire.schemas import message_class


def gap_messages(
    gaps: Sequence[Gap],
    start_ns: IntArray,
    end_ns: IntArray,
    side: str,
    verdicts: Sequence[GapVerdict] | None = None,
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
    verdicts : sequence of GapVerdict, optional
        Whether each is to be trusted; None where nobody each_verdict. An event then has no `trusted`.

    Returns
    -------
    events, lines : list of bytes
        One of each a gap.
    """
    events, lines = [], []
    each_verdict: Sequence[GapVerdict | None] = [None] * len(gaps) if verdicts is None else verdicts
    for gap, verdict, start, end in zip(gaps, each_verdict, start_ns.tolist(), end_ns.tolist(), strict=True):
        event = message_class("foxglove.Event")()
        event.start_time.FromNanoseconds(start)
        event.end_time.FromNanoseconds(end)
        values = {"kind": "occluded", "length_s": f"{gap.length_s:.3f}"}
        values |= {"side": side} if side else {}
        values |= {"open": "start"} if gap.open_start else {}
        values |= {"open": "end"} if gap.open_end else {}
        if verdict is not None:
            values["trusted"] = str(verdict.trusted).lower()
            values |= {} if verdict.trusted else {"reasons": "; ".join(verdict.reasons)}
        for key, value in values.items():
            event.metadata.add(key=key, value=value)
        events.append(event.SerializeToString(deterministic=True))
        line = message_class("foxglove.Log")()
        line.timestamp.FromNanoseconds(start)
        line.level = line.WARNING
        line.message = f"{side} forearm occluded for {gap.length_s:.2f} s".lstrip()
        if verdict is not None and not verdict.trusted:
            line.level = line.ERROR
            line.message += f"; the answer is not to be trusted: {'; '.join(verdict.reasons)}"
        line.name = "unocclude"
        lines.append(line.SerializeToString(deterministic=True))
    return events, lines
