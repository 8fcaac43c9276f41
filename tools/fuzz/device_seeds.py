"""The smallest files of every device, by the importer's key."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))

import device_files
import skeleton_files
from library_files import write_bag, write_opal

from smoother.io.devices.registry import formats
from smoother.io.tables.joint_columns import BLAZEPOSE

#: Text is cut to so many lines: that is enough to be recognised, and read in a tenth of the time.
_LINES = 24


def device_seeds() -> dict[str, list[bytes]]:
    """Files by importer; an importer whose library is absent has none."""
    makers = {
        **device_files.EXAMPLES,
        "rosbag1": lambda path: write_bag(path, samples=4, frames=2),
        "apdm-hdf5": lambda path: write_opal(path, count=12),
        "pose-json": _landmarks,
    }
    seeds: dict[str, list[bytes]] = {}
    with tempfile.TemporaryDirectory() as name:
        for importer in formats():
            path = Path(name) / importer.key
            try:
                makers[importer.key](path)
            except ImportError:
                seeds[importer.key] = [b"\0"]
                continue
            data = path.read_bytes()
            lines = data.split(b"\n")
            is_table = len(lines) > _LINES and b"\0" not in data
            seeds[importer.key] = [b"\n".join(lines[:_LINES]) + b"\n" if is_table else data]
    return seeds


def _landmarks(path: Path) -> None:
    """Landmarks of MediaPipe as a program of one's own writes them."""
    rows = [
        [{"x": x, "y": y, "z": z, "visibility": 0.9} for x, y, z in frame]
        for frame in skeleton_files.landmarks(4).tolist()
    ]
    assert len(rows[0]) == len(BLAZEPOSE)
    frames = [{"timestamp_ms": 40 * at, "world_landmarks": row} for at, row in enumerate(rows)]
    path.write_text(json.dumps({"frames": frames}), encoding="utf-8")
