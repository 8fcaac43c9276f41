"""An outlet that comes back under another source_id, then with another unit; prints what the inlet says."""

from __future__ import annotations

import gc
import json
import sys
import time

import pylsl

from smoother.errors import UnoccludeError
from smoother.streams.lsl import LslInlet

#: Nothing is waited for longer, s.
PATIENCE_S = 25.0


def outlet(source_id: str, unit: str) -> pylsl.StreamOutlet:
    info = pylsl.StreamInfo("wrist", "IMU", 6, 100, "double64", source_id)
    channels = info.desc().append_child("channels")
    for kind, kind_unit in (("acc", unit), ("gyro", "rad/s")):
        for axis in "xyz":
            channel = channels.append_child("channel")
            channel.append_child_value("label", f"{kind}_{axis}")
            channel.append_child_value("unit", kind_unit)
    return pylsl.StreamOutlet(info)


def sent_until_received(inlet: LslInlet, sender: pylsl.StreamOutlet) -> int:
    """Send until something comes; how many samples came."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        sender.push_sample([0.0] * 6)
        got = sum(len(batch.t_s) for batch in inlet.samples())
        if got:
            return got
        time.sleep(0.02)
    return 0


def main() -> None:
    said = {}
    inlet = LslInlet("wrist", ("imu",), lambda: None)
    inlet.start()
    try:
        sender = outlet("first", "m/s^2")
        said["first"] = sent_until_received(inlet, sender)
        del sender
        gc.collect()
        sender = outlet("second", "m/s^2")
        said["second"] = sent_until_received(inlet, sender)
        said["events"] = inlet.events()
        until = time.monotonic() + PATIENCE_S
        while not said["events"] and time.monotonic() < until:  # what the first one had sent came late
            said["second"] = sent_until_received(inlet, sender)
            said["events"] = inlet.events()
        del sender
        gc.collect()
        sender = outlet("second", "g")
        try:
            said["third"] = sent_until_received(inlet, sender)
        except UnoccludeError as error:
            said["refused"] = str(error)
    finally:
        inlet.close()
    print(json.dumps(said))


if __name__ == "__main__":
    sys.exit(main())
