"""What memory the system allows this process."""

from __future__ import annotations

import sys

from ..errors import UnoccludeError

#: Libraries and their threads take about so much, bytes; with less they end the process, or never answer.
LEAST_BYTES = 300 << 20


def check_allowance(least_bytes: int = LEAST_BYTES) -> None:
    """Refuse where this process may use less memory than its work needs before it has read anything.

    Parameters
    ----------
    least_bytes : int
        What it needs.

    Raises
    ------
    UnoccludeError
        As `ulimit -d` limits it.
    """
    if sys.platform != "linux":
        return
    import resource

    allowed, _ = resource.getrlimit(resource.RLIMIT_DATA)
    if allowed != resource.RLIM_INFINITY and allowed < least_bytes:
        raise UnoccludeError(
            f"memory is limited to {allowed >> 20} MB a process here (ulimit -d); this needs"
            f" {least_bytes >> 20} MB: raise the limit."
        )
