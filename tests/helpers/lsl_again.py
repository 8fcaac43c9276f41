"""An outlet that comes back under another source_id, then with another unit; prints what the inlet says.

Outlets are programs of their own and are killed, like a sensor whose battery is empty: destroying an outlet
crashes liblsl 1.18 now and then.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from lsl_lab import imu_outlet

from smoother.errors import UnoccludeError
from smoother.streams.lsl import LslInlet

#: Nothing is waited for longer, s.
PATIENCE_S = 25.0


def send(source_id: str, unit: str) -> None:
    """Send for ever."""
    outlet = imu_outlet("wrist", unit=unit, source_id=source_id)
    while True:
        outlet.push_sample([0.0] * 6)
        time.sleep(0.02)


@contextmanager
def sent(source_id: str, unit: str) -> Iterator[None]:
    """A program that sends meanwhile."""
    program = subprocess.Popen([sys.executable, __file__, source_id, unit])
    try:
        yield
    finally:
        program.kill()
        program.wait()


def received(inlet: LslInlet) -> int:
    """How many samples came, once some did."""
    until = time.monotonic() + PATIENCE_S
    got = 0
    while not got and time.monotonic() < until:
        got = len(inlet.samples())
        time.sleep(0.02)
    return got


def main() -> None:
    said = {}
    inlet = LslInlet("--imu ", "wrist", ("imu",), lambda: None)
    inlet.start()
    try:
        with sent("first", "m/s^2"):
            said["first"] = received(inlet)
        with sent("second", "m/s^2"):
            until = time.monotonic() + PATIENCE_S
            said["second"] = received(inlet)
            said["events"] = inlet.events()
            while not said["events"] and time.monotonic() < until:  # what the first one had sent came late
                said["second"] = received(inlet)
                said["events"] = inlet.events()
        with sent("second", "g"):
            until = time.monotonic() + PATIENCE_S
            while time.monotonic() < until:  # here, too
                said["third"] = received(inlet)
    except UnoccludeError as error:
        said["refused"] = str(error)
    finally:
        inlet.close()
    print(json.dumps(said))


if __name__ == "__main__":
    sys.exit(send(*sys.argv[1:]) if sys.argv[1:] else main())
