"""Inputs: files and no pipes, text in the encodings of editors, files that a library in C may crash on."""

from __future__ import annotations

import codecs
import os
import re
import stat
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError


def check_input(path: str | os.PathLike[str], error: type[UnoccludeError] = UnoccludeError) -> None:
    """Refuse what is there and is neither a file nor a folder, and a link that leads to nothing."""
    try:
        mode = os.stat(path).st_mode
    except OSError as reason:
        if os.path.islink(path):
            leads = os.readlink(path)
            raise error(
                f"{path} is a link to {leads}, which cannot be read; name the file itself."
            ) from reason
        return
    except ValueError:
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise error(f"{path} is a pipe, a socket or a device; save what it gives as a file first.")


def inside(folder: str | os.PathLike[str], name: str) -> Path | None:
    """The file of a folder that a text in that folder names; None where it leads out of it, by a link too."""
    path = Path(folder) / name
    try:
        real = Path(os.path.realpath(path))
    except ValueError:  # a NUL in the name
        return None
    return path if real.is_relative_to(os.path.realpath(folder)) else None


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
    """The text of a TOML file without its byte-order mark, lines parted by a line feed."""
    with open(path, "rb") as file:
        raw = file.read(MOST_TOML + 1)
    if len(raw) > MOST_TOML:
        raise ValueError("it is longer than 1 MB, which no file of settings is")
    try:
        text = raw.decode(marked_encoding(raw) or "utf-8")
    except UnicodeDecodeError:
        raise ValueError("it is not UTF-8 text; save it as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: Path) -> dict[str, Any]:
    """What a TOML file contains, as plain values."""
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


#: Reading takes no more time on the processor than this, s, and a second for this many bytes.
_LONGEST_S, _SLOWEST = 4, 2_000_000
#: It ends after this many times that on the wall.
_WAITING = 20
#: It takes no more memory than this, bytes, and this many times the file's size.
_MOST_MEMORY, _MEMORY_PER_BYTE = 1 << 29, 64
#: Signals that end the child that tries a file, whatever the parent has set for them.
_FATAL = ("SIGALRM", "SIGXCPU", "SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")


def crashes_in_subprocess(path: Path, read: Callable[[Path], object]) -> bool:
    """Whether reading a file would end the process, or never end itself: tried in a child (no Windows)."""
    import faulthandler
    import signal

    if not hasattr(os, "fork"):
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child only reads and ends
        child = os.fork()
    if child == 0:
        code = 1
        try:
            faulthandler.disable()
            for name in _FATAL:
                signal.signal(getattr(signal, name), signal.SIG_DFL)
            os.close(2)  # what the library says while it crashes is not a message
            _limit(path.stat().st_size)
            read(path)
            code = 0
        except MemoryError:
            pass
        except BaseException as error:
            code = int("bad_alloc" in str(error))
        finally:  # also where memory does not suffice for that: a copy of this program must not go on
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    return os.WIFSIGNALED(status) or os.waitstatus_to_exitcode(status) != 0


def _limit(size: int) -> None:
    """Limit this process to what reading this many bytes can need."""
    import resource
    import signal

    statm = Path("/proc/self/statm")
    pages = int(statm.read_text().split()[0]) if statm.exists() else 1 << 19
    memory = pages * resource.getpagesize() + _MOST_MEMORY + _MEMORY_PER_BYTE * size
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    seconds = _LONGEST_S + size // _SLOWEST
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    signal.alarm(_WAITING * seconds)
