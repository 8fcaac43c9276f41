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
from ...recording import JOINTS, CameraFrame, ImuStream, JointState, Recording
from ...result import Recovery
from ...result.untrusted import usable
from ...runtime.outputs import writing
from .csv import file_columns

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
    def folder(self) -> str:
        """Below the data set: `sub-X/ses-Y/motion`."""
        session = f"ses-{self.session}/" if self.session else ""
        return f"sub-{self.subject}/{session}motion"

    @property
    def start(self) -> str:
        """Of every file's name, without the task."""
        return f"sub-{self.subject}" + (f"_ses-{self.session}" if self.session else "")


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
    systems = [_imu(f"imuForearm{side}", _point("forearm", recording.side), recording.imu)]
    for segment, imu in recording.further_imus.items():
        label = "".join(word.capitalize() for word in segment.split("_"))
        systems.append(_imu(f"imu{label}{side}", _point(segment, recording.side), imu))
    frames = _camera_frames(recording.camera_frame)
    frame, channels = next(iter(frames), ""), []
    for joint in arm.present:
        point = _point(joint, recording.side)
        state = arm.state[:, JOINTS.index(joint)]
        place = np.where((state == JointState.NOT_TRACKED)[:, None], np.nan, arm.joint(joint))
        if arm.pixel_rad is None:
            words = f"position of the {joint} in the camera's axes"
            channels += [
                Channel(f"{point}_{axis}", axis, "POS", point, "m", frame, words, values)
                for axis, values in zip("xyz", place.T, strict=True)
            ]
        else:
            words = "image coordinate {}/z of the " + joint + ", lens distortion removed"
            channels += [
                Channel(f"{point}_{axis}_image", "", "MISC", point, "", "", words.format(axis), values)
                for axis, values in zip("xy", place.T, strict=False)
            ]
        about = "0 not tracked, 1 a guess of the camera's, 2 tracked"
        channels.append(Channel(f"{point}_state", "", "MISC", point, "", "", about, state.astype(float)))
    title = "depth camera" if arm.pixel_rad is None else "camera without depth"
    systems.append(TrackingSystem(f"camera{side}", title, arm.t_s, channels, frames=frames))
    return systems


def recovered_system(recovery: Recovery, version: str) -> TrackingSystem:
    """The answer: every column of the CSV export, with its sigmas, on the forearm IMU's clock."""
    channels = [
        Channel(name, *_kind(name), column.unit, "", column.description, values)
        for name, values, column in file_columns(recovery)
    ]
    marks = {
        "occluded": (recovery.occluded, "1: the camera did not see the forearm"),
        "usable": (usable(recovery), "1: there is an answer that is not distrusted"),
    }
    if recovery.has_verdict:
        marks["trusted"] = (recovery.trusted, "1: the answer is to be trusted")
    for name, (flags, about) in marks.items():
        channels.append(Channel(name, "", "MISC", "", "", "", about, np.asarray(flags, float)))
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
    if not force:
        for system in raw:
            if (at := folder / _file(names, system, "motion.tsv")).exists():
                raise UnoccludeError(
                    f"{at} exists already; give another --subject or --session, or --force to overwrite it"
                )
    for root in (folder, derivative):
        (root / names.folder).mkdir(parents=True, exist_ok=True)
        _describe(root, version, root == derivative)
        _add_row(root / "participants.tsv", "participant_id", f"sub-{names.subject}")
    if not (folder / "README.md").exists():
        _lines(folder / "README.md", _README.splitlines())
    begin_s = min((float(system.t_s[0]) for system in raw), default=0.0)
    for system in raw:
        _write(folder, names, system)
        began = _EPOCH + timedelta(seconds=float(system.t_s[0]) - begin_s)
        session = f"ses-{names.session}/" if names.session else ""
        scans = folder / f"sub-{names.subject}/{session}{names.start}_scans.tsv"
        stamp = began.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        inside = f"motion/{Path(_file(names, system, 'motion.tsv')).name}"
        _add_row(scans, "filename\tacq_time", f"{inside}\t{stamp}")
    for system in answers:
        _write(derivative, names, system)
    return len(raw) + len(answers)


