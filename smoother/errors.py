"""Errors whose text is one sentence for the user: what is wrong, where, and what to do."""

import errno
import os

#: Set to 1 to see where an error comes from.
DEBUG = "UNOCCLUDE_DEBUG"


def debugging() -> bool:
    """Whether tracebacks are wanted."""
    return os.environ.get(DEBUG, "") not in ("", "0")


def is_out_of_memory(error: BaseException) -> bool:
    """Whether the memory did not suffice; for a thread's stack Python has no error of its own."""
    return isinstance(error, MemoryError) or "can't start new thread" in str(error)


class UnoccludeError(Exception):
    """Something the user can correct; the command line prints its text and exits with 1."""


class RecordingError(UnoccludeError):
    """A recording, or a file of one, that cannot be used as it is."""


class CalibrationError(UnoccludeError):
    """A calibration that cannot be used, or that the data do not determine."""


class SolveError(UnoccludeError):
    """The motion could not be solved from what the recording contains."""


#: What the system says of a file, as people say it.
_OF_SYSTEM = {
    errno.ENOSPC: "no space left on the disk; make room and run again",
    errno.ENOENT: "there is no such file or folder",
    errno.EACCES: "permission denied",
    errno.EPERM: "permission denied",
}


def sentence_of(error: BaseException) -> str:
    """An error of any kind in one sentence."""
    if isinstance(error, UnoccludeError):
        text = str(error)
    elif isinstance(error, OSError) and not is_out_of_memory(error):
        where = f"{error.filename}: " if error.filename is not None else ""
        text = where + (_OF_SYSTEM.get(error.errno or 0) or error.strerror or str(error))
    elif is_out_of_memory(error):
        text = "not enough memory for this recording; cut it, or use fewer processes or a larger machine"
    else:
        kind = type(error).__name__
        text = f"an unexpected error, {kind}: {error} (set {DEBUG}=1 to see where it comes from)"
    return " ".join(text.split())
