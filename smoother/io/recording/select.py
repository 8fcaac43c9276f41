"""Recordings of the arms that a file contains: what was chosen, cleaned, on one axis of time."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar, Unpack

import numpy as np

from ...array_types import IntArray
from ...errors import RecordingError
from ...recording import JointTracks, Recording, TrunkSensors, Truth, arm_words
from ..mcap.messages import SECOND_NS, seconds
from .bodies import join_bodies
from .camera_streams import camera_of
from .choose import Selection, StreamChoice, choose_arms, left_out_words
from .clean import clean_arm, clean_imu, clean_poses
from .keypoints import tracks_of
from .names import role
from .streams import ArmFrames, ImuSamples, PoseSamples, RecordingFile

#: Stamps below this (some twelve days) count from a zero of their own, not from 1970.
_SMALL_NS = 1_000_000 * SECOND_NS
#: A stream that is there for a smaller share of the other's time is spoken of; pauses of the IMU, ns.
_COVERS, _PAUSE_NS = 0.9, 500_000_000
#: Streams with less in common, ns, or fewer samples of the IMU in it, hold nothing that could be solved.
_LEAST_NS, _FEWEST = SECOND_NS // 5, 3
Cleaned = TypeVar("Cleaned", ImuSamples, ArmFrames, PoseSamples)


def select_recordings(
    file: RecordingFile,
    *,
    prefer_side: str | None = None,
    alone: bool = False,
    **selection: Unpack[Selection],
) -> list[Recording]:
    """Make a recording of every arm with an IMU from what a file contains, or of the one that is meant."""
    arms: list[StreamChoice] = []
    errors: list[RecordingError] = []
    with file.damage_told():
        choices, left_out = choose_arms(file, prefer_side=prefer_side, alone=alone, **selection)
        for choice in choices:
            try:
                arms.append(_cleaned(choice, file))
            except RecordingError as error:
                errors.append(error)
                left_out.append(left_out_words(arm_words(choice.side, choice.body), error))
        if not arms:
            raise errors[0]
        origin = _origin_ns(arms)  # one zero for all
        recordings = [_recording(arm, file, origin) for arm in arms]
    return [replace(one, notes=(*one.notes, *left_out)) for one in recordings]


def _cleaned(choice: StreamChoice, file: RecordingFile) -> StreamChoice:
    """The same with streams that are cleaned, still with their stamps."""
    source, notes = str(file.path), [*file.notes, *choice.notes]

    def said(cleaned: tuple[Cleaned, list[str]]) -> Cleaned:
        notes.extend(cleaned[1])
        return cleaned[0]

    imu, arm = said(clean_imu(choice.imu, source)), said(clean_arm(choice.arm, source))
    _check_overlap(imu, arm, source, file.clocks_unrelated)
    if not file.clocks_unrelated:
        notes += _coverage(imu, arm)
    base = None if choice.base is None else said(clean_imu(choice.base, source))
    truth = None if choice.truth is None else said(clean_poses(choice.truth))
    further = {segment: said(clean_imu(stream, source)) for segment, stream in choice.further.items()}
    return replace(choice, imu=imu, arm=arm, base=base, truth=truth, further=further, notes=notes)


def _recording(choice: StreamChoice, file: RecordingFile, origin: int) -> Recording:
    arm, base, truth = choice.arm, choice.base, choice.truth
    opposite = _opposite_arm(file, choice, origin)
    trunk, notes = _trunk(file, choice, opposite, origin)
    found = [camera_of(*each, str(file.path), origin, file.lenses) for each in choice.cameras]
    notes += [note for _, more in found for note in more]
    return Recording(
        imu=choice.imu.on_axis(origin),
        arm=tracks_of(arm, origin),
        side=choice.side,
        camera_frame=arm.camera_frame if arm.lens is not None else file.camera_frame or arm.camera_frame,
        gravity_hint=file.gravity_hint,
        base_imu=None if base is None else base.on_axis(origin),
        truth=None if truth is None else _truth(truth, origin),
        origin_ns=origin,
        name=file.name,
        notes=(*choice.notes, *notes),
        further_imus={name: stream.on_axis(origin) for name, stream in choice.further.items()},
        body=choice.body,
        trunk=trunk,
        clocks_unrelated=file.clocks_unrelated,
        applied_fixes=file.applied_fixes,
        opposite=opposite,
        cameras=tuple(camera for camera, _ in found if camera is not None),
    )


def _trunk(
    file: RecordingFile, choice: StreamChoice, opposite: JointTracks | None, origin_ns: int
) -> tuple[TrunkSensors | None, list[str]]:
    """The trunk's IMU by its name with the other arm, whose shoulder shows the trunk's heading; sentences."""
    named = [imu for imu in file.imus if imu is not choice.imu and role(imu) == "trunk"]
    if not named:
        return None, []
    if len(named) > 1:
        names = ", ".join(imu.topic for imu in named)
        return None, [f"Of the trunk IMUs {names} none was taken: their names do not show which is meant."]
    samples, notes = clean_imu(named[0], str(file.path))
    imu = replace(samples, mag=None).on_axis(origin_ns)
    return TrunkSensors(imu, opposite), [f"IMU {samples.topic} is on the trunk by its name.", *notes]


def _opposite_arm(file: RecordingFile, choice: StreamChoice, origin_ns: int) -> JointTracks | None:
    """The camera's joints of the same person's other arm; None where there is none that can be used."""
    sides = {"left", "right"}
    if any({arm.side, choice.arm.side} == sides for arm in file.arms):
        for arm in join_bodies(file.arms)[0]:
            if arm.key[:2] == choice.arm.key[:2] and {arm.side, choice.arm.side} == sides:
                with suppress(RecordingError):  # it was not asked for
                    return tracks_of(clean_arm(arm, str(file.path))[0], origin_ns)
                return None
    return None


def _origin_ns(arms: Sequence[StreamChoice]) -> int:
    """What the times of these arms count from, ns."""
    streams = [
        each for arm in arms for each in (arm.imu, arm.arm, arm.base, arm.truth, *arm.further.values())
    ]
    first = [int(stream.stamp_ns[0]) for stream in streams if stream is not None and len(stream.stamp_ns)]
    origin = min(first) // SECOND_NS * SECOND_NS
    return 0 if max(abs(stamp) for stamp in first) < _SMALL_NS else origin


def _check_overlap(imu: ImuSamples, arm: ArmFrames, source: str, unrelated: bool) -> None:
    """Refuse streams of which nothing can be solved: too short a time in common, or hardly a sample in it."""
    (start, end), (first, last) = ((int(s[0]), int(s[-1])) for s in (imu.stamp_ns, arm.stamp_ns))
    if unrelated:  # their stamps do not show what they have in common: at most the shorter one
        first, last = start, start + min(end - start, last - first)
    first, last = max(start, first), min(end, last)
    at, behind = np.searchsorted(imu.stamp_ns, [first, last])
    if last - first >= _LEAST_NS and behind - at >= _FEWEST:
        return
    rate_hz = 1e9 / max(float(np.median(np.diff(imu.stamp_ns))), 1.0)
    spans = f"(IMU {_span(imu.stamp_ns)} at {rate_hz:.3g} Hz, camera {_span(arm.stamp_ns)})"
    if last <= first:
        raise RecordingError(
            f"{source}: {imu.topic} and {arm.label} do not overlap in time, they are"
            f" {(first - last) / 1e9:.3f} s apart {spans}; record both at the same time, with clocks that"
            " agree to a second."
        )
    raise RecordingError(
        f"{source}: {imu.topic} and {arm.label} have only {(last - first) / 1e9:.3g} s and {behind - at}"
        f" samples of the IMU in common {spans}; if a file's times are in another unit, import it again with"
        " the right time_unit, else record both at the same time."
    )


def _coverage(imu: ImuSamples, arm: ArmFrames) -> list[str]:
    """A sentence where one stream is there for much less of the time than the other."""
    (imu_first, imu_last), (first, last) = ((int(s[0]), int(s[-1])) for s in (imu.stamp_ns, arm.stamp_ns))
    shared_s, imu_s, camera_s = (
        ns / 1e9 for ns in (min(imu_last, last) - max(imu_first, first), imu_last - imu_first, last - first)
    )
    steps = np.diff(imu.stamp_ns)
    there_s = min(imu_s - float(steps[steps > _PAUSE_NS].sum()) / 1e9, shared_s)
    sentences = []
    if there_s < _COVERS * camera_s:
        what = f"samples for {there_s:.1f} of the camera's {camera_s:.1f} s"
        sentences.append(f"{imu.topic}: there are {what}.")
    if shared_s < _COVERS * imu_s:
        what = f"frames for {shared_s:.1f} of the IMU's {imu_s:.1f} s"
        sentences.append(f"{arm.label}: there are {what}.")
    return sentences


def _span(stamp_ns: IntArray) -> str:
    return f"{stamp_ns[0] / 1e9:.3f} .. {stamp_ns[-1] / 1e9:.3f} s"


def _truth(poses: PoseSamples, origin: int) -> Truth:
    score = np.ones(len(poses.stamp_ns), bool) if poses.score is None else poses.score
    t_s = seconds(poses.stamp_ns, origin)
    return Truth(t_s, poses.position, poses.quaternion, score, dict(poses.joints))
