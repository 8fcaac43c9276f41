"""From a recording to the scenes that a baseline gets, and from its paths to a `Recovery`.

A baseline gets the graph's calibration, clock, accepted samples, gravity and gaps, and nothing of its path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..array_types import BoolArray, FloatArray, IntArray
from ..calibration import ArmCalibration
from ..cameras import join_cameras
from ..cameras.joining import FOREARM_M
from ..config import CameraNoise
from ..errors import SolveError
from ..linalg import interpolate
from ..measurements.alignment import VectorPairs, align, imu_positions, lever_of, pairs
from ..measurements.inertial import InertialSignal, inertial_attitude
from ..measurements.segment import FEWEST_SAMPLES, Segment
from ..measurements.timestamps import dejitter, split_at_pauses
from ..measurements.visibility import Gap, enough_joints, find_gaps, joints_needed, occluded_at
from ..recording import FOREARM_JOINTS, JOINTS, ImuStream, JointState, Recording
from ..result import Estimates, Recovery
from ..units import GRAVITY
from ..window.trajectory import joint_from_pose
from .orientation import attitude_by

#: The note of a path where a method has too little to begin with.
TOO_LITTLE_SEEN = "The camera saw too little of this segment."


@dataclass(frozen=True)
class Scene:
    """One segment as a baseline gets it; all times on the IMU's clock, all vectors in {K} unless said."""

    imu: ImuStream  # In {A}, the calibration's biases taken off
    R_K_A: FloatArray  # (n, 3, 3): orientation at the samples by the chosen filter, aligned to the camera
    attitude_sigma_rad: float  # One standard deviation of that orientation, per axis
    gravity: FloatArray  # (3,) m/s^2
    acceleration: FloatArray  # (n, 3) m/s^2: of the sensor, without gravity, from that orientation
    frame_t: FloatArray  # (f,) s: times of the camera frames, increasing
    joints: FloatArray  # (f, 5, 3) m: accepted joints in the order of `JOINTS`; nan where there is none
    camera_joints: FloatArray  # (f, 5, 3) m: whatever the camera stated, `inferred` included
    point: FloatArray  # (f, 3) m: the IMU at visible frames, the mean over joints of joint - R_K_A lever
    point_sigma_m: float  # Noise of `point`, per axis
    gaps: tuple[Gap, ...]  # The gaps inside
    calibration: ArmCalibration  # Lever arms and measures
    # Deviation of a white noise with the long-run variance of the noise of `point`, which has a memory
    point_effective_sigma_m: float = float("nan")
    rows: slice = field(default_factory=lambda: slice(None))  # Which of the recording's IMU samples these are

    @property
    def t(self) -> FloatArray:
        """(n,) times of the IMU's samples, s."""
        return self.imu.t_s

    @property
    def visible(self) -> BoolArray:
        """(f,) frames in which the forearm is visible."""
        return np.asarray(np.isfinite(self.point).all(axis=1))

    @property
    def visible_points(self) -> tuple[FloatArray, FloatArray]:
        """Times (v,) s and the IMU's positions (v, 3) m at the visible frames."""
        return finite_rows(self.frame_t, self.point)

    @property
    def occluded(self) -> BoolArray:
        """(n,) samples inside a gap."""
        return occluded_at(self.t, self.gaps)

    @property
    def shoulder(self) -> FloatArray:
        """(n, 3) shoulder at the samples, m, linear between accepted frames (Jatesiktat and Ang, II-K.4)."""
        return between(self.frame_t, self.joints[:, JOINTS.index("shoulder")], self.t)


