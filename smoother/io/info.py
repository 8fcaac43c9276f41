"""What a file contains, also per arm, and what is missing for which step."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ..body import FURTHER
from ..errors import RecordingError
from ..measurements.allowance import allowance
from ..measurements.visibility import find_gaps, visible_frames
from ..recording import Recording
from ..result.verdict import plain
from .mcap.messages import Topic
from .recording.choose import Selection
from .recording.read import METADATA, open_recording, select_recordings
from .recording.streams import ArmFrames, ImuSamples, PoseSamples, RecordingFile
from .result.read import stated_estimates
from .result.write import RESULT

#: Figures of one arm as JSON; those of the first stand beside the file's own, and these where there is none.
Figures = dict[str, Any]
_NO_ARM: Figures = {
    **dict.fromkeys(("imu", "skeleton", "side", "upper_imu", "hand_imu", "trunk_imu", "allows"), ""),
    **dict.fromkeys(("imu_rate_hz", "camera_rate_hz", "duration_s")),
    **dict.fromkeys(("gaps", "gap_total_s", "gap_longest_s")),
    "joints": [],
}


def describe_arm(recording: Recording) -> Figures:
    """An arm that would be recovered, and what would be taken of it."""
    arm, imu = recording.arm, recording.imu
    start, end = max(imu.t_s[0], arm.t_s[0]), min(imu.t_s[-1], arm.t_s[-1])
    gaps = find_gaps(arm.t_s, visible_frames(arm), float(start), float(end))
    lengths_s = [0.0, *(gap.length_s for gap in gaps)]
    allowed = allowance(recording)
    names = {segment: stream.name for segment, stream in recording.further_imus.items()}
    figures = {
        "label": recording.arm_label,  # As "left arm"
        "imu": imu.name,
        "skeleton": arm.name,
        "side": recording.side,
        "body": recording.body,
        **{f"{segment.prefix}_imu": names.get(segment.name, "") for segment in FURTHER},
        "trunk_imu": "" if recording.trunk is None else recording.trunk.imu.name,
        "joints": list(arm.present),
        "imu_rate_hz": _finite(imu.rate_hz),  # Median rates
        "camera_rate_hz": _finite(arm.rate_hz),
        "duration_s": round(float(end - start), 3),  # That IMU and camera share
        "gaps": len(gaps),
        "gap_total_s": round(sum(lengths_s), 3),
        "gap_longest_s": round(max(lengths_s), 3),
        "allows": allowed.sentence,
        "ready": allowed.ready,  # There is no sign that no answer could be trusted
    }
    cameras = [
        f"{each.name}: {len(each.arm)} frames"
        + (f" at {each.arm.rate_hz:.1f} Hz" if len(each.arm) > 1 else "")
        + f", forearm tracked in {100 * each.arm.forearm_tracked.mean():.0f} %"
        for each in recording.cameras
    ]
    return figures | ({"cameras": cameras} if cameras else {})


def _finite(value: float) -> float | None:
    """A value to three decimals; None where there is none."""
    return round(value, 3) if math.isfinite(value) else None


_DEPTH = ("sensor_msgs/msg/Image", "sensor_msgs/Image", "foxglove.RawImage", "foxglove.CompressedImage")


def describe(path: str | os.PathLike[str], **selection: Unpack[Selection]) -> Figures:
    """What `unocclude info` shows of an MCAP file, as JSON; options as in `read_recordings`."""
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
    first = arms[0] if arms else _NO_ARM
    return {
        "path": str(file.path),
        "size_bytes": Path(path).stat().st_size,
        "topics": [
            {"name": each.name, "schema": each.schema, "count": each.count}
            | {"rate_hz": _rate_hz(file, each), "duration_s": round(each.duration_s, 3)}
            for each in file.topics
        ],
        "imus": [
            f"{stream.topic}: {len(stream.stamp_ns)} samples, {stream.role or 'no limb named'}"
            + (f", {stream.side}" if stream.side else "")
            + (", magnetometer" if stream.mag is not None else "")
            for stream in file.imus
        ],
        "skeletons": [
            f"{arm.label}: {len(arm.stamp_ns)} frames, forearm tracked in {arm.tracked}" for arm in file.arms
        ],
        "poses": [f"{poses.topic}: {len(poses.stamp_ns)} poses" for poses in file.poses],
        "camera_frame": None if frame is None else str(frame),
        "clocks": _clocks(file),
        "missing": missing,  # By step, one sentence
        "optional": _optional(file, recordings[0] if recordings else None),
        "ready": bool(arms) and all(arm["ready"] for arm in arms),
        "result": any(RESULT in name for name in file.metadata),  # The file contains a recovery already
        "verdicts": [
            {"arm": arm, "trusted": stated.trusted, "verdict": stated.verdict}
            | {"untrusted": [plain(each) for each in stated.untrusted]}
            for arm, stated in stated_estimates(file.metadata).items()
        ],
        "notes": list(
            dict.fromkeys(n for one in recordings for n in one.notes) if recordings else file.notes
        ),
        "arms": arms,
        **{name: first[name] for name in _NO_ARM},
    }


def _rate_hz(file: RecordingFile, topic: Topic) -> float | None:
    """Mean rate of a topic; messages of one frame (of an arm or a body each) count once."""
    rate_hz = _finite(topic.rate_hz)
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
