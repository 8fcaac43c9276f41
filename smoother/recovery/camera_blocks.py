"""Blocks of the camera's samples that all the rest of a recording contradicts: left out, tested, readmitted.

A loss judges single samples; a block that agrees with itself and with nothing else (another person's body,
left and right exchanged, joints that the tracker guessed) passes it. So every block is compared with what the
rest predicts (`graph.changes`). Wrong blocks support each other, and sound ones beside them look as
guilty: all suspects are left out, the motion is recovered without them, and what agrees with that is
readmitted in half seconds. What contradicts even then, or was left out where nothing confirms the answer on
both sides, leaves its gaps untrusted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..errors import UnoccludeError
from ..linalg import interpolate, runs
from ..measurements.clock import Clock
from ..measurements.segment import Segment
from ..measurements.visibility import MISSING_S, Rejection
from ..recording import JOINTS, JointState, Recording
from ..result import Pairing, Recovery
from ..result.verdict import Finding
from ..selfcal.pairing import find_pairing
from ..window.solution import BlockShift, HiddenStretch, Step
from .camera_faults import camera_faults
from .change_signs import changed_for_good
from .samples import SectionAnswer

#: A block is suspicious from this score on: the largest of sound simulated recordings were 0.05 to 1.1.
SUSPICIOUS = 3.0
#: .. or where more than this share of what the camera tracked in this time, s, was rejected, looked at in
#: steps of this length, s.
REJECTED_SHARE, REJECTED_S, STEP_S = 0.5, 2.0, 0.5
#: .. and elbow or wrist lies this many of the camera's sigmas per axis off there in the mean: slow errors of
#: sound simulated Azure Kinects (54 mm at the wrist) reached 4.2 in 5 hours, the other
#: arm for 2 to 5 s reached 20 to 50.
REJECTED_SIGMAS = 4.5
#: Times that the recording is solved again without what is left out.
ROUNDS = 3
#: What the camera saw this long before and after a suspect, s, goes with it until it is predicted.
BESIDE_S = 3.0
#: Of the visible time at most this share is left out: else it cannot be said who is wrong.
MOST_EXCLUDED = 0.4
#: .. and with no more than this left out the rest still shows whether camera and IMU are a pair.
FEW_EXCLUDED = 0.15
#: A slice of this length, s, is readmitted where its mean error in sigmas squared / 3 is below this; the
#: camera's slow error, m per axis, or its whole noise where that is more, is part of sigma; the prediction
#: has to be this good, m per axis: another 18 cm are then distinguished from none.
SLICE_S, READMITTED = 0.5, 3.0
SLOW_M, PREDICTED_M = 0.017, 0.05
#: The camera's shoulder is readmitted with them where it is no farther from the answer's, m.
SHOULDER_M = 0.10

_ELBOW, _WRIST, _HAND = (JOINTS.index(joint) for joint in ("elbow", "wrist", "hand"))
_REJECTED = (
    Rejection.BONE,
    Rejection.DIRECTION,
    Rejection.RAY,
    Rejection.RESIDUAL,
    Rejection.JUMP,
)
_BY_CAMERA = (Rejection.FROZEN, Rejection.INTERPOLATED, Rejection.FAR, Rejection.JUMP, Rejection.BONE)


class Suspect(NamedTuple):
    """A time, s on the IMU's clock, whose samples by a camera, its number, the rest contradicts."""

    start_s: float
    end_s: float
    camera: int = 0


@dataclass
class CameraEvidence:
    """The evidence of all sections on the camera against the rest, collected as they are solved."""

    shifts: list[BlockShift] = field(default_factory=list)
    stretches: list[HiddenStretch] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)

    def collecting(self, answers: Iterable[SectionAnswer]) -> Iterator[SectionAnswer]:
        """The answers as they come; their evidence on the camera is kept."""
        for answer in answers:
            self.shifts += answer.shifts
            self.stretches += answer.stretches
            self.steps += answer.steps
            yield answer


