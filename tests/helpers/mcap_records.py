"""Records of an MCAP file by their place, to damage them."""

from __future__ import annotations

from smoother.io.mcap.container import HEAD, MAGIC


def places(data: bytes, opcode: int) -> list[int]:
    """Where records of a kind begin at the top level."""
    positions, position = [], len(MAGIC)
    while position + HEAD.size <= len(data) - len(MAGIC):
        kind, length = HEAD.unpack_from(data, position)
        positions += [position] * (kind == opcode)
        position += HEAD.size + length
    return positions


def put(data: bytes, at: int, value: bytes) -> bytes:
    """A file with other bytes from a position on."""
    return data[:at] + value + data[at + len(value) :]
