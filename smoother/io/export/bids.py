"""Results and their recordings as a Motion-BIDS data set: the answer is a derivative of what was recorded.

Motion-BIDS: Jeung et al., Scientific Data 11:716, 2024; the rules are those of BIDS 1.10.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...linalg import median_rate_hz
from ...recording import JOINTS, CameraFrame, JointState, Recording
from ...result import Recovery
from ...runtime.outputs import writing
from .tables import file_columns, marks_of

BIDS_VERSION = "1.10.0"
#: Sessions begin here: true dates say who a person is. Streams keep their distance from each other.
_EPOCH = datetime(1900, 1, 1, tzinfo=UTC)
_TYPES = ("ACCEL", "GYRO", "MAGN", "POS", "ORNT", "VEL", "JNTANG", "LATENCY", "MISC")
#: Which way a camera's x, y and z point, as one sees who stands behind it (L, R, S, I, A, P), and in words.
_SPATIAL = {
    CameraFrame.KINECT: ("LSA", "x to the camera's left, y up, z forward"),
    CameraFrame.OPTICAL: ("RIA", "x to the camera's right, y down, z forward"),
    CameraFrame.ZUP: ("__S", "z up; the direction of x is not stated"),
}


_MARKS = {
    "occluded": "1: the camera did not see the forearm",
    "usable": "1: there is an answer that is not distrusted",
    "trusted": "1: the answer is to be trusted",
}


@dataclass(frozen=True)
class BidsNames:
    """How a recording is called in a data set."""

    subject: str  # Labels of letters and digits; `session` may be ""
    session: str = ""
    task: str = "arm"

    def __post_init__(self) -> None:
        for option, label in (("subject", self.subject), ("session", self.session), ("task", self.task)):
            if not re.fullmatch(r"[A-Za-z0-9]+", label) and (label or option != "session"):
                raise UnoccludeError(f"--{option} of BIDS is letters and digits alone, not '{label}'")

    @property
    def parts(self) -> list[str]:
        """The labels that folders and files begin with: `sub-X`, `ses-Y`."""
        return [f"sub-{self.subject}", *([f"ses-{self.session}"] if self.session else [])]

    def file(self, system: TrackingSystem, ending: str) -> Path:
        """A file of a tracking system below a data set's folder."""
        name = "_".join([*self.parts, f"task-{self.task}", f"tracksys-{system.label}", ending])
        return Path(*self.parts, "motion", name)


def label_of(name: str) -> str:
    """A label made of a file's name: its letters and digits."""
    return re.sub(r"[^A-Za-z0-9]", "", Path(name).stem) or "01"


class Channel(NamedTuple):
    """A column of a motion file, as `channels.tsv` describes it; "" is n/a."""

    name: str
    component: str
    kind: str  # Its `type`
    point: str
    units: str
    frame: str
    description: str
    values: FloatArray  # (N,): nan is n/a


@dataclass(frozen=True)
class TrackingSystem:
    """One stream with one clock."""

    label: str  # `tracksys-LABEL`
    title: str  # What it is
    t_s: FloatArray  # (N,) s
    channels: list[Channel]
    more: dict[str, object] = field(default_factory=dict)  # Further keys of `motion.json`
    frames: dict[str, dict[str, str]] = field(default_factory=dict)  # Levels of the column `reference_frame`


