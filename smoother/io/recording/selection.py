"""What to take of a file that holds several, and what was taken."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypedDict

from .streams import ArmFrames, ImuSamples, PoseSamples

if TYPE_CHECKING:
    from ...runtime.store import Store


class Selection(TypedDict, total=False):
    """What to take of a file that holds several: keywords that readers hand on to `choose`.

    Attributes
    ----------
    imu, skeleton : str, optional
        Topic (or a part of it, or its frame_id).
    side : str, optional
        "left" or "right".
    body : int, optional
        The camera's number of the body.
    """

    imu: str | None
    skeleton: str | None
    side: str | None
    body: int | None


class FileReading(Selection, total=False):
    """How a file is read, and what of it: keywords that are handed on to `read_recording`.

    Attributes
    ----------
    store : Store, optional
        Where samples and frames are to lie.
    truth : bool
        False passes over the reference motion.
    swap_sides : bool
        The skeleton's left arm is the right one, and the other way round.
    """

    store: Store | None
    truth: bool
    swap_sides: bool


@dataclass
class StreamChoice:
    """What is to be used of a file.

    Attributes
    ----------
    imu : ImuSamples
        On the forearm.
    arm : ArmFrames
        The arm that it is on.
    side : str
        "left", "right" or "".
    base : ImuSamples, optional
        The IMU on the camera.
    truth : PoseSamples, optional
        The reference motion.
    notes : list of str
        How it was decided, one sentence each.
    upper : ImuSamples, optional
        The IMU on the same arm's upper arm.
    body : int, optional
        The camera's number of the person, where arms of several were chosen.
    """

    imu: ImuSamples
    arm: ArmFrames
    side: str
    base: ImuSamples | None = None
    truth: PoseSamples | None = None
    notes: list[str] = field(default_factory=list)
    upper: ImuSamples | None = None
    body: int | None = None
