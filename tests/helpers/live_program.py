"""`unocclude` as a program of its own; with `--echo` first, a stand-in answers for the live smoother."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    # ignored where a shell runs the tests in the background: the child inherits that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    arguments = sys.argv[1:]
    if arguments[:1] == ["--echo"]:
        from live_engine import CameraEcho

        import smoother.live.smoother

        smoother.live.smoother.LiveSmoother = CameraEcho  # type: ignore[misc]
        arguments = arguments[1:]
    from smoother.cli.run import run

    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