def recorded_systems(recording: Recording) -> list[TrackingSystem]:
    """The camera's joints and the IMUs of an arm, as they were recorded."""
    side, arm = recording.side.capitalize(), recording.arm

    def point_of(name: str) -> str:
        return f"{recording.side}_{name}" if recording.side else name

    systems = []
    for segment, imu in {"forearm": recording.imu, **recording.further_imus}.items():
        sensors = [
            ("acc", "ACCEL", "m/s^2", imu.acc, "specific force"),
            ("gyro", "GYRO", "rad/s", imu.gyro, "turn rate"),
            ("mag", "MAGN", "n/a", imu.mag, "magnetic field, in the sensor's own unit"),
        ]
        point, channels = point_of(segment), []
        for name, kind, unit, values, words in sensors:
            if values is not None:
                about = f"{words} in the IMU's axes"
                channels += _vector(f"{point}_{name}_", np.asarray(values), kind, point, unit, "", about)
        label = "".join(word.capitalize() for word in segment.split("_"))
        systems.append(TrackingSystem(f"imu{label}{side}", "inertial sensor", imu.t_s, channels))
    frames: dict[str, dict[str, str]] = {}
    if recording.camera_frame is not None:
        axes, about_axes = _SPATIAL[recording.camera_frame]
        level = {"Description": about_axes, "RotationRule": "right-hand", "RotationOrder": "XYZ"}
        frames = {"camera": {**level, "SpatialAxes": axes}}
    channels = []
    for joint in arm.present:
        point, state = point_of(joint), arm.state[:, JOINTS.index(joint)]
        place = np.where((state == JointState.NOT_TRACKED)[:, None], np.nan, arm.joint(joint))
        if arm.pixel_rad is None:
            words = f"position of the {joint} in the camera's axes"
            channels += _vector(f"{point}_", place, "POS", point, "m", next(iter(frames), ""), words)
        else:
            for axis, values in zip("xy", place.T, strict=False):
                words = f"image coordinate {axis}/z of the {joint}, lens distortion removed"
                channels.append(Channel(f"{point}_{axis}_image", "", "MISC", point, "", "", words, values))
        about = "0 not tracked, 1 a guess of the camera's, 2 tracked"
        channels.append(Channel(f"{point}_state", "", "MISC", point, "", "", about, state.astype(float)))
    title = "depth camera" if arm.pixel_rad is None else "camera without depth"
    return [*systems, TrackingSystem(f"camera{side}", title, arm.t_s, channels, frames=frames)]


def _vector(
    name: str, values: FloatArray, kind: str, point: str, units: str, frame: str, about: str
) -> list[Channel]:
    """Channels of a vector (N, 3), whose names end in its axes."""
    return [
        Channel(name + axis, axis, kind, point, units, frame, about, each)
        for axis, each in zip("xyz", values.T, strict=True)
    ]


def recovered_system(recovery: Recovery, version: str) -> TrackingSystem:
    """The answer: every column of the CSV export, with its sigmas, on the forearm IMU's clock."""
    channels = [
        Channel(name, *_kind(name), column.unit, "", column.description, values)
        for name, values, column in file_columns(recovery)
    ]
    marks = marks_of(recovery)
    for name in (name for name in _MARKS if name in marks):
        channels.append(Channel(name, "", "MISC", "", "", "", _MARKS[name], np.asarray(marks[name], float)))
    more: dict[str, object] = {
        "SoftwareVersions": f"unocclude {version}",
        "Method": recovery.method,
        "Verdict": recovery.estimates.verdict or "n/a",
        "ClockOffset": {
            "Value": _finite(recovery.clock_offset_s),
            "Sigma": _finite(recovery.clock_offset_sigma_s),
            "Units": "s",
            "Description": "IMU's time less the camera's",
        },
        "Notes": list(recovery.notes),
    }
    return TrackingSystem(f"arm{recovery.side.capitalize()}", "recovered arm", recovery.t_s, channels, more)


def write_bids(
    folder: Path,
    names: BidsNames,
    recordings: Sequence[Recording],
    recoveries: Sequence[Recovery],
    version: str,
    force: bool = False,
) -> int:
    """Write one session into a data set, which is begun where there is none."""
    derivative = folder / "derivatives" / "unocclude"
    raw = [system for recording in recordings for system in recorded_systems(recording)]
    answers = [recovered_system(recovery, version) for recovery in recoveries]
    if folder.exists() and any(folder.iterdir()) and not (folder / "dataset_description.json").exists():
        raise UnoccludeError(f"{folder} contains other files; name a new folder, or that of a BIDS data set")
    for system in raw:
        if (at := folder / names.file(system, "motion.tsv")).exists() and not force:
            raise UnoccludeError(
                f"{at} exists already; give another --subject or --session, or --force to overwrite it"
            )
    for root, kind, title in (
        (folder, "raw", "Arms recorded by camera and IMU"),
        (derivative, "derivative", "Arms recovered by unocclude"),
    ):
        root.joinpath(*names.parts, "motion").mkdir(parents=True, exist_ok=True)
        description: dict[str, object] = {
            "Name": title,
            "BIDSVersion": BIDS_VERSION,
            "DatasetType": kind,
            "GeneratedBy": [{"Name": "unocclude", "Version": version}],
        }
        if not (root / "dataset_description.json").exists():
            _json(root / "dataset_description.json", description)
        _add_row(root / "participants.tsv", "participant_id", f"sub-{names.subject}")
    if not (folder / "README.md").exists():
        _lines(folder / "README.md", _README.splitlines())
    begin_s = min((float(system.t_s[0]) for system in raw), default=0.0)
    scans = folder.joinpath(*names.parts, "_".join([*names.parts, "scans.tsv"]))
    for system in raw:
        _write(folder, names, system)
        began = _EPOCH + timedelta(seconds=float(system.t_s[0]) - begin_s)
        inside, stamp = names.file(system, "motion.tsv").name, began.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        _add_row(scans, "filename\tacq_time", f"motion/{inside}\t{stamp}")
    for system in answers:
        _write(derivative, names, system)
    return len(raw) + len(answers)


