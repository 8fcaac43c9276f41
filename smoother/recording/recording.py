"""One arm seen by a depth camera, the IMU on its forearm, and what else was recorded with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..errors import RecordingError
from .streams import JOINTS, Camera, CameraFrame, ImuStream, JointState, JointTracks, Truth

#: What `Recording.crop` cuts.
Cropped = TypeVar("Cropped", ImuStream, JointTracks, Truth)


def arm_words(side: str, body: int | None) -> str:
    """Which arm, in words: "right arm of body 2"; without a side "arm"."""
    return f"{side + ' ' if side else ''}arm{'' if body is None else f' of body {body}'}"


class ImportNote(str):
    """A note of a recording's file: its import said it; `unocclude info` repeats it, no other command."""

    __slots__ = ()


@dataclass(frozen=True)
class TrunkSensors:
    """An IMU on the trunk, and what the camera sees of the trunk besides the arm's own shoulder."""

    imu: ImuStream  # On the breastbone or the back, on a clock of its own, in its own axes {D}
    other_arm: JointTracks | None = None  # Whose shoulder counts; None where the skeleton has none


@dataclass(frozen=True, repr=False)
class Recording:
    """One arm, the IMU on its forearm, and what else was recorded with them.

    Attributes
    ----------
    imu : ImuStream
        The forearm IMU.
    arm : JointTracks
        The camera's joints of that arm.
    side : str
        "left", "right", or "" where the recording does not say (`strap` alone).
    camera_frame : CameraFrame, optional
        The convention of the camera's axes.
    gravity_hint : ndarray, shape (3,), optional
        Direction of down in {K}, good to some degrees.
    base_imu : ImuStream, optional
        An IMU fixed to the camera.
    truth : Truth, optional
        Reference motion, used by validation only.
    origin_ns : int, ns
        What the times count from (0 or a Unix time).
    name : str
        What to call the recording in messages (its file's name).
    notes : tuple of str
        What was dropped or decided on reading, one sentence each.
    gravity_sigma_rad : float, rad, optional
        How well `gravity_hint` is known, per axis; to some degrees where None.
    further_imus : mapping of str to ImuStream
        IMUs on other segments of the same arm (`body.SEGMENTS`: "upper_arm"), each on a clock of its own, in
        its own axes.
    body : int, optional
        The camera's number of the person, where several are told apart.
    trunk : TrunkSensors, optional
        An IMU on the same person's trunk.
    opposite : JointTracks, optional
        The camera's joints of the same person's other arm, on the camera's clock as it was recorded.
    applied_fixes : tuple of str
        Mistakes of the set-up that were undone in it, as options: "--mirror x".
    clocks_unrelated : bool
        The IMU's clock and the camera's have nothing in common (files of two devices that each count from
        zero): the motion has to prove that they belong together.
    cameras : tuple of Camera
        Further cameras that saw the same arm, each on a clock and in a frame of its own; `arm` is the first
        one's, in whose frame results stand.
    """

    imu: ImuStream
    arm: JointTracks
    side: str = ""
    camera_frame: CameraFrame | None = None
    gravity_hint: FloatArray | None = None
    base_imu: ImuStream | None = None
    truth: Truth | None = None
    origin_ns: int = 0
    name: str = "recording"
    notes: tuple[str, ...] = ()
    gravity_sigma_rad: float | None = None
    further_imus: Mapping[str, ImuStream] = field(default_factory=dict)
    body: int | None = None
    trunk: TrunkSensors | None = None
    applied_fixes: tuple[str, ...] = ()
    clocks_unrelated: bool = False
    opposite: JointTracks | None = None
    cameras: tuple[Camera, ...] = ()

    @property
    def arm_label(self) -> str:
        """Which arm, in words: "right arm of body 2"; without a side "arm"."""
        return arm_words(self.side, self.body)

    @property
    def upper_imu(self) -> ImuStream | None:
        """The IMU on the same arm's upper arm; None without one."""
        return self.further_imus.get("upper_arm")

    def with_imu(self, segment: str, imu: ImuStream | None) -> Recording:
        """The same with another IMU on a segment beyond the forearm ("upper_arm"); without it where None."""
        others = {name: stream for name, stream in self.further_imus.items() if name != segment}
        return replace(self, further_imus=others if imu is None else others | {segment: imu})

    def crop(self, from_s: float | None = None, to_s: float | None = None) -> Recording:
        """A part of the recording by time; `unocclude cut` does the same to a file.

        Times stay what they are, so that gaps and results of the part are those of the whole. Each stream is
        cut on its own clock: where IMU and camera are seconds apart, so are their ends.

        Parameters
        ----------
        from_s, to_s : float, s
            On the recording's axis (`imu.t_s`); the recording's own start or end where None.

        Returns
        -------
        Recording

        Raises
        ------
        RecordingError
            No IMU sample or no frame is left.
        """
        start_s, end_s = -np.inf if from_s is None else from_s, np.inf if to_s is None else to_s

        def cut(stream: Cropped) -> Cropped:
            return stream.select(slice(*np.searchsorted(stream.t_s, [start_s, end_s]).tolist()))

        def cut_if_there(stream: Cropped | None) -> Cropped | None:
            return None if stream is None else cut(stream)

        trunk = self.trunk
        part = replace(
            self,
            imu=cut(self.imu),
            arm=cut(self.arm),
            base_imu=cut_if_there(self.base_imu),
            truth=cut_if_there(self.truth),
            further_imus={name: cut(imu) for name, imu in self.further_imus.items()},
            trunk=trunk and TrunkSensors(cut(trunk.imu), cut_if_there(trunk.other_arm)),
            opposite=cut_if_there(self.opposite),
            cameras=tuple(camera.with_arm(cut(camera.arm)) for camera in self.cameras),
        )
        if not (start_s < end_s and len(part.imu) and len(part.arm)):
            first, last = (self.imu.t_s[0], self.imu.t_s[-1]) if len(self.imu) else (np.nan, np.nan)
            raise RecordingError(
                f"{self.name}: nothing is left between {start_s:g} and {end_s:g} s; the recording lasts from"
                f" {first:.1f} to {last:.1f} s"
            )
        return part

    def __repr__(self) -> str:
        return "\n  ".join(self._lines())

    def _lines(self) -> list[str]:
        """Whose arm, how long, the streams, the joints, what else there is."""
        imu, arm = self.imu, self.arm
        length_s = float(imu.t_s[-1] - imu.t_s[0]) if len(imu) else 0.0
        side = f", {self.side} arm" if self.side else ""
        share = 100 * arm.forearm_tracked.mean() if len(arm) else 0.0
        more = {
            "a magnetometer": imu.mag is not None,
            **{f"an IMU on the {name.replace('_', ' ')}": True for name in self.further_imus},
            "one on the trunk": self.trunk is not None,
            "an IMU on the camera": self.base_imu is not None,
            "truth": self.truth is not None,
        }
        lines = [
            f"Recording {self.name}{side}: {length_s:.1f} s",
            f"IMU {imu.name}: {len(imu)} samples at {imu.rate_hz:.1f} Hz",
            f"camera {arm.name}: {len(arm)} frames at {arm.rate_hz:.1f} Hz, forearm tracked in {share:.0f} %",
            f"joints {', '.join(arm.present) or 'none'}",
        ]
        if any(more.values()):
            lines.append(f"with {', '.join(name for name, is_there in more.items() if is_there)}")
        return lines

    @classmethod
    def from_arrays(
        cls,
        imu_t_s: FloatArray,
        acc: FloatArray,
        gyro: FloatArray,
        frame_t_s: FloatArray,
        joints: Mapping[str, FloatArray],
        *,
        states: Mapping[str, NDArray] | None = None,
        mag: FloatArray | None = None,
        side: str = "",
        camera_frame: CameraFrame | str | None = None,
        gravity_hint: FloatArray | None = None,
        truth: Truth | None = None,
        name: str = "recording",
        upper_imu: ImuStream | None = None,
        hand_imu: ImuStream | None = None,
    ) -> Recording:
        """Build a recording from arrays, in SI units.

        Parameters
        ----------
        imu_t_s : array_like, shape (N,), s
            The IMU's stamps, increasing, on its own clock: centres of the intervals that samples average.
        acc : array_like, shape (N, 3), m/s^2
            Specific force in the sensor's axes (at rest about +9.81 upwards).
        gyro : array_like, shape (N, 3), rad/s
            Angular velocity in the sensor's axes.
        frame_t_s : array_like, shape (F,), s
            The camera's stamps, increasing, on its own clock.
        joints : mapping of str to array_like, shape (F, 3), m
            Positions in the camera's frame by name (shoulder, elbow, wrist, hand, strap); nan where the
            camera has none.
        states : mapping of str to array_like of int, shape (F,), optional
            `JointState` values by joint; without them a joint is tracked where its position is finite.
        mag : array_like, shape (N, 3), optional
            Magnetic field.
        side : str
            "left", "right" or "".
        camera_frame : CameraFrame or str, optional
            "kinect", "optical" or "zup".
        gravity_hint : array_like, shape (3,), optional
            Direction of down in the camera's frame.
        truth : Truth, optional
            Reference motion, for validation.
        name : str
            For messages.
        upper_imu, hand_imu : ImuStream, optional
            The samples of an IMU on the upper arm, and of one on the hand.

        Raises
        ------
        RecordingError
            A shape does not fit, a joint has another name, times do not increase, or samples are not finite.
        """
        imu = _checked_imu(ImuStream("imu", imu_t_s, acc, gyro, mag), "", name)
        if side not in ("", "left", "right"):
            raise RecordingError(f"{name}: the side is left or right, not {side}")
        if camera_frame not in (None, *CameraFrame):
            names = ", ".join(CameraFrame)
            raise RecordingError(f"{name}: the camera's frame is one of {names}, not {camera_frame}")
        frame = None if camera_frame is None else CameraFrame(camera_frame)
        arm = _joints_of(_times_of(frame_t_s, "frame_t_s", name), joints, states or {}, name)
        hint = None if gravity_hint is None else _rows(gravity_hint, (3,), "gravity_hint", name, finite=True)
        if hint is not None and not 1e-6 < np.linalg.norm(hint) < 1e6:
            raise RecordingError(f"{name}: gravity_hint is not a direction; give the direction of down")
        further = {
            segment: _checked_imu(stream, f"the {segment.replace('_', ' ')}'s ", name)
            for segment, stream in (("upper_arm", upper_imu), ("hand", hand_imu))
            if stream is not None
        }
        return cls(imu, arm, side, frame, hint, truth=truth, name=name, further_imus=further)


