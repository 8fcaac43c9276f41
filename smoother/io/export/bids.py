"""Results and their recordings as a Motion-BIDS data set: the answer is a derivative of what was recorded.

Motion-BIDS: Jeung et al., Scientific Data 11:716, 2024; the rules are those of BIDS 1.10.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...linalg import median_rate_hz
from ...recording import JOINTS, CameraFrame, JointState, Recording
from ...result import Recovery
from ...runtime.outputs import writing
from .prepare import file_columns, marks_of

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
#: The vectors of an IMU: name, unit, and what they are in its axes.
_SENSORS = (
    ("acc", "m/s^2", "specific force"),
    ("gyro", "rad/s", "turn rate"),
    ("mag", "n/a", "magnetic field, in the sensor's own unit"),
)
#: Types of channels by their names, which say their component and their tracked point; the first that fits.
_KINDS = {
    "latency": "LATENCY",
    r".*sigma.*?(_(?P<component>[xyz]))?": "MISC",
    r"(?P<point>.*)_acc_(?P<component>[xyz])": "ACCEL",
    r"(?P<point>.*)_gyro_(?P<component>[xyz])": "GYRO",
    r"(?P<point>.*)_mag_(?P<component>[xyz])": "MAGN",
    r"(?P<point>.*)_([xy]_image|state)": "MISC",
    r"(?P<point>.*)_q(?P<quaternion>[wxyz])": "ORNT",
    r"(?P<imu>v)(?P<component>[xyz])": "VEL",
    r"(?P<point>.*)_deg": "JNTANG",
    r"(?P<point>.*)_(?P<component>[xyz])": "POS",
    ".*": "MISC",
}


@dataclass(frozen=True)
class BidsNames:
    """How a recording is called in a data set."""

    subject: str  # Labels of letters and digits; `session` may be ""
    session: str = ""
    task: str = "arm"

    def __post_init__(self) -> None:
        for option, label in vars(self).items():
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
    """A column of a motion file, as `channels.tsv` describes it."""

    name: str
    values: FloatArray  # (N,): nan is n/a
    units: str
    description: str
    frame: str = ""

    @property
    def row(self) -> tuple[str, ...]:
        """Name, component, type, tracked point, units, frame, description; "" is n/a."""
        fits = ((re.fullmatch(pattern, self.name), kind) for pattern, kind in _KINDS.items())
        said, kind = next((match.groupdict(""), kind) for match, kind in fits if match)
        quaternion, point = said.get("quaternion"), said.get("point", "")
        component = f"quat_{quaternion}" if quaternion else said.get("component", "")
        point = "imu" if "imu" in said else point
        return self.name, component, kind, point, self.units, self.frame, self.description


def _vector(name: str, values: FloatArray, units: str, about: str, frame: str = "") -> list[Channel]:
    """Channels of a vector (N, 3), whose names end in its axes."""
    parts = zip("xyz", np.asarray(values).T, strict=True)
    return [Channel(f"{name}_{axis}", each, units, about, frame) for axis, each in parts]


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
    side, arm, systems = recording.side.capitalize(), recording.arm, []
    before = f"{recording.side}_" if recording.side else ""
    for segment, imu in {"forearm": recording.imu, **recording.further_imus}.items():
        channels = []
        for sensor, unit, words in _SENSORS:
            if (values := getattr(imu, sensor)) is not None:
                channels += _vector(f"{before}{segment}_{sensor}", values, unit, f"{words} in the IMU's axes")
        label = "".join(word.capitalize() for word in segment.split("_"))
        systems.append(TrackingSystem(f"imu{label}{side}", "inertial sensor", imu.t_s, channels))
    frames: dict[str, dict[str, str]] = {}
    if recording.camera_frame is not None:
        axes, about_axes = _SPATIAL[recording.camera_frame]
        level = {"Description": about_axes, "RotationRule": "right-hand", "RotationOrder": "XYZ"}
        frames = {"camera": {**level, "SpatialAxes": axes}}
    channels, is_flat = [], arm.pixel_rad is not None
    for joint in arm.present:
        point, state = f"{before}{joint}", arm.state[:, JOINTS.index(joint)]
        place = np.where((state == JointState.NOT_TRACKED)[:, None], np.nan, arm.joint(joint))
        if is_flat:
            for axis, values in zip("xy", place.T, strict=False):
                words = f"image coordinate {axis}/z of the {joint}, lens distortion removed"
                channels.append(Channel(f"{point}_{axis}_image", values, "", words))
        else:
            words = f"position of the {joint} in the camera's axes"
            channels += _vector(point, place, "m", words, next(iter(frames), ""))
        about = "0 not tracked, 1 a guess of the camera's, 2 tracked"
        channels.append(Channel(f"{point}_state", state.astype(float), "", about))
    title = "camera without depth" if is_flat else "depth camera"
    return [*systems, TrackingSystem(f"camera{side}", title, arm.t_s, channels, frames=frames)]


def _recovered_system(recovery: Recovery, version: str) -> TrackingSystem:
    """The answer: every column of the CSV export, with its sigmas, on the forearm IMU's clock."""
    channels = [Channel(name, values, of.unit, of.description) for name, values, of in file_columns(recovery)]
    marks = marks_of(recovery)
    channels += [Channel(m, marks[m].astype(float), "", about) for m, about in _MARKS.items() if m in marks]
    offset, sigma = (
        float(each) if np.isfinite(each) else None
        for each in (recovery.clock_offset_s, recovery.clock_offset_sigma_s)
    )
    clock = {"Value": offset, "Sigma": sigma, "Units": "s", "Description": "IMU's time less the camera's"}
    more: dict[str, object] = {
        "SoftwareVersions": f"unocclude {version}",
        "Method": recovery.method,
        "Verdict": recovery.estimates.verdict or "n/a",
        "ClockOffset": clock,
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
    answers = [_recovered_system(recovery, version) for recovery in recoveries]
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
        about: dict[str, Any] = {"Name": title, "BIDSVersion": BIDS_VERSION, "DatasetType": kind}
        made_by = {"GeneratedBy": [{"Name": "unocclude", "Version": version}]}
        if not (root / "dataset_description.json").exists():
            _json(root / "dataset_description.json", about | made_by)
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
    channels = [Channel("latency", latency, "s", "seconds since the first sample"), *system.channels]
    values = np.stack([channel.values for channel in channels], axis=1)
    cells = ("\t".join(f"{x:.11g}" if np.isfinite(x) else "n/a" for x in row) for row in values.tolist())
    _lines(root / names.file(system, "motion.tsv"), cells)
    head = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\tdescription"
    rows = [channel.row for channel in channels]
    listed = ("\t".join(each or "n/a" for each in row) for row in rows)
    _lines(root / names.file(system, "channels.tsv"), [head, *listed])
    frames: dict[str, object] = {"Description": "axes of the positions; n/a: the sensor's own, or none"}
    frames |= {"Levels": system.frames} if system.frames else {}
    _json(root / names.file(system, "channels.json"), {"reference_frame": frames})
    rate = median_rate_hz(system.t_s) if len(system.t_s) > 1 else 1.0
    span = float(latency[-1]) if len(latency) > 1 else 0.0
    _, _, kinds, points, *_ = zip(*rows, strict=True)
    motion: dict[str, object] = {
        "TaskName": names.task,
        "TrackingSystemName": system.title,
        "SamplingFrequency": round(rate, 6),
        "SamplingFrequencyEffective": round((len(latency) - 1) / span, 6) if span else round(rate, 6),
        "RecordingDuration": round(span, 6),
        "RecordingType": "continuous",
        "MissingValues": "n/a",
        "MotionChannelCount": len(channels),
        "TrackedPointsCount": len({*points} - {""}),
        **{f"{kind}ChannelCount": kinds.count(kind) for kind in _TYPES},
        **system.more,
    }
    _json(root / names.file(system, "motion.json"), motion)


def _add_row(path: Path, header: str, row: str) -> None:
    """Add a row to a table; one of several cells takes the place of that with the same first one."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    head, rows = (lines[0], [line for line in lines[1:] if line]) if lines else (header, [])
    same = [each for each in rows if each.split("\t")[0] == row.split("\t")[0]]
    if same and "\t" not in row:  # somebody may have added columns: sex, age, ..
        return
    cells = [row, *["n/a"] * (len(head.split("\t")) - len(row.split("\t")))]
    _lines(path, [head, *sorted([*(each for each in rows if each not in same), "\t".join(cells)])])


def _lines(path: Path, lines: Iterable[str]) -> None:
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