def _write(root: Path, names: BidsNames, system: TrackingSystem) -> None:
    """The four files of a tracking system."""
    latency = system.t_s - system.t_s[0]
    about = "seconds since the first sample"
    channels = [Channel("latency", "", "LATENCY", "", "s", "", about, latency), *system.channels]
    values = np.stack([channel.values for channel in channels], axis=1)
    rows = ("\t".join(f"{x:.11g}" if np.isfinite(x) else "n/a" for x in row) for row in values.tolist())
    _lines(root / names.file(system, "motion.tsv"), rows)
    head = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\tdescription"
    listed = ("\t".join(each or "n/a" for each in channel[:-1]) for channel in channels)
    _lines(root / names.file(system, "channels.tsv"), [head, *listed])
    frames: dict[str, object] = {"Description": "axes of the positions; n/a: the sensor's own, or none"}
    frames |= {"Levels": system.frames} if system.frames else {}
    _json(root / names.file(system, "channels.json"), {"reference_frame": frames})
    rate = median_rate_hz(system.t_s) if len(system.t_s) > 1 else 1.0
    span = float(latency[-1]) if len(latency) > 1 else 0.0
    counts = {f"{kind}ChannelCount": sum(channel.kind == kind for channel in channels) for kind in _TYPES}
    motion: dict[str, object] = {
        "TaskName": names.task,
        "TrackingSystemName": system.title,
        "SamplingFrequency": round(rate, 6),
        "SamplingFrequencyEffective": round((len(latency) - 1) / span, 6) if span else round(rate, 6),
        "RecordingDuration": round(span, 6),
        "RecordingType": "continuous",
        "MissingValues": "n/a",
        "MotionChannelCount": len(channels),
        "TrackedPointsCount": len({channel.point for channel in channels if channel.point}),
        **counts,
        **system.more,
    }
    _json(root / names.file(system, "motion.json"), motion)


def _kind(column: str) -> tuple[str, str, str]:
    """Component, type and tracked point of a column of the CSV export."""
    if "sigma" in column:
        return column[-1] if column[-2:] in ("_x", "_y", "_z") else "", "MISC", ""
    if match := re.fullmatch(r"(.*)_q([wxyz])", column):
        return f"quat_{match[2]}", "ORNT", match[1]
    if match := re.fullmatch(r"v([xyz])", column):
        return match[1], "VEL", "imu"
    if column.endswith("_deg"):
        return "", "JNTANG", column.removesuffix("_deg")
    if match := re.fullmatch(r"(.*)_([xyz])", column):
        return match[2], "POS", match[1]
    return "", "MISC", ""


def _add_row(path: Path, header: str, row: str) -> None:
    """Add a row to a table; one of several cells takes the place of that with the same first one."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    head, rows = (lines[0], [line for line in lines[1:] if line]) if lines else (header, [])
    same = [each for each in rows if each.split("\t")[0] == row.split("\t")[0]]
    if same and "\t" not in row:  # somebody may have added columns: sex, age, ..
        return
    cells = [row, *["n/a"] * (len(head.split("\t")) - len(row.split("\t")))]
    _lines(path, [head, *sorted([*(each for each in rows if each not in same), "\t".join(cells)])])


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _lines(path: Path, lines: Sequence[str] | Iterator[str]) -> None:
    with writing(path, True) as temporary, open(temporary, "w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in lines)


def _json(path: Path, values: dict[str, object]) -> None:
    _lines(path, [json.dumps(values, indent=2, ensure_ascii=False, allow_nan=False)])


_README = """# Arms recorded by a camera and IMUs

Motion-BIDS, written by unocclude. `sub-*/motion` contains what was recorded: a tracking system is a stream
with a clock of its own (`tracksys-camera..`, `tracksys-imu..`). The channel `latency` is the time in seconds
since the stream's first sample; `acq_time` in `*_scans.tsv` gives the time between the streams' beginnings by
their own stamps, from an invented date. `derivatives/unocclude` contains the recovered arm with its
deviations, on the forearm IMU's clock.
"""
