"""A lab's network on this computer, for tests: each function is run as a program of its own.

python -c "import lsl_lab; lsl_lab.play('REC.mcap', 'wrist', 'kinect')"
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count, product
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

import numpy as np

#: A stream is looked for so long: a machine with other work to do may need a while, s.
PATIENCE_S = 30.0
JOINTS = ("shoulder", "elbow", "wrist", "hand", "strap")


def program_of(function: str, *given: object, **options: object) -> list[str]:
    """The command that runs a function of this file."""
    words = [*map(repr, given), *(f"{name}={value!r}" for name, value in options.items())]
    return [sys.executable, "-c", f"import lsl_lab; lsl_lab.{function}({', '.join(words)})"]


def config(folder: Path, session: str) -> Path:
    """Settings by which only programs of one test, on this computer, see each other."""
    file = folder / "lsl_api.cfg"
    file.write_text(f"[lab]\nSessionID = {session}\n[multicast]\nResolveScope = machine\n[log]\nlevel = -3\n")
    return file


def imu_outlet(name: str, bare: bool = False, unit: str = "m/s^2", source_id: str = "", kind: str = "IMU"):
    import pylsl

    sensors = [s for s in (("acc", unit), ("gyro", "rad/s")) if kind in ("IMU", s[0].upper())]
    info = pylsl.StreamInfo(name, kind, 3 * len(sensors), 100, "double64", source_id or f"id-{name}")
    if not bare:
        channels = info.desc().append_child("channels")
        for label, axis_unit in sensors:
            for axis in "xyz":
                channel = channels.append_child("channel")
                channel.append_child_value("label", f"{label}_{axis}")
                channel.append_child_value("unit", axis_unit)
    return pylsl.StreamOutlet(info)


class Halves:
    """Accelerometer and gyroscope as a headband sends them: streams of one name and two types."""

    def __init__(self, name: str):
        self.acc, self.gyro = (imu_outlet(name, kind=kind) for kind in ("ACC", "GYRO"))

    def push_sample(self, row: list[float], stamp_s: float) -> None:
        self.acc.push_sample(row[:3], stamp_s - 0.005)
        self.gyro.push_sample(row[3:], stamp_s)


def skeleton_outlet(name: str, *sides: str, unit: str = "meters"):
    import pylsl

    sides = sides or ("right",)
    info = pylsl.StreamInfo(name, "MoCap", 12 * len(sides), pylsl.IRREGULAR_RATE, "double64", f"id-{name}")
    channels = info.desc().append_child("channels")
    kinds = (*((f"Position{axis}", unit) for axis in "XYZ"), ("Confidence", "normalized"))
    for side, joint in product(sides, JOINTS[:3]):
        for kind, kind_unit in kinds:
            channel = channels.append_child("channel")
            channel.append_child_value("label", f"{joint}_{side}_{kind}")
            channel.append_child_value("marker", f"{joint}_{side}")
            channel.append_child_value("type", kind)
            channel.append_child_value("unit", kind_unit)
    return pylsl.StreamOutlet(info)


def events_of(path: Path, late_s: float, sides: tuple[str, ...] = ()):
    """When each sample and frame arrives, which it is, its stamp and its values."""
    from smoother.io import read_recording

    arms = [read_recording(path, side=side) for side in sides] if sides else [read_recording(path)]
    imus = {"imu": arms[0].imu} if not sides else {arm.side: arm.imu for arm in arms}
    imus |= {f"{arm.side}_{name}": imu for arm in arms for name, imu in arm.further_imus.items()}
    samples = []
    for kind, imu in imus.items():
        values = np.hstack([imu.acc, imu.gyro])
        samples += [(t, kind, t, row) for t, row in zip(imu.t_s.tolist(), values.tolist(), strict=True)]
    frames = []
    for k, t in enumerate(arms[0].arm.t_s.tolist()):
        row = []
        for arm, joint in product(arms, range(3)):
            state = int(arm.arm.state[k, joint])
            row += [*arm.arm.position[k, joint].tolist(), {0: 0.0, 1: 0.3, 2: 1.0}[state]]
        frames.append((t + late_s, "skeleton", t, row))
    return sorted([*samples, *frames], key=lambda event: event[0])


def play(
    path: str,
    imu: str,
    skeleton: str,
    late_s: float = 0.1,
    bare: bool = False,
    halves: bool = False,
    both: bool = False,
) -> None:
    """The recording again and again from the line `go` on, until stdin ends.

    A line KIND SECONDS takes an outlet away for a time.
    """
    import pylsl

    sides = ("right", "left") if both else ()
    events = events_of(Path(path), late_s, sides)
    make = {
        "imu": lambda: Halves(imu) if halves else imu_outlet(imu, bare),
        "skeleton": lambda: skeleton_outlet(skeleton, *sides),
    }
    if sides:
        kinds = {kind for _, kind, *_ in events} - {"skeleton"}
        make = {"skeleton": make["skeleton"]}
        make |= {kind: lambda kind=kind: imu_outlet(f"{imu}_{kind}") for kind in sorted(kinds)}  # type: ignore[misc]
    outlets = {kind: outlet() for kind, outlet in make.items()}
    back_at: dict[str, float] = {}
    commands: SimpleQueue[str] = SimpleQueue()
    Thread(target=lambda: [*map(commands.put, sys.stdin), commands.put("")], daemon=True).start()
    print("ready", flush=True)
    if commands.get() != "go\n":
        return
    begin, lasts = pylsl.local_clock() - events[0][0] + 0.2, events[-1][0] - events[0][0] + 0.01
    for turn in count():
        for arrival, kind, t, row in events:
            time.sleep(max(begin + turn * lasts + arrival - pylsl.local_clock(), 0.0))
            while not commands.empty():
                line = commands.get()
                if not line:
                    return
                gone, seconds = line.split()
                outlets.pop(gone)
                back_at[gone] = pylsl.local_clock() + float(seconds)
            if kind in back_at and pylsl.local_clock() > back_at[kind]:
                del back_at[kind]
                outlets[kind] = make[kind]()
            if kind in outlets:
                outlets[kind].push_sample(row, begin + turn * lasts + t)


def read(name: str, seconds: float, least: int = 0) -> None:
    """Print what a stream says of itself, and all that it sent; on until there are so many samples."""
    import pylsl

    found = pylsl.resolve_byprop("name", name, 1, PATIENCE_S)
    if not found:
        sys.exit(f"no stream {name}")
    inlet = pylsl.StreamInlet(found[0])
    info = inlet.info(PATIENCE_S)
    labels, channel = [], info.desc().child("channels").child("channel")
    for _ in range(info.channel_count()):
        labels.append([channel.child_value(key) for key in ("label", "type", "unit")])
        channel = channel.next_sibling("channel")
    samples, stamps, ages = [], [], []
    began = time.monotonic()
    while (after := time.monotonic() - began) < seconds or (len(samples) < least and after < PATIENCE_S):
        values, t_s = inlet.pull_chunk(timeout=0.2, min_samples=1, as_numpy=True)
        now = pylsl.local_clock()
        samples += np.asarray(values).tolist()
        stamps += t_s.tolist()
        ages += (now - t_s).tolist()
    print(
        json.dumps({"type": info.type(), "labels": labels, "t_s": stamps, "ages": ages, "samples": samples})
    )


def send(source_id: str, unit: str) -> None:
    """Send for ever."""
    outlet = imu_outlet("wrist", unit=unit, source_id=source_id)
    while True:
        outlet.push_sample([0.0] * 6)
        time.sleep(0.02)


@contextmanager
def sent(source_id: str, unit: str) -> Iterator[None]:
    """A program that sends meanwhile, and is killed, like a sensor whose battery is empty.

    Destroying an outlet crashes liblsl 1.18 now and then.
    """
    program = subprocess.Popen(program_of("send", source_id, unit))
    try:
        yield
    finally:
        program.kill()
        program.wait()


def again() -> None:
    """Print what an inlet says of an outlet that comes back, then with another unit."""
    import pylsl

    from smoother.errors import UnoccludeError
    from smoother.streams.lsl import LslInlet

    said, inlet, resolver = {}, LslInlet("--imu ", "wrist", ("imu",)), pylsl.ContinuousResolver()

    def received(key: str, is_enough: Callable[[], object]) -> None:
        """How many samples came at last, once it is enough."""
        until = time.monotonic() + PATIENCE_S
        said[key] = 0
        while not is_enough() and time.monotonic() < until:
            if not inlet.is_open:
                inlet.connect(resolver.results())
            said[key] = len(inlet.samples())
            time.sleep(0.02)

    try:
        with sent("first", "m/s^2"):
            received("first", lambda: said["first"])
        with sent("second", "m/s^2"):
            events = said["events"] = []  # what the first one had sent came late
            received("second", lambda: events.extend(inlet.events()) or (said["second"] and events))
        with sent("second", "g"):
            received("third", lambda: False)
    except UnoccludeError as error:
        said["refused"] = str(error)
    print(json.dumps(said))


def live(*arguments: str, echo: bool = False) -> None:
    """`unocclude`; or a stand-in answers for the live smoother."""
    # ignored where a shell runs the tests in the background: the child inherits that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if echo:
        from live_engine import CameraEcho

        import smoother.live.smoother

        smoother.live.smoother.LiveSmoother = CameraEcho  # type: ignore[misc]
    from smoother.cli.run import run

    sys.exit(run(["live", *arguments]))