def _times_of(values: FloatArray, what: str, name: str) -> FloatArray:
    """Times (n,), at least two, that increase; `what` they are for the message."""
    t = _rows(values, np.shape(values)[:1] or (0,), what, name, finite=True)
    if len(t) < 2 or not (np.diff(t) > 0).all():
        raise RecordingError(f"{name}: {what} must contain at least two times that increase")
    return t


def _checked_imu(imu: ImuStream, whose: str, name: str) -> ImuStream:
    """An IMU with arrays that fit each other; `whose` it is for the message."""
    t = _times_of(imu.t_s, f"{whose or 'imu_'}t_s", name)
    acc, gyro = (
        _rows(values, (len(t), 3), f"{whose}{what}", name, finite=True)
        for what, values in (("acc", imu.acc), ("gyro", imu.gyro))
    )
    mag = None if imu.mag is None else _rows(imu.mag, (len(t), 3), f"{whose}mag", name)
    return replace(imu, t_s=t, acc=acc, gyro=gyro, mag=mag)


def _joints_of(
    t: FloatArray, joints: Mapping[str, FloatArray], states: Mapping[str, NDArray], name: str
) -> JointTracks:
    """Joints by name at checked times (n,); tracked where they are finite, if states are not given."""
    unknown = sorted({*joints, *states} - set(JOINTS))
    if unknown:
        raise RecordingError(f"{name}: {unknown[0]} is not a joint; joints are {', '.join(JOINTS)}")
    position = np.full((len(t), len(JOINTS), 3), np.nan)
    state = np.zeros((len(t), len(JOINTS)), np.int8)
    for joint, values in joints.items():
        column = JOINTS.index(joint)
        position[:, column] = _rows(values, (len(t), 3), joint, name)
        state[np.isfinite(position[:, column]).all(axis=1), column] = JointState.TRACKED
    for joint, values in states.items():
        state[:, JOINTS.index(joint)] = _rows(values, (len(t),), f"the state of {joint}", name)
    state[~np.isfinite(position).all(axis=2)] = JointState.NOT_TRACKED
    return JointTracks("camera", t, position, state)


def _rows(
    values: FloatArray, shape: tuple[int, ...], what: str, name: str, finite: bool = False
) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise RecordingError(f"{name}: {what} has the shape {array.shape}; it must be {shape}")
    if finite and not np.isfinite(array).all():
        raise RecordingError(f"{name}: {what} contains values that are not finite; take those samples out")
    return array
