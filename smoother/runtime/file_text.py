"""Text files as editors and shells write them: with a byte-order mark, or in UTF-16."""

from __future__ import annotations

import codecs
from pathlib import Path

#: Windows' editors begin with a mark, and PowerShell's `>` writes UTF-16. Longer marks first.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def marked_encoding(raw: bytes) -> str | None:
    """The encoding that a file's byte-order mark names; None without one."""
    return next((name for mark, name in _MARKS if raw.startswith(mark)), None)


def toml_text(path: Path) -> str:
    """The text of a TOML file without its byte-order mark, lines parted by a line feed.

    Parameters
    ----------
    path : Path
        The file: UTF-8, or what its byte-order mark says.

    Raises
    ------
    OSError
        It cannot be read.
    ValueError
        It is no text; the message says so.
    """
    raw = path.read_bytes()
    try:
        text = raw.decode(marked_encoding(raw) or "utf-8")
    except UnicodeDecodeError:
        raise ValueError("it is no UTF-8 text; save it as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")
