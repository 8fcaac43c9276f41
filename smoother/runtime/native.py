"""Files that a library in C might crash or hang on: tried first in a process of their own."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path

#: Reading takes no more time on the processor than this, s, and a second for so many bytes.
_LONGEST_S, _SLOWEST = 4, 2_000_000
#: It ends after so many times that on the wall.
_WAITING = 20
#: It takes no more memory than this, bytes, and so many times the file's size.
_MOST_MEMORY, _MEMORY_PER_BYTE = 1 << 29, 64
#: Signals that end the child that tries a file, whatever the parent has set for them.
_FATAL = ("SIGALRM", "SIGXCPU", "SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")


def crashes_in_subprocess(path: Path, read: Callable[[Path], object]) -> bool:
    """Whether reading a file would end the process, or never end itself: tried in a child (no Windows).

    The child has so much time and memory as a file of this size can need.

    Parameters
    ----------
    path : Path
        The file.
    read : callable
        Reads it by the library; the library is imported already. Whatever it raises is no crash, unless it
        is that memory does not suffice.

    Returns
    -------
    bool
        It crashed, took too long, or wanted too much memory.
    """
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
            os.close(2)  # what the library says while it crashes is no message
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
    """Limit this process to what reading so many bytes can need."""
    import resource
    import signal

    statm = Path("/proc/self/statm")
    pages = int(statm.read_text().split()[0]) if statm.exists() else 1 << 19
    memory = pages * resource.getpagesize() + _MOST_MEMORY + _MEMORY_PER_BYTE * size
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    seconds = _LONGEST_S + size // _SLOWEST
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    signal.alarm(_WAITING * seconds)
