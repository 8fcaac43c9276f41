"""Why a camera sample that calls itself tracked is rejected."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


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
    Reason("frozen", "the value stands still while the sensor moves"),
    Reason("jump", "far from its neighbours in time"),
    Reason("bone length", "elbow and wrist are too near or too far"),
    Reason("direction", "forearm more than 30 degrees off the inertial one"),
    Reason("viewing ray", "the forearm points at the camera and is misjudged"),
    Reason("strap", "off the elbow-wrist line or nearer the elbow"),
    Reason("residual", "does not agree with the recovered motion"),
    Reason("far away", "farther from the camera than it can see"),
    Reason("interpolated", "on a line or a cubic: a program filled a gap, no camera saw it"),
    Reason("contradicted", "a block of samples that all the rest of the recording contradicts"),
)
