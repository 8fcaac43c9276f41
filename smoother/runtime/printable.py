"""Text from files as a terminal may show it."""

from __future__ import annotations

import unicodedata

#: Categories of Unicode that are not shown but act: controls, directions of writing, halves of pairs.
_ACTING = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def printable(text: str, lines: bool = False) -> str:
    """A text whose control characters are written out (escape as x1b behind a backslash).

    Parameters
    ----------
    text : str
        May hold names of topics, files and joints that a stranger chose.
    lines : bool
        Keep line breaks and tabs.
    """
    if text.isascii() and text.isprintable():
        return text
    kept = "\n\t" if lines else ""
    return "".join(
        character
        if character in kept or unicodedata.category(character) not in _ACTING
        else _escaped(character)
        for character in text
    )


def _escaped(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file's name that is no UTF-8
        return f"\\x{code - 0xDC00:02x}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
