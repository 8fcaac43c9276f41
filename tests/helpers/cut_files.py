"""Recordings that were cut off."""

from __future__ import annotations

import struct
from pathlib import Path

#: Content of the footer's record, magic, and the record that ends the data.
FOOTER, MAGIC, DATA_END = 20, 8, 13


def cut_before_the_summary(source: Path, target: Path) -> None:
    """A copy that ends where the data do: every message is there, but the file says that it was cut off."""
    whole = source.read_bytes()
    (summary,) = struct.unpack_from("<Q", whole, len(whole) - FOOTER - MAGIC)
    target.write_bytes(whole[: summary - DATA_END])
