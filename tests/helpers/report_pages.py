"""Every page that a command writes, each from a small simulated input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from smoother.cli.run import run
from smoother.io import write_recording
from smoother.io.mcap.messages import nanoseconds
from smoother.io.recording.streams import ImuSamples, RecordingFile
from smoother.recording import ImuStream
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import SensorModel, beep, broadcast, magnetometer_turns, rest_poses


def command(*arguments: object, ends: tuple[int, ...] = (0,)) -> None:
    """Run a command of unocclude in this process."""
    assert run([str(argument) for argument in arguments]) in ends, arguments


def arm_session(folder: Path) -> Path:
    """Sixteen seconds of an arm with occlusions, its calibration and its motion capture; made once."""
    path = folder / "arm.mcap"
    if not path.exists():
        options = ("--set", "protocol=random", "--set", "duration_s=16", "--seed", 6)
        command("simulate", "arm", *options, "-o", path, "--mocap", "--calibration-out", folder / "cal.toml")
    return path


def recovered(folder: Path) -> Path:
    """What `smooth` makes of it; made once, with its page."""
    path, calibration = folder / "recovered.mcap", folder / "cal.toml"
    if not path.exists():
        session = arm_session(folder)
        page = ("--report", folder / "smooth.html", "--draws", 20)
        command("smooth", session, "-o", path, "--calibration", calibration, "--processes", 1, *page)
    return path


def smooth(folder: Path) -> Path:
    """The page of `smooth`."""
    recovered(folder)
    return folder / "smooth.html"


def validate(folder: Path) -> Path:
    """The page of `validate`."""
    page = folder / "validate.html"
    command("validate", recovered(folder), "--truth", arm_session(folder), "--report", page)
    return page


def gaps(folder: Path) -> Path:
    """The page of `gaps`."""
    page = folder / "gaps.html"
    command(
        *("gaps", arm_session(folder), "--lengths", "0.5,1", "--processes", 1, "--report", page),
        *("--calibration", folder / "cal.toml"),
    )
    return page


def compare(folder: Path) -> Path:
    """The page of `compare`."""
    page = folder / "compare.html"
    methods = ("--methods", "graph,linear-drift,pchip,hold")
    command(
        *("compare", arm_session(folder), "--calibration", folder / "cal.toml", "--processes", 1),
        *("--report", page, *methods),
    )
    return page


def panel_session(folder: Path) -> Path:
    """Three poses of a panel, as files and as a recording; made once."""
    path = folder / "panel.mcap"
    if not path.exists():
        poses = ("--set", "poses=3", "--seed", 21, "--set", "camera_tilt_deg=30", "--set", "tilt_deg=15,38")
        command("simulate", "panel", "-o", folder / "panel", "--mcap", path, *poses)
    return path


def panel(folder: Path) -> Path:
    """The page of `calibrate panel`; the camera stands still."""
    page, files = folder / "panel.html", folder / "still"
    command("simulate", "panel", "-o", files, "--set", "poses=2", "--seed", 5)
    poses = [
        part
        for number in (1, 2)
        for what, ending in (("depth", "depth.png"), ("infrared", "infrared.png"), ("markers", "markers.csv"))
        for part in (f"--{what}", files / f"pose_{number:02d}_{ending}")
    ]
    known = ("--intrinsics", files / "intrinsics.toml", "--panel", files / "panel.toml")
    command("calibrate", "panel", *poses, *known, "-o", folder / "panel_cal.toml", "--report", page)
    return page


def world(folder: Path) -> Path:
    """The page of `calibrate world`."""
    page, session = folder / "world.html", panel_session(folder)
    known = ("--panel", folder / "panel" / "panel.toml")
    command("calibrate", "world", session, *known, "-o", folder / "world_cal.toml", "--report", page)
    return page


def forearm(folder: Path) -> Path:
    """The page of `calibrate forearm`."""
    page = folder / "forearm.html"
    simulated = simulate_arm(ArmSimulation.preset("realistic", repetitions=1), 4)
    write_recording(simulated.recording, folder / "held.mcap")
    ruler = ("--radius-m", 0.035, "--strap-to-wrist-m", simulated.parameters["strap_to_wrist_m"])
    output = ("-o", folder / "forearm_cal.toml", "--report", page)
    command("calibrate", "forearm", folder / "held.mcap", *ruler, "--processes", 1, *output)
    return page


def _poses(folder: Path, name: str) -> tuple[Path, ImuStream]:
    model = SensorModel.draw(0, offset=0.5, scale=0.03, cross=0.01)
    stream, _ = rest_poses(model, 12)
    iron = SensorModel.draw(1, offset=0.5, scale=0.2, cross=0.2)
    stream = replace(stream, name=name, mag=48.0 * magnetometer_turns(iron, len(stream)))
    file = RecordingFile(folder / "poses.mcap")
    stamps = nanoseconds(stream.t_s, 0)
    file.imus.append(ImuSamples(name, name.split("/")[-1], stamps, stream.acc, stream.gyro, stream.mag))
    write_recording(file, file.path, force=True)
    return file.path, stream


def imu(folder: Path, topic: str = "/imu/forearm_right") -> Path:
    """The page of `calibrate imu`."""
    page, (path, _) = folder / "imu.html", _poses(folder, topic)
    command("calibrate", "imu", path, "-o", folder / "imu_cal.toml", "--report", page)
    return page


def magnetometer(folder: Path, topic: str = "/imu/forearm_right") -> Path:
    """The page of `calibrate magnetometer`."""
    page, (path, _) = folder / "magnetometer.html", _poses(folder, topic)
    command("calibrate", "magnetometer", path, "-o", folder / "mag_cal.toml", "--report", page)
    return page


def clock(folder: Path, node: str = "arm") -> Path:
    """The page of `calibrate clock`: a beep and a broadcast; `node` is the name of a receiver."""
    page, (sound, end, *_) = folder / "clock.html", beep(1)
    whole = (sound / np.abs(sound).max() * 30000).astype(np.int16)
    wavfile.write(folder / "beep.wav", 16000, np.stack([whole, np.zeros(len(whole), np.int16)], axis=1))
    _, heard = broadcast(2, nodes=2)
    rows = zip(heard.event.tolist(), heard.node, heard.t_s.tolist(), strict=True)
    lines = [f'{event},"{"base" if name == "n0" else node}",{t:.7f}\n' for event, name, t in rows]
    (folder / "times.csv").write_text("round,node,t_s\n" + "".join(lines), encoding="utf-8")
    times = ("--sound", folder / "beep.wav", "--event-time", end + 300.0, "--broadcast", folder / "times.csv")
    command("calibrate", "clock", *times, "-o", folder / "clock_cal.toml", "--report", page)
    return page


#: A file may be called so; a name cannot hold a slash.
HOSTILE_NAME = "<img src=x onerror=hacked=1>"


def study(folder: Path, name: str = HOSTILE_NAME) -> Path:
    """The page of `batch`: two recordings and a file that is none."""
    sessions = folder / "sessions"
    sessions.mkdir()
    settings = ArmSimulation.preset(
        "white", protocol="random", duration_s=6.0, occlusion_lengths_s=(0.8,), occlusion_every_s=4.0
    )
    for seed, stem in enumerate((name, "b")):
        write_recording(simulate_arm(settings, seed).recording, sessions / f"{stem}.mcap")
    (sessions / f"{name} broken.mcap").write_bytes(b"this is not a recording")
    out = folder / "study"
    command("batch", sessions, "-o", out, "--processes", 1, "--report", ends=(0, 1))
    return out / "report.html"


#: By the name of the command whose page it is.
PAGES: dict[str, Callable[[Path], Path]] = {
    page.__name__: page
    for page in (*(smooth, validate, gaps, compare, panel, world, forearm, imu, magnetometer, clock, study),)
}