@dataclass(frozen=True)
class Path:
    """A baseline's answer at the scene's IMU times, in {K}; nan where it has none."""

    position: FloatArray  # (n, 3) m: of the IMU
    velocity: FloatArray | None = None  # (n, 3) m/s: none where the method has none
    covariance: FloatArray | None = None  # (n, 3, 3) m^2: of the position; None where the method states none
    R_K_A: FloatArray | None = None  # (n, 3, 3): orientation; None where it is the scene's
    # (n, 3, 3) rad^2: Of the orientation's error as a rotation vector in {K}
    attitude_covariance: FloatArray | None = None
    # dict of (n, 3) m: By joint, where the method gets them otherwise than by pose and lever arm
    joints: dict[str, FloatArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each


#: A method: one scene in, its answer out.
Baseline = Callable[[Scene], Path]


def no_answer(scene: Scene) -> Path:
    """The path of a scene in which the camera saw too little to begin with."""
    return Path(np.full((len(scene.t), 3), np.nan), notes=(TOO_LITTLE_SEEN,))


def path_at(
    scene: Scene,
    rows: IntArray,  # (k,) of the scene's samples
    position: FloatArray,  # (k, 3) m and m/s
    velocity: FloatArray,
    variance: FloatArray,  # (k, 3) m^2: of each axis by itself; or (k, 3, 3)
    R_K_A: FloatArray | None = None,
    attitude_covariance: FloatArray | None = None,  # (k, 3, 3)
) -> Path:
    """A path that is known at some of a scene's samples."""
    covariance = variance if variance.ndim == 3 else variance[..., None] * np.eye(3)

    def at_rows(values: FloatArray | None, otherwise: FloatArray | float = np.nan) -> Any:
        if values is None:
            return None
        whole = np.full((len(scene.t), *values.shape[1:]), otherwise)
        whole[rows] = values
        return whole

    known = at_rows(position), at_rows(velocity), at_rows(covariance), at_rows(R_K_A, scene.R_K_A)
    return Path(*known, at_rows(attitude_covariance))


def finite_rows(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The times (f,) and values (f, 3) without the rows that have a nan."""
    finite = np.isfinite(values).all(axis=1)
    return t[finite], values[finite]


def between(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation (n, 3) between the finite rows of the values (f, 3), held beyond the ends."""
    t, values = finite_rows(t, values)
    return interpolate(t, values, at) if len(t) else np.full((len(at), 3), np.nan)


def of_best_camera(recording: Recording, graph: Recovery) -> tuple[Recording, Recovery]:
    """A recording and its recovery with the frames of the camera that saw the forearm most often, in {K}."""
    # a camera without depth gets places on its rays, by the forearm's length that the graph found
    if recording.arm.camera is None and (recording.cameras or recording.arm.pixel_rad is not None):
        levers = {} if graph.calibration is None else graph.calibration.lever_arms
        forearm_m = FOREARM_M
        if {"elbow", "wrist"} <= levers.keys():
            forearm_m = float(np.linalg.norm(levers["wrist"].position_m - levers["elbow"].position_m))
        recording, _ = join_cameras(recording, forearm_m=forearm_m)
    if graph.arm.camera is None or recording.arm.camera is None or len(graph.arm) != len(recording.arm):
        return recording, graph
    residuals = graph.residuals
    needed = joints_needed(graph.arm)
    used = recording.arm.state > 0 if residuals is None else np.asarray(residuals.used)
    rows = max(graph.arm.rows_by_camera, key=lambda own: int(enough_joints(used[own], needed).sum()))
    arm = replace(graph.arm.select(rows), camera=None)
    visible = enough_joints(used[rows], needed)
    gaps = find_gaps(np.asarray(arm.t_s), visible, float(graph.t_s[0]), float(graph.t_s[-1]))
    if residuals is not None:
        names = ("t_s", "residual", "used", "reason")
        residuals = replace(residuals, **{name: getattr(residuals, name)[rows] for name in names})
    own = replace(recording.arm.select(rows), camera=None)
    return replace(recording, arm=own), replace(graph, arm=arm, residuals=residuals, gaps=gaps)


#: How far the filter's vertical is off at any one frame, rad: {E} is tied to the graph's gravity.
VERTICAL_SIGMA_RAD = np.radians(0.5)


def scenes_of(recording: Recording, graph: Recovery, orientation: str = "vqf") -> list[Scene]:
    """The segments of a recording in which the graph answers, as a baseline gets them."""
    if len(graph) != len(recording.imu) or len(graph.arm) != len(recording.arm) or graph.residuals is None:
        raise SolveError(f"{recording.name}: what the baselines get is the result of another recording")
    answered = graph.answered
    scenes = []
    for samples in split_at_pauses(recording.imu):
        rows = samples.start + np.flatnonzero(answered[samples])
        if len(rows) >= FEWEST_SAMPLES:
            scenes.append(_scene(recording, graph, orientation, samples, slice(rows[0], rows[-1] + 1)))
    if not scenes:
        raise SolveError(f"{recording.name}: the IMU and a visible forearm never overlap")
    return scenes


def _scene(recording: Recording, graph: Recovery, orientation: str, samples: slice, rows: slice) -> Scene:
    """One segment; the filter goes from pause to pause, the scene has the rows with an answer."""
    assert graph.residuals is not None
    calibration, arm = graph.calibration or ArmCalibration(side=recording.side), recording.arm
    whole = recording.imu.select(samples)
    acc, gyro = (
        values if bias is None else values - bias
        for values, bias in (
            (whole.acc, calibration.accelerometer_bias),
            (whole.gyro, calibration.gyroscope_bias),
        )
    )
    whole = replace(whole, t_s=dejitter(whole.t_s), acc=acc, gyro=gyro)
    imu = whole.select(slice(rows.start - samples.start, rows.stop - samples.start))
    frames = (graph.arm.t_s >= imu.t_s[0]) & (graph.arm.t_s <= imu.t_s[-1])
    frame_t, used = graph.arm.t_s[frames], graph.residuals.used[frames]
    stated = arm.state[frames] != JointState.NOT_TRACKED
    camera_joints = np.where(stated[:, :, None], arm.position[frames], np.nan)
    # the camera's constant errors, that the lever arms go with
    errors = graph.estimates.joint_bias_m or {}
    joint_bias = np.array([errors.get(joint, np.zeros(3)) for joint in JOINTS])
    joints = np.where(used[:, :, None], camera_joints - joint_bias, np.nan)
    signal, down, needed = InertialSignal(whole), graph.gravity_direction, joints_needed(arm)
    bias = inertial_attitude(signal, whole.rate_hz).gyroscope_bias
    attitude = attitude_by(orientation, signal, whole, whole.rate_hz, bias)
    segment = Segment(
        signal=signal,
        attitude=attitude,
        frame_t_camera=frame_t,
        position=joints,
        accepted=used,
        reason=np.zeros(used.shape, np.uint8),
        down=down,
        needed=needed,
        frames=slice(0, len(frame_t)),
        start_s=float(whole.t_s[0]),
        end_s=float(whole.t_s[-1]),
    )
    # heading from what camera and IMU both saw, the vertical from the graph's gravity
    up_K, up_E = (np.tile(up, (len(frame_t), 1)) for up in (-down, np.array([0.0, 0.0, 1.0])))
    vertical = VectorPairs(frame_t, up_K, up_E, np.full(len(frame_t), VERTICAL_SIGMA_RAD**-2))
    both_saw = pairs(segment, frame_t, used, calibration)
    alignment = align([*both_saw, vertical], segment.start_s, segment.end_s, down)
    R_K_A, R_frames = ((alignment.at(t) * attitude.at(t)).as_matrix() for t in (imu.t_s, frame_t))
    attitude_sigma = np.sqrt(np.trace(alignment.covariance, axis1=1, axis2=2) / 3.0)
    gravity, estimates = GRAVITY * down, graph.estimates
    places, count = imu_positions(joints, used, R_frames, calibration)  # the mean over joints
    seen = (count > 0) & enough_joints(used, needed)
    return Scene(
        imu=imu,
        R_K_A=R_K_A,
        attitude_sigma_rad=float(np.median(attitude_sigma)),
        gravity=gravity,
        acceleration=np.einsum("nij,nj->ni", R_K_A, imu.acc) + gravity,
        frame_t=frame_t,
        joints=joints,
        camera_joints=camera_joints,
        point=np.where(seen[:, None], places, np.nan),
        point_sigma_m=_point_sigma(estimates.camera_sigma_m, used),
        gaps=tuple(gap for gap in graph.gaps if gap.end_s > imu.t_s[0] and gap.start_s < imu.t_s[-1]),
        calibration=calibration,
        point_effective_sigma_m=_point_sigma(estimates.camera_effective_sigma_m, used),
        rows=rows,
    )


def _point_sigma(sigma_m: dict[str, float] | None, used: BoolArray) -> float:
    """Noise of the mean over the joints that are usually seen, m per axis."""
    default = CameraNoise().joint_sigma_m
    usual = [joint for joint in FOREARM_JOINTS if used[:, JOINTS.index(joint)].mean() > 0.25]
    variances = [(sigma_m or {}).get(joint, default) ** 2 for joint in usual] or [default**2]
    return float(np.sqrt(np.sum(variances)) / len(variances))


#: What of the graph's figures a baseline gets, and its result repeats.
GRAPH_ESTIMATES = (
    *("camera_sigma_m", "camera_effective_sigma_m", "joint_bias_m", "joint_bias_sigma_m", "clock_given_s"),
    *("trusted", "reasons", "cautions", "cause", "remedies", "untrusted", "findings", "pairing"),
)
#: The note of every baseline's result.
GRAPH_NOTE = (
    "calibration, clock, gravity and what is occluded are the graph's, which every method to compare with is"
    " told; only the path between is this method's"
)


def recovery_of(
    recording: Recording,
    graph: Recovery,
    scenes: Sequence[Scene],
    paths: Sequence[Path],
    method: str,
    settings: dict[str, object] | None = None,
) -> Recovery:
    """A baseline's answer at every IMU sample; nan where it has none or states none."""
    assert graph.residuals is not None
    n, frames = len(recording.imu), len(graph.arm)
    names = [joint for joint in JOINTS if joint in recording.arm.present and joint != "strap"]
    recovery = replace(
        graph,
        method=method,
        t_s=recording.imu.t_s,
        position=np.full((n, 3), np.nan),
        quaternion=np.full((n, 4), np.nan),
        velocity=np.full((n, 3), np.nan),
        pose_covariance=np.full((n, 6, 6), np.nan),
        velocity_covariance=np.full((n, 3, 3), np.nan),
        joints={joint: np.full((n, 3), np.nan) for joint in names},
        joint_covariance={joint: np.full((n, 3, 3), np.nan) for joint in names},
        residuals=replace(
            graph.residuals, t_s=graph.arm.t_s, residual=np.full((frames, len(JOINTS), 3), np.nan)
        ),
        origin_ns=recording.origin_ns,
        side=recording.side,
        name=recording.name,
        notes=tuple(
            dict.fromkeys((*(note for path in paths for note in path.notes), GRAPH_NOTE, *graph.notes))
        ),
        estimates=Estimates(
            **{name: getattr(graph.estimates, name) for name in GRAPH_ESTIMATES}, further=settings or {}
        ),
    )
    for scene, path in zip(scenes, paths, strict=True):
        _write(recovery, recording, scene, path)
    return recovery


def _write(recovery: Recovery, recording: Recording, scene: Scene, path: Path) -> None:
    """Write a scene's path into its rows, from the scene's even times to the IMU's own stamps."""
    assert recovery.residuals is not None
    n, rows, frame_t = len(scene.t), scene.rows, recovery.arm.t_s
    stamps = recovery.t_s[rows]

    def at_stamps(values: FloatArray) -> FloatArray:
        return values if np.array_equal(scene.t, stamps) else interpolate(scene.t, values, stamps)

    R, unknown = scene.R_K_A if path.R_K_A is None else path.R_K_A, np.full((n, 3, 3), np.nan)
    place = unknown if path.covariance is None else path.covariance
    turn = unknown if path.attitude_covariance is None else path.attitude_covariance
    recovery.position[rows] = at_stamps(path.position)
    recovery.quaternion[rows] = _quaternion(scene.t, R, stamps)
    recovery.pose_covariance[rows] = at_stamps(_independent(place, turn))
    if path.velocity is not None:
        recovery.velocity[rows] = at_stamps(path.velocity)
    if path.attitude_covariance is None:  # the scene's orientation, with the sigma that the scene states
        turn = np.tile(np.eye(3) * scene.attitude_sigma_rad**2, (n, 1, 1))
    pose, levers = _independent(place, turn), {joint: lever_of(scene.calibration, joint) for joint in JOINTS}
    strap = levers["strap"]  # a path without orientation has the IMU's position alone
    joints = {"strap": path.position if strap is None or not strap.any() else path.position + R @ strap}
    for joint in recovery.joints:
        lever, known = levers[joint], scene.calibration.lever_arms.get(joint)
        joints[joint], covariance = path.joints.get(joint, unknown[:, 0]), unknown
        if joint not in path.joints and joint == "shoulder":
            joints[joint] = scene.shoulder
        elif joint not in path.joints and lever is not None:
            spread = None if known is None else np.diag(known.sigma_m**2)
            joints[joint], covariance = joint_from_pose(R, path.position, pose, lever, spread)
        recovery.joints[joint][rows] = at_stamps(joints[joint])
        recovery.joint_covariance[joint][rows] = at_stamps(covariance)
    frames = (frame_t >= scene.t[0]) & (frame_t <= scene.t[-1])
    for joint, position in joints.items():
        column = JOINTS.index(joint)
        at_frames = interpolate(scene.t, position, frame_t[frames])
        recovery.residuals.residual[frames, column] = recording.arm.position[frames, column] - at_frames


def _independent(place: FloatArray, turn: FloatArray) -> FloatArray:
    """(n, 6, 6) of position and orientation (n, 3, 3), independent; nan where one is unknown."""
    none = 0.0 * (place + turn)
    return np.block([[place, none], [none, turn]])


def _quaternion(t: FloatArray, R: FloatArray, stamps: FloatArray) -> FloatArray:
    """qw, qx, qy, qz (n, 4) at the stamps; nan where there is no orientation."""
    known = np.isfinite(R).all(axis=(1, 2))
    quaternion = np.full((len(stamps), 4), np.nan)
    if known.any():
        rotation = Rotation.from_matrix(R[known])
        if not np.array_equal(t, stamps):
            rotation = Slerp(t[known], rotation)(np.clip(stamps[known], t[known][0], t[known][-1]))
        quaternion[known] = rotation.as_quat(scalar_first=True)
    return quaternion
