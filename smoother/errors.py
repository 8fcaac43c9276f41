"""Errors whose text is one sentence for the user: what is wrong, where, and what to do."""

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
