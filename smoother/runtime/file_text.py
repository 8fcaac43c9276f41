"""Text files as editors and shells write them: with a byte-order mark, or in UTF-16."""

from __future__ import annotations

import codecs
import re
import tomllib
from pathlib import Path
from typing import Any

#: Windows' editors begin with a mark, and PowerShell's `>` writes UTF-16. Longer marks first.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


#: No table of settings is longer, bytes; the longest calibrations have some ten thousand.
MOST_TOML = 1 << 20
#: Nor deeper, in tables within tables; the deepest of ours is an arm's lever arm with four.
MOST_DEEP = 32

_PART = r"""(?:[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+"""
#: A key of more parts than that, where a key may begin; `tomllib` takes a time that grows with their square.
_DEEP_KEY = re.compile(rf"(?:^|[\[{{,])[ \t\[]*+{_PART}(?:\.[ \t]*+{_PART}){{{MOST_DEEP}}}", re.MULTILINE)


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
        It is no text, or longer than any table of settings; the message says so.
    """
    with open(path, "rb") as file:
        raw = file.read(MOST_TOML + 1)
    if len(raw) > MOST_TOML:
        raise ValueError("it is longer than 1 MB, which no file of settings is")
    try:
        text = raw.decode(marked_encoding(raw) or "utf-8")
    except UnicodeDecodeError:
        raise ValueError("it is no UTF-8 text; save it as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: Path) -> dict[str, Any]:
    """What a TOML file holds, as plain values.

    Parameters
    ----------
    path : Path
        The file, as of `toml_text`.

    Raises
    ------
    OSError
        It cannot be read.
    ValueError
        It is no TOML, longer than 1 MB, or has tables within tables beyond `MOST_DEEP`; the message says so.
    """
    text = toml_text(path)
    too_deep = ValueError(f"it has tables within tables, {MOST_DEEP} and more, which no file of settings has")
    if _DEEP_KEY.search(text):
        raise too_deep
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise too_deep from None
    level: list[Any] = [document]
    for _ in range(MOST_DEEP):
        inner = [each.values() if isinstance(each, dict) else each for each in level]
        level = [value for values in inner for value in values if isinstance(value, dict | list)]
        if not level:
            return document
    raise too_deep
