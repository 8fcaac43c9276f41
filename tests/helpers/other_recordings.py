"""Recordings as other programs write them: read by the importer that must know them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from smoother.io.devices.registry import recognise
from smoother.io.tables.protocol import ImuTable, SkeletonTable, read_head


def read(path: Path, key: str) -> tuple[list[SkeletonTable], list[ImuTable]]:
    importer = recognise(read_head(path))
    assert importer is not None
    assert (importer.key, importer.kind) == (key, "recording")
    tables = importer.read(path)
    skeletons = [table for table in tables if isinstance(table, SkeletonTable)]
    return skeletons, [table for table in tables if isinstance(table, ImuTable)]


def turning(count: int, rate_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, specific force and angular velocity of a sensor that turns about a level axis."""
    t = np.arange(count) / rate_hz
    angle, rate = 0.8 * np.sin(2 * t), 1.6 * np.cos(2 * t)
    acc = 9.81 * np.stack([np.sin(angle), np.cos(angle), 0 * t], axis=1)
    return t, acc, np.stack([0 * t, 0 * t, rate], axis=1)
