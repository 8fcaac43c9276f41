"""Drawn motions as messages, about a second each, and back: 16 bits a number."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...result import Draws
from ..mcap.messages import Topic, TopicMessages
from ..mcap.stamps import seconds
from ..wire.schemas import message_class
from .topic_tables import TopicTable

SCHEMA = "unocclude.Draws"
#: Drawn times in a message.
ROWS = 25
#: What stands for no answer; the largest number beside it is as far from zero on the other side.
_NOTHING, _MOST = -32768, 32767
_JOINT = "joint_"
_KIND = np.dtype("<i2")


def message_rows(draws: Draws) -> IntArray:
    """The first of each message's drawn times."""
    return np.arange(0, len(draws.t_s), ROWS)


def draw_messages(draws: Draws, stamp: IntArray, first: IntArray, frame_id: str) -> Iterator[bytes]:
    """Drawn motions, encoded.

    Parameters
    ----------
    draws : Draws
    stamp : ndarray of int, shape (m,), ns
        Of all drawn times.
    first : ndarray of int
        Some of `message_rows`.
    frame_id : str
        Of the camera.

    Yields
    ------
    message : bytes
        One each.
    """
    for start in first.tolist():
        rows = slice(start, start + ROWS)
        message = message_class(SCHEMA)()
        message.timestamp.FromNanoseconds(int(stamp[start]))
        message.frame_id, message.motions = frame_id, len(draws)
        message.offset.extend((stamp[rows] - stamp[start]).tolist())
        for name, values in _columns(draws).items():
            part = np.moveaxis(values[:, rows], 0, 1)
            known = np.isfinite(part)
            scale = float(np.abs(part[known]).max(initial=0.0)) / _MOST or 1.0
            whole = np.where(known, np.rint(np.where(known, part, 0.0) / scale), _NOTHING)
            message.drawn.add(name=name, scale=scale, deviation=whole.astype(_KIND).tobytes())
        yield message.SerializeToString(deterministic=True)


def _columns(draws: Draws) -> dict[str, FloatArray]:
    """All quantities by the names that messages have for them."""
    columns = {"position": draws.position, "rotation": draws.rotation}
    columns |= {_JOINT + joint: values for joint, values in draws.joints.items()}
    return columns if draws.upper_rotation is None else columns | {"upper_rotation": draws.upper_rotation}


class DrawsTable(TopicTable):
    """Drawn motions, gathered batch by batch in the file's order.

    Parameters
    ----------
    topic : Topic
    """

    def __init__(self, topic: Topic):
        super().__init__(topic)
        self._stamps: list[IntArray] = []
        self._parts: dict[str, list[NDArray]] = {}

    def feed(self, messages: TopicMessages) -> None:
        """Decode some messages."""
        for start, stop in zip(messages.start.tolist(), messages.stop.tolist(), strict=True):
            try:
                message = message_class(SCHEMA).FromString(messages.chunk[start:stop])
            except DecodeError as error:
                raise ValueError(str(error)) from error
            offset = np.array(message.offset, np.int64)
            self._stamps.append(message.timestamp.ToNanoseconds() + offset)
            for drawn in message.drawn:
                whole = np.frombuffer(drawn.deviation, _KIND).reshape(len(offset), message.motions, 3)
                values = np.where(whole == _NOTHING, np.nan, whole * drawn.scale).astype(np.float32)
                self._parts.setdefault(drawn.name, []).append(values)

    def draws(self, seed: int, origin: int) -> Draws:
        """All of them.

        Parameters
        ----------
        seed : int
            As the metadata has it.
        origin : int, ns
            Of the recording.
        """
        stamp = np.concatenate(self._stamps)
        columns = {name: np.moveaxis(np.concatenate(parts), 0, 1) for name, parts in self._parts.items()}
        if any(values.shape[1] != len(stamp) for values in columns.values()):
            raise ValueError("drawn motions lack a quantity at some times")
        return Draws(
            t_s=seconds(stamp, origin),
            seed=seed,
            position=columns["position"],
            rotation=columns["rotation"],
            joints={
                name.removeprefix(_JOINT): values
                for name, values in columns.items()
                if name.startswith(_JOINT)
            },
            upper_rotation=columns.get("upper_rotation"),
        )