@dataclass(frozen=True)
class Solved:
    """A recovery with its evidence on its own camera and calibration."""

    recovery: Recovery
    evidence: CameraEvidence
    excerpts: list[Segment]  # That the self-calibration read
    misfits: tuple[str, ...] = ()  # What of a given calibration the recording contradicts
    open_questions: tuple[str, ...] = ()  # What self-calibration took with little margin
    excluded: Excluded | None = None  # Samples that it was made without; None before anything was left out
    steps_before: Sequence[Step] = ()  # What may have changed for good, before anything was left out

    def steps(self) -> Iterator[Finding]:
        """What changed for good, by all samples and by those that were not left out."""
        return changed_for_good(self.steps_before, self.evidence.steps)

    def paired(self, pairing: Pairing | None, recording: Recording, given: Clock | None) -> Pairing | None:
        """The pairing by what is used: without what the camera alone shows to be wrong, and a few blocks."""
        if pairing is None or not pairing.reason or self.recovery.residuals is None:
            return pairing
        wrong = Excluded(np.isin(self.recovery.residuals.reason, [int(reason) for reason in _BY_CAMERA]))
        # with many blocks left out the rest was chosen by how well it fits
        if self.excluded is not None and self.excluded.share(recording) <= FEW_EXCLUDED:
            wrong = wrong.joined(self.excluded)
        if not wrong.samples.any():
            return pairing
        again, _ = find_pairing(wrong.applied(recording), None, given)
        return pairing if again is None else replace(again, offset_s=pairing.offset_s)


@dataclass(frozen=True, eq=False)
class Excluded:
    """Camera samples that are left out."""

    samples: BoolArray  # bool (F, 5): in the order of the recording's frames and of `JOINTS`

    @classmethod
    def nothing(cls, recording: Recording) -> Excluded:
        """All samples are used."""
        return cls(np.zeros(recording.arm.state.shape, bool))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Excluded) and np.array_equal(self.samples, other.samples)

    def joined(self, other: Excluded) -> Excluded:
        """What either leaves out."""
        return Excluded(self.samples | other.samples)

    @property
    def frames(self) -> BoolArray:
        """(F,) frames without their forearm."""
        return np.asarray(self.samples[:, [_ELBOW, _WRIST, _HAND]].any(axis=1))

    def share(self, recording: Recording) -> float:
        """Of the frames that saw the forearm, those that are left out."""
        tracked = recording.arm.state == JointState.TRACKED
        visible = tracked[:, [_ELBOW, _WRIST, _HAND, JOINTS.index("strap")]].any(axis=1)
        return int(self.frames.sum()) / max(int(visible.sum()), 1)

    def applied(self, recording: Recording) -> Recording:
        """The recording in which the camera did not track them."""
        state = np.where(self.samples, np.int8(JointState.NOT_TRACKED), recording.arm.state)
        return replace(recording, arm=replace(recording.arm, state=state.astype(recording.arm.state.dtype)))

    def noted(self, recovery: Recovery, recording: Recording) -> Recovery:
        """The recovery with the camera's own states, and these samples among the rejected ones."""
        arm = replace(recovery.arm, state=recording.arm.state)
        residuals = recovery.residuals
        if residuals is not None:
            left_out = self.samples & (recording.arm.state == JointState.TRACKED)
            reason = np.where(left_out, np.uint8(Rejection.CONTRADICTED), residuals.reason)
            residuals = replace(residuals, reason=reason.astype(np.uint8))
        return replace(recovery, arm=arm, residuals=residuals)


def without_wrong_blocks(
    recording: Recording, solve: Callable[[Recording], Solved], names: Sequence[str] = ("the camera",)
) -> Solved:
    """The recovery of a recording without the camera's blocks that the rest contradicts."""
    first = best = solve(recording)
    nothing = excluded = Excluded.nothing(recording)
    contradicting = suspects(best.evidence)
    for _ in range(ROUNDS):
        wanted = readmitted(excluded, best.recovery, recording).joined(
            left_out(recording, best.recovery, contradicting)
        )
        if wanted == excluded or wanted.share(recording) > MOST_EXCLUDED:
            break
        if wanted == nothing:  # all suspects are as the rest predicts them
            best, excluded, contradicting = first, nothing, []
            break
        try:
            best = solve(wanted.applied(recording))
        except UnoccludeError:  # too little is left
            break
        excluded, contradicting = wanted, suspects(best.evidence)
    recovery = excluded.noted(best.recovery, recording)
    faults = camera_faults(excluded.frames, contradicting, recovery, recording, names)
    estimates = recovery.estimates.with_findings(faults)
    recovery = replace(recovery, estimates=estimates)
    return replace(best, recovery=recovery, excluded=excluded, steps_before=first.evidence.steps)


