"""What a file contains, also per arm, and what is missing for which step."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ..body import FURTHER
from ..errors import RecordingError
from ..measurements.allowance import allowance
from ..measurements.visibility import accepted_samples, find_gaps, visible_frames
from ..recording import Camera, Recording
from ..result.plain import plain
from .mcap.messages import Topic
from .recording.choose import Selection
from .recording.names import named_side, role
from .recording.read import METADATA, open_recording
from .recording.select import select_recordings
from .recording.streams import ArmFrames, ImuSamples, PoseSamples, RecordingFile
from .result.read import stated_estimates
from .result.write import RESULT


@dataclass(frozen=True)
class ArmInfo:
    """An arm that would be recovered, and what would be taken of it."""

    label: str  # As "left arm"
    imu: str
    skeleton: str
    side: str
    body: int | None  # The camera's number of the person, where there are several
    upper_imu: str  # On the same upper arm, hand and trunk; "" without one
    hand_imu: str
    trunk_imu: str
    joints: list[str]  # Of the skeleton
    imu_rate_hz: float | None  # Median rates
    camera_rate_hz: float | None
    duration_s: float  # Time that IMU and camera share
    gaps: int
    gap_total_s: float
    gap_longest_s: float
    allows: str  # What the recording allows, in a line
    ready: bool  # There is no sign that no answer could be trusted
    cameras: list[str] = field(default_factory=list)  # Further cameras that saw the arm, a line each


def describe_arm(recording: Recording) -> ArmInfo:
    """Describe the arm of a recording."""
    arm, imu = recording.arm, recording.imu
    start, end = max(imu.t_s[0], arm.t_s[0]), min(imu.t_s[-1], arm.t_s[-1])
    gaps = find_gaps(arm.t_s, visible_frames(arm, accepted_samples(arm)), float(start), float(end))
    lengths_s = [0.0, *(gap.length_s for gap in gaps)]
    allowed = allowance(recording)
    names = {segment: stream.name for segment, stream in recording.further_imus.items()}
    return ArmInfo(
        label=recording.arm_label,
        imu=imu.name,
        skeleton=arm.name,
        side=recording.side,
        body=recording.body,
        **{f"{segment.prefix}_imu": names.get(segment.name, "") for segment in FURTHER},
        trunk_imu="" if recording.trunk is None else recording.trunk.imu.name,
        joints=list(arm.present),
        imu_rate_hz=finite(imu.rate_hz),
        camera_rate_hz=finite(arm.rate_hz),
        duration_s=round(float(end - start), 3),
        gaps=len(gaps),
        gap_total_s=round(sum(lengths_s), 3),
        gap_longest_s=round(max(lengths_s), 3),
        allows=allowed.sentence,
        ready=allowed.ready,
        cameras=[camera_words(camera) for camera in recording.cameras],
    )


def camera_words(camera: Camera) -> str:
    """A further camera, in words."""
    arm = camera.arm
    rate = f" at {arm.rate_hz:.1f} Hz" if len(arm) > 1 else ""
    return (
        f"{camera.name}: {len(arm)} frames{rate}, forearm tracked in {100 * arm.forearm_tracked.mean():.0f} %"
    )


def finite(value: float) -> float | None:
    """A value to three decimals; None where there is none."""
    return round(value, 3) if math.isfinite(value) else None


_DEPTH = ("sensor_msgs/msg/Image", "sensor_msgs/Image", "foxglove.RawImage", "foxglove.CompressedImage")


@dataclass(frozen=True)
class RecordingInfo:
    """What `unocclude info` shows."""

    path: str
    size_bytes: int
    topics: list[dict[str, Any]]  # All topics: name, schema, count, mean rate_hz, duration_s of log times
    imus: list[str]  # Streams found, as sentences a line each
    skeletons: list[str]
    poses: list[str]
    camera_frame: str | None  # Convention of the camera's axes
    # Per stream, first and last stamp (s) and how far log times lie behind stamps
    clocks: dict[str, dict[str, float]]
    missing: dict[str, str]  # By step, what is missing for it, one sentence
    optional: dict[str, str]  # What recovering does not need, with what it would be good for
    ready: bool  # All arms can be recovered, and there is no sign that no answer could be trusted
    result: bool  # The file contains a recovery already
    verdicts: list[dict[str, object]]  # On each arm of that
    notes: list[str]  # What was dropped, decided or wrong
    arms: list[ArmInfo]  # The arms that would be recovered

    def to_dict(self) -> dict[str, object]:
        """Plain values, fit for JSON; those of an arm are also beside them, of the first."""
        values = asdict(self)
        for arm in values["arms"]:
            if not arm["cameras"]:  # of one camera nothing is said
                del arm["cameras"]
        first = values["arms"][0] if self.arms else _NO_ARM
        return values | {name: first[name] for name in _NO_ARM}


#: What is said of the first arm where there is none.
_NO_ARM: dict[str, Any] = {
    **dict.fromkeys(("imu", "skeleton", "side", "upper_imu", "hand_imu", "trunk_imu", "allows"), ""),
    **dict.fromkeys(("imu_rate_hz", "camera_rate_hz", "duration_s")),
    **dict.fromkeys(("gaps", "gap_total_s", "gap_longest_s")),
    "joints": [],
}


def describe(
    path: str | os.PathLike[str],
    **selection: Unpack[Selection],
) -> RecordingInfo:
    """Describe an MCAP file; options as in `read_recordings`."""
    file, missing = open_recording(path), {}
    recordings: list[Recording] = []
    try:
        recordings = select_recordings(file, **selection)
    except RecordingError as error:
        missing["smooth"] = str(error)
    for one in reversed(recordings):
        missing |= _missing(one, one.arm_label if len(recordings) > 1 else "")
    arms = [describe_arm(one) for one in recordings]
    frame = recordings[0].camera_frame if recordings else file.camera_frame
    notes = dict.fromkeys(note for one in recordings for note in one.notes) if recordings else file.notes
    return RecordingInfo(
        path=str(file.path),
        size_bytes=Path(path).stat().st_size,
        topics=[
            {"name": each.name, "schema": each.schema, "count": each.count}
            | {"rate_hz": _rate_hz(file, each), "duration_s": round(each.duration_s, 3)}
            for each in file.topics
        ],
        imus=[
            f"{stream.topic}: {len(stream.stamp_ns)} samples, {role(stream) or 'no limb named'}"
            + (f", {at}" if (at := named_side(stream.topic, stream.frame_id)) else "")
            + (", magnetometer" if stream.mag is not None else "")
            for stream in file.imus
        ],
        skeletons=[
            f"{arm.label}: {len(arm.stamp_ns)} frames, forearm tracked in {arm.tracked}" for arm in file.arms
        ],
        poses=[f"{poses.topic}: {len(poses.stamp_ns)} poses" for poses in file.poses],
        camera_frame=None if frame is None else str(frame),
        clocks=_clocks(file),
        missing=missing,
        optional=_optional(file, recordings[0] if recordings else None),
        ready=bool(arms) and all(arm.ready for arm in arms),
        result=any(RESULT in name for name in file.metadata),
        verdicts=[
            {"arm": arm, "trusted": stated.trusted, "verdict": stated.verdict}
            | {"untrusted": [plain(each) for each in stated.untrusted]}
            for arm, stated in stated_estimates(file.metadata).items()
        ],
        notes=list(notes),
        arms=arms,
    )


def _rate_hz(file: RecordingFile, topic: Topic) -> float | None:
    """Mean rate of a topic; messages of one frame (of an arm or a body each) count once."""
    rate_hz = finite(topic.rate_hz)
    stamps = [arm.stamp_ns for arm in file.arms if arm.topic == topic.name]
    if rate_hz is None or not stamps:
        return rate_hz
    frames = len(np.unique(np.concatenate(stamps)))
    return rate_hz * min(frames / topic.count, 1.0)


def _missing(recording: Recording, label: str) -> dict[str, str]:
    """What keeps an arm from being recovered well, by what suffers; `label` where there are several arms."""
    missing = {}
    present = recording.arm.present
    lacking = [joint for joint in ("shoulder", "elbow", "wrist") if joint not in present]
    if lacking:
        missing[f"whole {label or 'arm'}"] = (
            f"{' and '.join(lacking)} never tracked; the IMU's path is recovered anyway."
        )
    if recording.camera_frame is None and recording.gravity_hint is None:
        missing["start of the solution"] = (
            f"the camera's axes are unknown (metadata {METADATA}); gravity is found from motion."
        )
    return missing


def _optional(file: RecordingFile, recording: Recording | None) -> dict[str, str]:
    """What the file does not contain and recovering does not need, with what it would be good for."""
    optional = {}
    if not file.poses:
        optional["truth"] = "`unocclude validate`; `unocclude gaps` needs none"
    if recording is not None and recording.imu.mag is None:
        optional["magnetometer"] = "a heading for some of the baselines"
    if recording is not None and recording.base_imu is None:
        optional["IMU on the camera"] = "a camera that is moved"
    if not any(topic.schema in _DEPTH for topic in file.topics):
        optional["images or depth"] = "calibration with a panel"
    return optional


def _clocks(file: RecordingFile) -> dict[str, dict[str, float]]:
    streams: list[ImuSamples | ArmFrames | PoseSamples] = [*file.imus, *file.arms, *file.poses]
    clocks = {}
    for stream in streams:
        first, last = float(stream.stamp_ns.min()) / 1e9, float(stream.stamp_ns.max()) / 1e9
        clocks[stream.topic] = {"first_s": first, "last_s": last}
        if isinstance(stream, ImuSamples):
            clocks[stream.topic]["log_time_behind_s"] = stream.log_shift_ns / 1e9
    return clocks
