"""Errors whose text is one sentence for the user: what is wrong, where, and what to do."""


class UnoccludeError(Exception):
    """Something the user can mend; the command line prints its text and exits with 1."""


class RecordingError(UnoccludeError):
    """A recording, or a file of one, that cannot be used as it is."""


class CalibrationError(UnoccludeError):
    """A calibration that cannot be used, or that the data do not determine."""


class SolveError(UnoccludeError):
    """The motion could not be solved from what the recording holds."""