def suspects(evidence: CameraEvidence) -> list[Suspect]:
    """Times of a camera's samples that the rest contradicts, merged."""
    found = [
        Suspect(shift.start_s, shift.end_s, shift.camera)
        for shift in evidence.shifts
        if shift.score > SUSPICIOUS
    ]
    found += [
        Suspect(each.start_s, each.end_s, camera)
        for each in evidence.stretches
        for camera in each.contradicting
    ]
    cameras = sorted({each.camera for each in found})
    return [
        Suspect(start_s, end_s, camera)
        for camera in cameras
        for start_s, end_s in _merged([each[:2] for each in found if each.camera == camera])
    ]


def _mostly_rejected(recovery: Recovery, own: IntArray) -> Iterator[tuple[float, float]]:
    """Times of `REJECTED_S` of which more than half of a camera's frames, those rows, was rejected."""
    residuals = recovery.residuals
    if residuals is None or not len(residuals) or not len(own):
        return
    columns = [_ELBOW, _WRIST]
    rejected = np.isin(residuals.reason[own][:, columns], [int(reason) for reason in _REJECTED])
    tracked = rejected | residuals.used[own][:, columns]
    t = np.asarray(residuals.t_s)[own]
    step = np.floor((t - t[0]) / STEP_S).astype(int)
    steps = round(REJECTED_S / STEP_S)
    sums = [
        np.convolve(np.bincount(step, each), np.ones(steps), "full")[steps - 1 :]
        for each in (rejected.sum(axis=1), tracked.sum(axis=1), np.full(len(t), 1.0))
    ]
    # a time that the camera hardly saw is no evidence on the rest of it
    wrong = (sums[0] > REJECTED_SHARE * sums[1]) & (sums[1] >= sums[2]) & (sums[2] > 2 * steps)
    noise_m = [_noise_m(recovery, joint) for joint in ("elbow", "wrist")]
    for first in np.flatnonzero(wrong).tolist():
        rows = np.flatnonzero((step >= first) & (step < first + steps) & rejected.any(axis=1))
        error_m = residuals.residual[own[rows]][:, columns]
        known = np.isfinite(error_m).all(axis=(1, 2))
        off = np.linalg.norm(error_m[known].mean(axis=0), axis=1) / noise_m if known.any() else np.inf
        if np.max(off) > REJECTED_SIGMAS:
            yield float(t[rows[0]]), float(t[rows[-1]])


