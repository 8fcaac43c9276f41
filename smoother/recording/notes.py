"""Notes of a recording: those that its import said are not said again by every command."""

from __future__ import annotations


class ImportNote(str):
    """A note that stands in a recording's file: its import said it, `unocclude info` repeats it."""

    __slots__ = ()
