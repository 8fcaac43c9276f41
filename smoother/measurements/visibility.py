"""Which frames show the forearm, and the gaps between them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from ..array_types import BoolArray, CameraNumbers, FloatArray
from ..recording import FOREARM_JOINTS, JOINTS, JointTracks

#: Frames farther apart than this (s, and in frame periods) leave a gap although none says `occluded`.
MISSING_S = 0.15
MISSING_FRAMES = 2.5


def accepted_samples(arm: JointTracks) -> BoolArray:
    """Samples that may be used: tracked and finite, (F, 5)."""
    return np.stack([arm.tracked(joint) for joint in JOINTS], axis=1)


def visible_frames(arm: JointTracks) -> BoolArray:
    """Frames (F,) in which the camera sees the forearm."""
    return enough_joints(accepted_samples(arm), joints_needed(arm))


def joints_needed(arm: JointTracks) -> int:
    """How many accepted forearm joints make a frame visible."""
    return max(min(2, len([joint for joint in arm.present if joint in FOREARM_JOINTS])), 1)


def enough_joints(accepted: BoolArray, needed: int) -> BoolArray:
    """Frames (F,) with this many accepted forearm joints; with one, the camera saw some of the forearm."""
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    return accepted[:, forearm].sum(axis=1) >= needed


def seen_by_any(t_s: FloatArray, visible: BoolArray, camera: CameraNumbers | None) -> BoolArray:
    """Frames at whose time some camera sees the forearm, (F,): their own, or one on both sides in time."""
    if camera is None:
        return visible
    seen = visible.copy()
    for number in np.unique(camera):
        own = np.flatnonzero(camera == number)
        if len(own) < 2:
            continue
        period_s = float(np.median(np.diff(t_s[own])))
        near = np.diff(t_s[own]) <= max(MISSING_S, MISSING_FRAMES * period_s)
        between = visible[own][1:] & visible[own][:-1] & near
        after = np.clip(np.searchsorted(t_s[own], t_s), 1, len(own) - 1)
        seen |= between[after - 1] & (t_s >= t_s[own[0]]) & (t_s <= t_s[own[-1]])
    return seen


def find_gaps(t_s: FloatArray, visible: BoolArray, start_s: float, end_s: float) -> tuple[Gap, ...]:
    """Gaps between two times, by the times (F,) of frames and which show the forearm."""
    inside = (t_s >= start_s) & (t_s <= end_s)
    t_s, visible = t_s[inside], visible[inside]
    visible_t = t_s[visible]
    if len(visible_t) == 0:
        return (Gap(start_s, end_s, open_start=True, open_end=True),)
    missing_s = max(MISSING_S, MISSING_FRAMES * float(np.median(np.diff(t_s)))) if len(t_s) > 1 else MISSING_S
    frame = np.flatnonzero(visible)
    gaps = [
        Gap(float(a), float(b))
        for a, b, skipped in zip(visible_t[:-1], visible_t[1:], np.diff(frame) > 1, strict=True)
        if skipped or b - a > missing_s
    ]
    if visible_t[0] - start_s > missing_s or frame[0] > 0:
        gaps.insert(0, Gap(start_s, float(visible_t[0]), open_start=True))
    if end_s - visible_t[-1] > missing_s or frame[-1] < len(t_s) - 1:
        gaps.append(Gap(float(visible_t[-1]), end_s, open_end=True))
    return tuple(gaps)


def occluded_at(t_s: FloatArray, gaps: tuple[Gap, ...]) -> BoolArray:  # t_s (N,) s -> bool (N,)
    """Which times are in a gap; the visible frames at its ends do not."""
    occluded = np.zeros(len(t_s), dtype=bool)
    for gap in gaps:
        after = t_s >= gap.start_s if gap.open_start else t_s > gap.start_s
        before = t_s <= gap.end_s if gap.open_end else t_s < gap.end_s
        occluded |= after & before
    return occluded


@dataclass(frozen=True)
class Gap:
    """A run of occluded frames, bounded by the visible frames beside it (IMU clock)."""

    start_s: float  # The last visible frame before the gap
    end_s: float  # The first visible frame after the gap; the end of the IMU where the gap is open there
    # That side has no visible frame, so the gap is recovered from the other side alone
    open_start: bool = False
    open_end: bool = False

    @property
    def length_s(self) -> float:
        """Duration, s."""
        return self.end_s - self.start_s


class Reason(NamedTuple):
    """A reason in a word and in words; both empty where nothing is wrong."""

    label: str
    words: str = ""

    @property
    def sentence(self) -> str:
        """As result files state it."""
        return f"{self.label}: {self.words}" if self.words else self.label

    @classmethod
    def of_sentence(cls, sentence: str) -> Reason:
        """The reason that a result file states."""
        label, _, words = sentence.partition(": ")
        return cls(label, words)


class Rejection(IntEnum):
    """Codes of the reasons that this version knows; 0 = nothing wrong."""

    NONE = 0
    FROZEN = 1
    JUMP = 2
    BONE = 3
    DIRECTION = 4
    RAY = 5
    STRAP = 6
    RESIDUAL = 7
    FAR = 8
    INTERPOLATED = 9
    CONTRADICTED = 10


#: The reasons by their code.
REASONS = (
    Reason(""),
    Reason("frozen", "the value repeats while the sensor moves"),
    Reason("jump", "far from its neighbours in time"),
    Reason("bone length", "elbow and wrist are too near or too far"),
    Reason("direction", "forearm more than 30 degrees off the inertial one"),
    Reason("viewing ray", "the forearm points at the camera and is misjudged"),
    Reason("strap", "off the elbow-wrist line or nearer the elbow"),
    Reason("residual", "does not agree with the recovered motion"),
    Reason("far away", "farther from the camera than it can see"),
    Reason("interpolated", "on a line or a cubic: a program filled a gap; not measured by the camera"),
    Reason("contradicted", "a block of samples that all the rest of the recording contradicts"),
)
