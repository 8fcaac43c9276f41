"""The held pose at a session's start: forearm raised beside the head, palm to the camera (JA II-H)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from smoother.array_types import BoolArray, FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import robust_sigma, unit
from smoother.recording import JOINTS, CameraFrame, ImuStream, Recording

#: The pose is held at least this long, and looked at for no longer than that, s.
SHORTEST_S, LONGEST_S = 0.8, 5.0
#: The sensor turns no faster than this while a pose is held, rad/s, averaged over this time, s.
STILL_RAD_S = 0.2
STILL_S = 0.25
#: A pose that was named is refused above this, rad/s (rms): simulated poses that are held reach 0.13.
MOVING_RAD_S = np.radians(30.0)
#: The gyroscope's bias is its median over this share of the recording, the quietest; what is larger than the
#: second is no bias, rad/s.
QUIET_SHARE, LARGEST_BIAS_RAD_S = 0.3, np.radians(30.0)
#: The forearm points up within this angle; neither part of the arm points this near to the camera.
UPRIGHT_RAD = np.radians(45.0)
NEAR_RAY_RAD = np.radians(50.0)
#: The wrist is not lower than this against the shoulder, m: about head level.
LOWEST_WRIST_M = -0.10
#: Single frames that are missing do not end the pose, s.
BRIDGE_S = 0.12
_NEEDED = ("shoulder", "elbow", "wrist")


@dataclass(frozen=True)
class HeldPose:
    """A stretch in which the pose is held, on the camera's clock.

    Attributes
    ----------
    start_s, end_s : float, s
    frames : ndarray of bool, shape (F,)
        The camera's frames in it with shoulder, elbow and wrist tracked.
    position : ndarray, shape (5, 3), m
        Mean of the joints in {K}; nan where a joint is not tracked.
    sigma_m : ndarray, shape (5,), m
        Of the mean, an axis: noise that lasts some tenths of a second.
    turning_rad_s : float, rad/s
        Rms of the sensor's angular velocity.
    chosen : str
        "found" or "given".
    """

    start_s: float
    end_s: float
    frames: BoolArray
    position: FloatArray
    sigma_m: FloatArray
    turning_rad_s: float
    chosen: str


#: Noise of the camera's joints has a memory of about this, s.
MEMORY_S = 0.5
FEWEST_FRAMES = 8


def find_held_pose(
    recording: Recording, from_s: float | None = None, to_s: float | None = None, offset_s: float = 0.0
) -> HeldPose:
    """The first held pose of a recording, or what is between two given times.

    Parameters
    ----------
    recording : Recording
        Arm with shoulder, elbow and wrist.
    from_s, to_s : float, s, optional
        On the camera's clock after the recording's origin; None to search.
    offset_s : float, s
        t_imu = t_camera + offset, as far as it is known.

    Returns
    -------
    HeldPose

    Raises
    ------
    CalibrationError
        No such pose, or the arm is not visible between the times given, or moves there.
    """
    t = recording.arm.t_s
    seen = np.all([recording.arm.tracked(joint) for joint in _NEEDED], axis=0)
    low, high = -np.inf if from_s is None else from_s, np.inf if to_s is None else to_s
    inside = seen & (t >= low) & (t <= high)
    if from_s is not None and to_s is not None:
        if inside.sum() < FEWEST_FRAMES:
            raise CalibrationError(
                f"{recording.name}: between {from_s:g} and {to_s:g} s shoulder, elbow and wrist are tracked"
                f" together in {int(inside.sum())} frames; {FEWEST_FRAMES} are needed"
            )
        pose = _pose(recording, inside, offset_s, "given")
        if pose.turning_rad_s > MOVING_RAD_S:
            raise CalibrationError(
                f"{recording.name}: between {from_s:g} and {to_s:g} s the sensor turns by"
                f" {np.degrees(pose.turning_rad_s):.0f} degrees/s, so no pose is held there; name times in"
                " which the arm is still, with --from and --to, or leave them out to have the pose found"
            )
        return pose
    good = inside & _held(recording, offset_s)
    runs = [run for run in _runs(t, good) if t[run[1]] - t[run[0]] >= SHORTEST_S]
    if not runs:
        raise CalibrationError(
            f"{recording.name}: no held pose was found (forearm raised beside the head, palm to the camera,"
            f" still for {SHORTEST_S:g} s, shoulder, elbow and wrist tracked); hold it at the start, or name"
            " its times with --from and --to"
        )
    first, last = runs[0]
    chosen = good & (t >= t[first]) & (t <= min(t[last], t[first] + LONGEST_S))
    return _pose(recording, chosen, offset_s, "found")


def upwards(recording: Recording) -> FloatArray | None:
    """(3,) rough direction of up in {K}; None where the recording does not say."""
    if recording.gravity_hint is not None:
        return -recording.gravity_hint
    return None if recording.camera_frame is None else -recording.camera_frame.down


def _held(recording: Recording, offset_s: float) -> BoolArray:
    """(F,) frames in which the arm is raised as asked for and the sensor is still."""
    arm, imu = recording.arm, recording.imu
    shoulder, elbow, wrist = (arm.joint(joint) for joint in _NEEDED)
    with np.errstate(invalid="ignore", divide="ignore"):
        along, upper, ray = unit(wrist - elbow), unit(elbow - shoulder), unit(elbow)
        good = _turning(recording, arm.t_s + offset_s) < STILL_RAD_S
        up = upwards(recording)
        if up is not None:
            good &= along @ up > np.cos(UPRIGHT_RAD)
            good &= (wrist - shoulder) @ up > LOWEST_WRIST_M
        if recording.camera_frame is not CameraFrame.ZUP:  # there the camera is not known to be the origin
            for part in (along, upper):
                good &= np.abs(np.einsum("ni,ni->n", part, ray)) < np.cos(NEAR_RAY_RAD)
    return np.asarray(good & (arm.t_s + offset_s >= imu.t_s[0]) & (arm.t_s + offset_s <= imu.t_s[-1]))


def _turning(recording: Recording, t: FloatArray) -> FloatArray:
    """(F,) rms angular velocity of the sensor about each time, rad/s, less the gyroscope's bias."""
    imu = recording.imu
    width = max(int(STILL_S * imu.rate_hz), 1)
    square = uniform_filter1d(np.sum((imu.gyro - _bias(imu)) ** 2, axis=1), width, mode="nearest")
    return np.sqrt(np.interp(t, imu.t_s, square))


