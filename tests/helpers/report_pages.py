"""Every page that a command writes, each from a small simulated input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from made_measures import made_measure, made_measures, person
from scipy.io import wavfile

from smoother.cli.run import run
from smoother.io import write_recording
from smoother.io.mcap.messages import nanoseconds
from smoother.io.recording.streams import ImuSamples, RecordingFile
from smoother.measures import BothArms
from smoother.measures.symmetry import COMPARED
from smoother.report.pages import measures_page, progress_page
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import SensorModel, beep, broadcast, magnetometer_turns, rest_poses

#: A file may be called so; a name cannot hold a slash.
HOSTILE_NAME = "<img src=x onerror=hacked=1>"


def command(*arguments: object, ends: tuple[int, ...] = (0,)) -> None:
    """Run a command of unocclude in this process."""
    assert run([str(argument) for argument in arguments]) in ends, arguments


def paged(folder: Path, name: str, *words: object) -> Path:
    """The page of a command."""
    command(*words, "--report", folder / f"{name}.html")
    return folder / f"{name}.html"


def calibrated(folder: Path, name: str, *words: object) -> Path:
    """The page of a calibration."""
    return paged(folder, name, "calibrate", name, *words, "-o", folder / f"{name}_cal.toml")


def arm_session(folder: Path) -> Path:
    """Sixteen seconds of an arm with occlusions, its calibration and its motion capture; made once."""
    path = folder / "arm.mcap"
    if not path.exists():
        options = ("--set", "protocol=random", "--set", "duration_s=16", "--seed", 6)
        command("simulate", "arm", *options, "-o", path, "--mocap", "--calibration-out", folder / "cal.toml")
    return path


def smooth(folder: Path) -> Path:
    """With what `smooth` makes of the session; made once."""
    if (folder / "smooth.html").exists():
        return folder / "smooth.html"
    known = ("--calibration", folder / "cal.toml", "--processes", 1, "--draws", 20)
    return paged(folder, "smooth", "smooth", arm_session(folder), "-o", folder / "recovered.mcap", *known)


def validate(folder: Path) -> Path:
    smooth(folder)
    return paged(folder, "validate", "validate", folder / "recovered.mcap", "--truth", arm_session(folder))


def gaps(folder: Path) -> Path:
    known = ("--calibration", folder / "cal.toml", "--processes", 1)
    return paged(folder, "gaps", "gaps", arm_session(folder), "--lengths", "0.5,1", *known)


def compare(folder: Path) -> Path:
    known = ("--calibration", folder / "cal.toml", "--processes", 1)
    methods = ("--methods", "graph,linear-drift,pchip,hold")
    return paged(folder, "compare", "compare", arm_session(folder), *known, *methods)


def panel(folder: Path) -> Path:
    """The camera stands still."""
    files = folder / "still"
    command("simulate", "panel", "-o", files, "--set", "poses=2", "--seed", 5)
    poses = [
        part
        for number in (1, 2)
        for what, ending in (("depth", "depth.png"), ("infrared", "infrared.png"), ("markers", "markers.csv"))
        for part in (f"--{what}", files / f"pose_{number:02d}_{ending}")
    ]
    known = ("--intrinsics", files / "intrinsics.toml", "--panel", files / "panel.toml")
    return calibrated(folder, "panel", *poses, *known)


def world(folder: Path) -> Path:
    """Three poses of a panel, the camera tilted anew for each."""
    poses = ("--set", "poses=3", "--seed", 21, "--set", "camera_tilt_deg=30", "--set", "tilt_deg=15,38")
    command("simulate", "panel", "-o", folder / "panel", "--mcap", folder / "panel.mcap", *poses)
    return calibrated(folder, "world", folder / "panel.mcap", "--panel", folder / "panel" / "panel.toml")


def forearm(folder: Path) -> Path:
    simulated = simulate_arm(ArmSimulation.preset("realistic", repetitions=1), 4)
    write_recording(simulated.recording, folder / "held.mcap")
    ruler = ("--radius-m", 0.035, "--strap-to-wrist-m", simulated.parameters["strap_to_wrist_m"])
    return calibrated(folder, "forearm", folder / "held.mcap", *ruler, "--processes", 1)


def poses(folder: Path, name: str) -> Path:
    """A sensor in rest poses, with a magnetometer."""
    model = SensorModel.draw(0, offset=0.5, scale=0.03, cross=0.01)
    stream, _ = rest_poses(model, 12)
    iron = SensorModel.draw(1, offset=0.5, scale=0.2, cross=0.2)
    stream = replace(stream, mag=48.0 * magnetometer_turns(iron, len(stream)))
    file = RecordingFile(folder / "poses.mcap")
    stamps = nanoseconds(stream.t_s, 0)
    file.imus.append(ImuSamples(name, name.split("/")[-1], stamps, stream.acc, stream.gyro, stream.mag))
    write_recording(file, file.path, force=True)
    return file.path


def imu(folder: Path, topic: str = "/imu/forearm_right") -> Path:
    return calibrated(folder, "imu", poses(folder, topic))


def magnetometer(folder: Path, topic: str = "/imu/forearm_right") -> Path:
    return calibrated(folder, "magnetometer", poses(folder, topic))


def clock(folder: Path, node: str = "arm") -> Path:
    """A beep and a broadcast; `node` is the name of a receiver."""
    sound, end, *_ = beep(1)
    whole = (sound / np.abs(sound).max() * 30000).astype(np.int16)
    wavfile.write(folder / "beep.wav", 16000, np.stack([whole, np.zeros(len(whole), np.int16)], axis=1))
    _, heard = broadcast(2, nodes=2)
    rows = zip(heard.event.tolist(), heard.node, heard.t_s.tolist(), strict=True)
    lines = [f'{event},"{"base" if name == "n0" else node}",{t:.7f}\n' for event, name, t in rows]
    (folder / "times.csv").write_text("round,node,t_s\n" + "".join(lines), encoding="utf-8")
    times = ("--event-time", end + 300.0, "--broadcast", folder / "times.csv")
    return calibrated(folder, "clock", "--sound", folder / "beep.wav", *times)


def study(folder: Path, name: str = HOSTILE_NAME) -> Path:
    """Two recordings and a file that is none."""
    sessions = folder / "sessions"
    sessions.mkdir()
    gap = {"occlusion_lengths_s": (0.8,), "occlusion_every_s": 4.0}
    settings = ArmSimulation.preset("white", protocol="random", duration_s=6.0, **gap)
    for seed, stem in enumerate((name, "b")):
        write_recording(simulate_arm(settings, seed).recording, sessions / f"{stem}.mcap")
    (sessions / f"{name} broken.mcap").write_bytes(b"this is not a recording")
    command("batch", sessions, "-o", folder / "study", "--processes", 1, "--report", ends=(0, 1))
    return folder / "study" / "report.html"


#: What people and devices call something, as long as a line.
LONG_NAME = f"{HOSTILE_NAME} that takes a whole line of the page to say"


def measures(folder: Path) -> Path:
    """Both arms with many movements and notes."""
    notes = tuple(f"{LONG_NAME}, number {n}" for n in range(9))
    about = {"movements": 40, "notes": notes, "name": LONG_NAME, "verdict": LONG_NAME}
    left, right = (made_measures(side, **about) for side in ("left", "right"))
    compared = (key for key in COMPARED if key in left.by_key)
    symmetry = tuple(made_measure(f"{key}_symmetry_percent", -100.4, 12.2) for key in compared)
    measures_page([left, right], [BothArms(left, right, symmetry)]).write(folder / "measures.html")
    return folder / "measures.html"


def progress(folder: Path) -> Path:
    """Forty sessions of both arms."""
    whole = person(40, ("left", "right"), LONG_NAME)
    series = tuple(replace(each, task=HOSTILE_NAME) for each in whole.series)
    notes = tuple(f"{LONG_NAME}, number {n}" for n in range(9))
    told = replace(whole, series=series, left_out=(HOSTILE_NAME,), notes=notes)
    progress_page(told).write(folder / "progress.html")
    return folder / "progress.html"


#: By the name of the command whose page it is.
PAGES: dict[str, Callable[[Path], Path]] = {
    page.__name__: page
    for page in (
        *(smooth, validate, gaps, compare, panel, world, forearm, imu, magnetometer, clock, study),
        *(measures, progress),
    )
}
