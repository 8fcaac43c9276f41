"""Residuals of the camera's joints as messages: each joint's, and why its sample was rejected."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from ...recording import JOINTS
from ...result import FrameResiduals
from ..wire import protobuf_encode as wire


class ResidualMessages:
    """What the messages of a recovery's residuals are made of; the same joints in all of them.

    Parameters
    ----------
    residuals : FrameResiduals
        All of them.
    frame_id : str
        Of the camera.
    """

    def __init__(self, residuals: FrameResiduals, frame_id: str):
        self._frame_id = frame_id
        self._joints = _present(residuals)
        self._templates: dict[tuple[int, ...], wire.Template] = {}  # by reasons

    def of_batch(self, residuals: FrameResiduals) -> Iterator[wire.AlikeRows]:
        """Frames that are written alike, the message that holds them, and its columns.

        Parameters
        ----------
        residuals : FrameResiduals
            Some of them.

        Yields
        ------
        rows : ndarray of int
            Frames of the batch.
        template : wire.Template
            What is the same in all of them.
        columns : callable
            From some of the rows to what is not.
        """

        def columns(rows: IntArray) -> dict[str, NDArray]:
            flat = residuals.residual[rows].reshape(len(rows), -1)
            return {"residual": flat, "used": residuals.used[rows].astype(np.int64)}

        for pattern, rows in wire.alike(residuals.reason):
            if pattern not in self._templates:
                reasons = [residuals.reasons[code].sentence for code in pattern]
                self._templates[pattern] = self._template(reasons)
            yield rows, self._templates[pattern], columns

    def _template(self, reasons: list[str]) -> wire.Template:
        """One message, with the reason of each joint."""
        parts = [wire.timestamp(1, "stamp"), wire.text(2, self._frame_id)]
        for i in self._joints:
            value = wire.vector(2, "residual", (3 * i, 3 * i + 1, 3 * i + 2))
            used, why = wire.flag(3, "used", i), wire.text(4, reasons[i])
            parts.append(wire.message(3, wire.text(1, JOINTS[i]), value, used, why))
        return wire.join(*parts)


def _present(residuals: FrameResiduals) -> list[int]:
    """Joints of which there is anything to say."""
    present = np.zeros(len(JOINTS), bool)
    for part in residuals.batches():
        present |= np.isfinite(part.residual).any(axis=(0, 2)) | part.used.any(axis=0)
        present |= (part.reason != 0).any(axis=0)
    return np.flatnonzero(present).tolist()