def _bias(imu: ImuStream) -> FloatArray:
    """(3,) what the gyroscope shows in the recording's quietest part, rad/s; zero if no bias is so large.

    Quiet is where the angular velocity varies least, whatever it is about.
    """
    gyro = np.asarray(imu.gyro)
    width = max(int(SHORTEST_S * imu.rate_hz), 1)
    if len(gyro) < width:
        return np.zeros(3)
    mean = uniform_filter1d(gyro, width, axis=0, mode="nearest")
    varies = uniform_filter1d(np.sum((gyro - mean) ** 2, axis=1), width, mode="nearest")
    bias = np.median(gyro[varies <= np.quantile(varies, QUIET_SHARE)], axis=0)
    return bias if np.linalg.norm(bias) < LARGEST_BIAS_RAD_S else np.zeros(3)


def _runs(t: FloatArray, good: BoolArray) -> list[tuple[int, int]]:
    """First and last frame of runs of good frames; short gaps are bridged."""
    rows = np.flatnonzero(good)
    if not len(rows):
        return []
    cut = np.flatnonzero(np.diff(t[rows]) > BRIDGE_S)
    firsts = np.concatenate(([0], cut + 1))
    lasts = np.concatenate((cut, [len(rows) - 1]))
    return list(zip(rows[firsts].tolist(), rows[lasts].tolist(), strict=True))


def _pose(recording: Recording, frames: BoolArray, offset_s: float, chosen: str) -> HeldPose:
    arm = recording.arm
    t = arm.t_s[frames]
    position, sigma = np.full((len(JOINTS), 3), np.nan), np.full(len(JOINTS), np.nan)
    for k, joint in enumerate(JOINTS):
        rows = arm.joint(joint)[frames & arm.tracked(joint)]
        if len(rows) < FEWEST_FRAMES:
            continue
        position[k] = np.median(rows, axis=0)
        spread = robust_sigma(rows - position[k], axis=0)
        worth = max(float(np.ptp(t)) / MEMORY_S, 1.0)
        sigma[k] = float(np.sqrt(np.mean(spread**2) / min(worth, len(rows)))) * 1.25  # of a median
    turning = float(np.sqrt(np.mean(_turning(recording, t + offset_s) ** 2)))
    return HeldPose(float(t[0]), float(t[-1]), frames, position, sigma, turning, chosen)