def _write(root: Path, names: BidsNames, system: TrackingSystem) -> None:
    """The four files of a tracking system."""
    latency = system.t_s - system.t_s[0]
    about = "seconds since the first sample"
    channels = [Channel("latency", "", "LATENCY", "", "s", "", about, latency), *system.channels]
    values = np.stack([channel.values for channel in channels], axis=1)
    rows = ("\t".join(_cell(value) for value in row) for row in values.tolist())
    _lines(root / _file(names, system, "motion.tsv"), rows)
    head = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\tdescription"
    listed = ("\t".join(each or "n/a" for each in channel[:-1]) for channel in channels)
    _lines(root / _file(names, system, "channels.tsv"), [head, *listed])
    frames: dict[str, object] = {"Description": "axes of the positions; n/a: the sensor's own, or none"}
    if system.frames:
        frames["Levels"] = system.frames
    _json(root / _file(names, system, "channels.json"), {"reference_frame": frames})
    rate = median_rate_hz(system.t_s) if len(system.t_s) > 1 else 1.0
    span = float(latency[-1]) if len(latency) > 1 else 0.0
    counts = {f"{kind}ChannelCount": sum(channel.kind == kind for channel in channels) for kind in _TYPES}
    motion = {
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
    _json(root / _file(names, system, "motion.json"), motion)


def _file(names: BidsNames, system: TrackingSystem, ending: str) -> str:
    stem, _, suffix = ending.partition(".")
    return f"{names.folder}/{names.start}_task-{names.task}_tracksys-{system.label}_{stem}.{suffix}"


def _imu(label: str, point: str, imu: ImuStream) -> TrackingSystem:
    parts = [
        ("acc", "ACCEL", "m/s^2", imu.acc, "specific force"),
        ("gyro", "GYRO", "rad/s", imu.gyro, "turn rate"),
        ("mag", "MAGN", "n/a", imu.mag, "magnetic field, in the sensor's own unit"),
    ]
    channels = [
        Channel(f"{point}_{name}_{axis}", axis, kind, point, units, "", f"{words} in the IMU's axes", column)
        for name, kind, units, values, words in parts
        if values is not None
        for axis, column in zip("xyz", np.asarray(values).T, strict=True)
    ]
    return TrackingSystem(label, "inertial sensor", imu.t_s, channels)


def _point(name: str, side: str) -> str:
    return f"{side}_{name}" if side else name


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


def _camera_frames(frame: CameraFrame | None) -> dict[str, dict[str, str]]:
    if frame is None:
        return {}
    axes, about = _SPATIAL[frame]
    level = {"Description": about, "RotationRule": "right-hand", "RotationOrder": "XYZ"}
    return {"camera": {**level, "SpatialAxes": axes}}


def _describe(root: Path, version: str, is_derivative: bool) -> None:
    description: dict[str, object] = {
        "Name": "Arms recovered by unocclude" if is_derivative else "Arms recorded by camera and IMU",
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "derivative" if is_derivative else "raw",
        "GeneratedBy": [{"Name": "unocclude", "Version": version}],
    }
    if not (root / "dataset_description.json").exists():
        _json(root / "dataset_description.json", description)


def _add_row(path: Path, header: str, row: str) -> None:
    """Add a row to a table; one of several cells takes the place of that with the same first one."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    head, rows = (lines[0], [line for line in lines[1:] if line]) if lines else (header, [])
    same = [each for each in rows if each.split("\t")[0] == row.split("\t")[0]]
    if same and "\t" not in row:  # somebody may have added columns: sex, age, ..
        return
    cells = [row, *["n/a"] * (len(head.split("\t")) - len(row.split("\t")))]
    _lines(path, [head, *sorted([*(each for each in rows if each not in same), "\t".join(cells)])])


def _cell(value: float) -> str:
    return f"{value:.11g}" if np.isfinite(value) else "n/a"


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