def _merged(times: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Times that overlap or touch, as one."""
    merged: list[tuple[float, float]] = []
    for start_s, end_s in sorted(times):
        if merged and start_s <= merged[-1][1] + 0.1:
            merged[-1] = (merged[-1][0], max(merged[-1][1], end_s))
        else:
            merged.append((start_s, end_s))
    return merged


def left_out(recording: Recording, recovery: Recovery, times: Sequence[Suspect]) -> Excluded:
    """All joints of suspects, of what their camera saw beside them, and of what was mostly rejected
    already.
    """
    tracked = recording.arm.state == JointState.TRACKED
    frames = np.zeros(len(tracked), bool)
    for camera, own in enumerate(recording.arm.rows_by_camera):
        t, seen = np.asarray(recovery.arm.t_s)[own], tracked[own][:, 1:].any(axis=1)
        suspected = [each[:2] for each in times if each.camera == camera]
        beside = [(start_s - BESIDE_S, end_s + BESIDE_S) for start_s, end_s in suspected]
        rejected = list(_mostly_rejected(recovery, own))  # the answer has not followed what is beside these
        for visible in _visible_runs(t, seen):
            first_s, last_s = float(t[visible.start]), float(t[visible.stop - 1])
            near = [
                one
                for one, suspect in zip(beside, suspected, strict=True)
                if _overlap(suspect, first_s, last_s)
            ]
            near += [one for one in rejected if _overlap(one, first_s, last_s)]
            for start_s, end_s in _merged(near):
                start_s = first_s if start_s - first_s < SLICE_S else start_s
                end_s = last_s if last_s - end_s < SLICE_S else end_s
                frames[own[visible]] |= (t[visible] >= start_s - 1e-6) & (t[visible] <= end_s + 1e-6)
    return Excluded(frames[:, None] & tracked)


def _overlap(times: tuple[float, float], start_s: float, end_s: float) -> bool:
    return times[0] <= end_s and times[1] >= start_s


def _visible_runs(t: FloatArray, seen: BoolArray) -> list[slice]:
    """Runs of frames that saw something of the forearm, with no gap longer than `MISSING_S` inside."""
    rows = np.flatnonzero(seen)
    breaks = np.flatnonzero(np.diff(t[rows]) > MISSING_S) + 1
    return [slice(int(run[0]), int(run[-1]) + 1) for run in np.split(rows, breaks) if len(run)]


def readmitted(excluded: Excluded, recovery: Recovery, recording: Recording) -> Excluded:
    """What is still left out once the slices that the answer without them predicts are used again."""
    samples = excluded.samples.copy()
    frame_t = np.asarray(recovery.arm.t_s)
    slices = [
        own[rows]
        for own in recording.arm.rows_by_camera
        for run in runs(excluded.frames[own])
        for rows in _slices(frame_t[own], run)
    ]
    for rows in slices:
        if all(_agrees(joint, rows, frame_t, recovery, recording) for joint in ("elbow", "wrist")):
            samples[rows, 1:] = False
            if _shoulder_agrees(rows, frame_t, recovery, recording):
                samples[rows, 0] = False
    return Excluded(samples)


def _slices(t: FloatArray, run: slice) -> Iterator[slice]:
    """A run of frames in slices of about `SLICE_S`."""
    length_s = float(t[run.stop - 1] - t[run.start])
    count = max(round(length_s / SLICE_S), 1)
    edges = np.linspace(run.start, run.stop, min(count, run.stop - run.start) + 1).astype(int)
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if last > first:
            yield slice(first, last)


def _agrees(
    joint: str, rows: IntArray, frame_t: FloatArray, recovery: Recovery, recording: Recording
) -> bool:
    """Whether a joint's mean over a slice lies where the answer says, within both sigmas."""
    if joint not in recovery.joints:
        return True
    tracked = recording.arm.state[rows, JOINTS.index(joint)] == JointState.TRACKED
    t = frame_t[rows][tracked]
    if not len(t):
        return True
    inside = slice(*np.searchsorted(recovery.t_s, [t[0] - 0.1, t[-1] + 0.1]).tolist())
    near = recovery.rows(inside)
    if len(near) < 2 or not np.isfinite(near.joints[joint]).all():
        return False
    answer = interpolate(near.t_s, near.joints[joint], t)
    covariance = interpolate(near.t_s, near.joint_covariance[joint], t).mean(axis=0)
    if float(np.trace(covariance)) > 3.0 * PREDICTED_M**2:
        return False
    error = (recording.arm.joint(joint)[rows][tracked] - answer).mean(axis=0)
    allowed = covariance + _noise_m(recovery, joint) ** 2 * np.eye(3)
    return float(error @ np.linalg.solve(allowed, error)) / 3.0 < READMITTED


def _noise_m(recovery: Recovery, joint: str) -> float:
    """What the mean of a joint's samples may be off by, m per axis."""
    return max(SLOW_M, (recovery.estimates.camera_sigma_m or {}).get(joint, 0.0))


def _shoulder_agrees(rows: IntArray, frame_t: FloatArray, recovery: Recovery, recording: Recording) -> bool:
    if "shoulder" not in recovery.joints:
        return True
    t = frame_t[rows]
    inside = slice(*np.searchsorted(recovery.t_s, [t[0] - 0.1, t[-1] + 0.1]).tolist())
    near = recovery.rows(inside)
    if len(near) < 2:
        return False
    error = recording.arm.joint("shoulder")[rows] - interpolate(near.t_s, near.joints["shoulder"], t)
    distance = np.linalg.norm(error, axis=1)
    distance = distance[np.isfinite(distance)]
    return not len(distance) or float(np.median(distance)) < SHOULDER_M
