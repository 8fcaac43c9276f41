"""Simulated arms: exact physics, plausible people, occlusions, IMUs everywhere, every error, motion capture.

A standard deviation estimated from n independent values scatters by 1 / sqrt(2 n) of itself; the tests allow
five times that or more, so that a change of random numbers does not break them.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from calib import read_calibration
from smoother.cli.run import run
from smoother.io import read_recording
from smoother.linalg import runs
from smoother.recording import JOINTS, CameraFrame, JointState, Truth
from smoother.simulation import (
    ArmSimulation,
    MocapSimulation,
    PeopleSimulation,
    Preset,
    SimulatedArm,
    capture,
    simulate_arm,
    simulate_people,
)
from smoother.simulation.mocap import MarkerCapture
from smoother.simulation.motion import optical_axes


def rotations(truth: Truth) -> Rotation:
    return Rotation.from_quat(np.roll(truth.quaternion, -1, axis=1))


def integrate(simulated: SimulatedArm, begin: int, end: int) -> tuple[float, float]:
    """Error (m, rad) after strapdown integration from sample `begin` to `end`.

    The sums of averages are exact integrals at the ends of the samples; a quintic spline through them gives
    the momentary values.
    """
    imu, truth = simulated.ideal_imu, simulated.recording.truth
    step = 1.0 / imu.rate_hz
    edges = np.concatenate([[imu.t_s[0] - step / 2], imu.t_s + step / 2])
    sums = np.concatenate([np.zeros((1, 6)), np.cumsum(np.hstack([imu.acc, imu.gyro]) * step, axis=0)])
    momentary = make_interp_spline(edges, sums, k=5).derivative()

    position = make_interp_spline(truth.t_s, truth.position, k=5)
    t0, t1 = truth.t_s[begin], truth.t_s[end]
    fine = 2000
    h = (t1 - t0) / fine
    middle = momentary(t0 + h * (np.arange(fine) + 0.5))
    turn = Rotation.from_rotvec(momentary(t0 + h * (np.arange(fine) + 0.5))[:, 3:] * h)
    half = Rotation.from_rotvec(middle[:, 3:] * h / 2)
    attitude = rotations(truth)[begin]
    p, v = position(t0), position.derivative()(t0)
    gravity = simulated.parameters["gravity"]
    for k in range(fine):
        a = (attitude * half[k]).apply(middle[k, :3]) + gravity
        p, v = p + h * v + h * h / 2 * a, v + h * a
        attitude = attitude * turn[k]
    off = (attitude.inv() * rotations(truth)[end]).magnitude()
    return float(np.linalg.norm(p - truth.position[end])), float(off)


@pytest.mark.parametrize(
    "changes",
    [
        {"side": "left", "camera_frame": "optical"},
        pytest.param({"wobble_deg": 3, "camera_frame": "zup", "imu_rate_hz": 200}, marks=pytest.mark.slow),
        pytest.param({"protocol": "random", "duration_s": 20}, marks=pytest.mark.slow),
    ],
    ids=["left, optical", "wobbling strap, z up, 200 Hz", "random"],
)
def test_integrated_samples_reproduce_the_truth(changes: dict):
    """Sub-millimetre over 2 s in motion: forces, rates, gravity, frames and stamps all agree."""
    simulated = simulate_arm(ArmSimulation.preset("clean", **({"repetitions": 1} | changes)), 1)
    rate = round(simulated.ideal_imu.rate_hz)
    for start_s in (3.7, 8.6, 11.5):  # the movements of `behind` (and any time of the others)
        begin = round(start_s * rate)
        position, attitude = integrate(simulated, begin, begin + 2 * rate)
        assert position < 0.5e-3
        assert attitude < 2e-4


def test_two_occlusions_a_repetition_of_one_to_three_seconds():
    simulated = simulate_arm(ArmSimulation.preset("clean", repetitions=1), 1)
    tracks, hidden = simulated.recording.arm, simulated.occluded
    gaps = runs(hidden)
    assert len(gaps) == 2 and all(30 <= gap.stop - gap.start <= 90 for gap in gaps)
    np.testing.assert_array_equal(tracks.tracked("wrist"), ~hidden)
    # the elbow may stay a little longer, never come back earlier
    assert (tracks.tracked("elbow") & hidden).sum() <= 2 * 3 and tracks.tracked("elbow")[~hidden].all()


@pytest.mark.parametrize("side", ["right", "left"])
def test_truth_fits_the_calibration(side: str):
    simulated = simulate_arm(ArmSimulation.preset("clean", side=side, repetitions=1), 5)
    truth, calibration = simulated.recording.truth, simulated.calibration
    assert truth is not None and calibration.upper_arm is not None and calibration.R_F_A is not None
    R_K_A = rotations(truth)
    for joint, lever in calibration.lever_arms.items():
        place = truth.position + R_K_A.apply(lever.position_m)
        np.testing.assert_allclose(place, truth.joints[joint], atol=1e-9)
    upper = np.linalg.norm(truth.joints["elbow"] - truth.joints["shoulder"], axis=1)
    np.testing.assert_allclose(upper, calibration.upper_arm.value_m, atol=1e-9)
    along = calibration.forearm_direction
    assert along is not None
    np.testing.assert_allclose(calibration.R_F_A @ along, [0, 1, 0], atol=1e-9)
    # In the first pose the palm faces the camera: the hand's back points away from it, the person's right
    # shoulder is on the camera's left (+x), the thumb of the right hand towards the head (-x).
    R_K_F = (R_K_A[40] * Rotation.from_matrix(calibration.R_F_A).inv()).as_matrix()
    assert R_K_F[2, 0] > 0.8
    assert R_K_F[1, 1] > 0.8
    outward = 1 if side == "right" else -1
    assert outward * truth.joints["shoulder"][:, 0].mean() > 0
    assert outward * truth.joints["elbow"][40, 0] > outward * truth.joints["shoulder"][40, 0] + 0.15
    assert R_K_F[0, 2] < -0.8  # on the left arm z is the little finger's side, so again -x


SHORT = {"protocol": "random", "duration_s": 8.0, "occlusion_lengths_s": ()}


def two_imu_arm(preset: str = "clean", **changes: object) -> SimulatedArm:
    return simulate_arm(
        ArmSimulation.preset(preset, **(SHORT | {"imus": "wrist,upper-arm"} | changes)), seed=5
    )


@pytest.mark.parametrize("side", ["left", "right"])
def test_elbow_and_shoulder_are_constant_in_its_axes(side: str) -> None:
    made = two_imu_arm(side=side)
    t = np.linspace(0.5, 7.0, 30)
    R, position = made.further_motions["upper_arm"].imu_pose(t)
    joints = made.motion.joints(t)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    for joint, lever in made.calibration.upper_imu.items():
        np.testing.assert_allclose(position + R @ lever.position_m, joints[joint], atol=1e-9)
    # the bone's axes: y from the elbow to the shoulder, z towards the lateral epicondyle
    bone = R @ made.calibration.R_U_B.T
    along = joints["shoulder"] - joints["elbow"]
    np.testing.assert_allclose(bone[:, :, 1], along / np.linalg.norm(along, axis=1)[:, None], atol=1e-9)
    np.testing.assert_allclose(bone[:, :, 2], made.motion.bone_axes(t)[0], atol=1e-9)  # type: ignore[attr-defined]


def trunk_arm(**changes: object) -> SimulatedArm:
    settings = {"imus": "wrist,upper-arm,trunk", "protocol": "random", "duration_s": 12.0}
    return simulate_arm(ArmSimulation.preset("clean", **(settings | changes)), seed=3)


def test_a_trunk_that_stands_still_changes_nothing_else() -> None:
    with_trunk, without = trunk_arm(), trunk_arm(imus="wrist,upper-arm")
    for name in ("imu", "upper_imu"):
        one, other = getattr(with_trunk.recording, name), getattr(without.recording, name)
        np.testing.assert_array_equal(one.acc, other.acc)
        np.testing.assert_array_equal(one.gyro, other.gyro)
    np.testing.assert_array_equal(with_trunk.recording.arm.position, without.recording.arm.position)
    assert without.recording.trunk is None and without.trunk_motion is None
    trunk = with_trunk.recording.trunk
    assert trunk is not None and with_trunk.trunk_motion is not None
    np.testing.assert_allclose(trunk.imu.gyro, 0.0, atol=1e-9)
    down = with_trunk.trunk_motion.imu_pose(np.zeros(1))[0][0].T @ with_trunk.parameters["gravity"]
    np.testing.assert_allclose(trunk.imu.acc, np.tile(-down, (len(trunk.imu), 1)), atol=1e-6)


CLEAN = ArmSimulation.preset("clean", protocol="random", duration_s=6.0, imu_rate_hz=50)


def test_counts_and_names() -> None:
    scene = simulate_people(PeopleSimulation(people=3, sensors=6, on_table=2), CLEAN, 1)
    assert len(scene.arms) == 6 and {(body, side) for body, side, _ in scene.arms} == {
        (body, side) for body in range(3) for side in ("left", "right")
    }
    places = list(scene.truth.values())
    assert list(scene.truth) == [f"/imu/sensor_{k}" for k in range(1, 7)]
    assert places.count((None, "none")) == 2 and len(set(places)) == 5


SHOULDER, ELBOW, WRIST, HAND, STRAP = range(5)


def make(seed: int = 0, **changes: Any) -> SimulatedArm:
    """A minute and a half of random motion without any error but those given."""
    defaults = {"protocol": "random", "duration_s": 90.0, "occlusion_lengths_s": ()}
    return simulate_arm(ArmSimulation.preset("clean", **{**defaults, **changes}), seed)


def residual(simulated: SimulatedArm, latency_s: float = 0.0) -> np.ndarray:
    """(F, 4, 3) camera minus truth at the moment of exposure, frames near the ends left out."""
    tracks, truth = simulated.recording.arm, simulated.recording.truth
    moment = tracks.t_s - latency_s
    inside = (moment > 0.2) & (moment < truth.t_s[-1] - 0.2)
    at = [make_interp_spline(truth.t_s, truth.joints[joint], k=5)(moment[inside]) for joint in JOINTS[:4]]
    return tracks.position[inside, :4] - np.stack(at, axis=1)


def test_clean_is_clean_and_late_stamps_are_an_offset():
    simulated, late = make(), make(latency_s=0.02)
    np.testing.assert_allclose(residual(simulated), 0, atol=2e-5)  # the test's own interpolation
    for sensor in ("acc", "gyro"):
        measured, ideal = getattr(simulated.recording.imu, sensor), getattr(simulated.ideal_imu, sensor)
        np.testing.assert_array_equal(measured, ideal)
    np.testing.assert_allclose(np.diff(simulated.recording.arm.t_s), 1 / 30, atol=1e-9)
    assert (simulated.recording.arm.state[:, :4] == JointState.TRACKED).all()
    assert late.parameters["clock_offset_s"] == -0.02  # t_imu = t_camera + offset
    np.testing.assert_allclose(residual(late, latency_s=0.02), 0, atol=2e-5)
    assert residual(late)[:, WRIST].std() > 0.005  # half a metre a second for 20 ms


def test_depth_noise_lies_along_the_ray_and_grows_with_distance():
    sigma = {}
    for distance in (1.5, 3.0):
        simulated = make(noise_depth_m=0.01, distance_m=distance)
        noise, place = residual(simulated), simulated.recording.truth.joints["shoulder"].mean(axis=0)
        true_distance = np.linalg.norm(place)
        along = noise[:, SHOULDER] @ (place / true_distance)
        across = noise[:, SHOULDER] - along[:, None] * place / true_distance
        assert across.std() < 0.05 * along.std()  # the shoulder sways a little off its mean ray
        assert along.std() == pytest.approx(0.01 * (true_distance / 2) ** 2, rel=0.1)
        sigma[distance] = along.std()
    assert sigma[3.0] > 3 * sigma[1.5]


def test_constant_errors_are_told():
    biases, scales, crosses = [], [], []
    for seed in range(30):
        simulated = make(seed, joint_bias_m=0.008, imu_scale=0.003, imu_misalignment_deg=0.2, duration_s=3)
        off = residual(simulated)
        for column, joint in enumerate(JOINTS[:4]):
            told = simulated.parameters["joint_bias"][joint]
            np.testing.assert_allclose(off[:, column], np.tile(told, (len(off), 1)), atol=5e-5)
            biases.append(told)
        for sensor, name in (("accelerometer", "acc"), ("gyroscope", "gyro")):
            matrix = simulated.parameters[f"{sensor}_matrix"]
            measured, true = getattr(simulated.recording.imu, name), getattr(simulated.ideal_imu, name)
            np.testing.assert_allclose(measured, true @ matrix.T, atol=1e-12)
            scales.extend(np.diag(matrix) - 1)
            crosses.extend(matrix[~np.eye(3, dtype=bool)])
    assert np.std(biases) == pytest.approx(0.008, rel=0.2)  # 360 values
    assert np.std(scales) == pytest.approx(0.003, rel=0.25)  # 180 values
    assert np.std(crosses) == pytest.approx(np.radians(0.2), rel=0.2)


def test_outliers_and_noise():
    simulated = make(outliers=0.02, outlier_m=0.3, occlusion_lengths_s=(1.0,))
    off = np.linalg.norm(residual(simulated), axis=2)
    wrong = off > 0.01
    assert wrong.sum() / np.isfinite(off).sum() == pytest.approx(0.02, abs=0.006)  # sigma 0.0014
    np.testing.assert_allclose(off[wrong], 0.3, atol=1e-3)
    assert simulated.parameters["outliers"] >= wrong.sum()
    noisy = make(accelerometer_noise=0.003, gyroscope_noise=0.0003, imu_rate_hz=100)
    imu, ideal = noisy.recording.imu, noisy.ideal_imu
    np.testing.assert_allclose((imu.acc - ideal.acc).std(axis=0), 0.003 * 10, rtol=0.05)
    np.testing.assert_allclose((imu.gyro - ideal.gyro).std(axis=0), 0.0003 * 10, rtol=0.05)


@pytest.mark.parametrize("side", ["right", "left"])
def test_swapped_arms_are_the_other_arm_and_say_tracked(side: str):
    simulated = simulate_arm(ArmSimulation.preset("white", swapped_gaps=1.0, side=side), 0)
    assert len(simulated.parameters["swapped"]) == 4
    tracks, outward = simulated.recording.arm, 1 if side == "right" else -1
    for gap in runs(simulated.occluded):
        assert (tracks.state[gap, ELBOW : HAND + 1] == JointState.TRACKED).all()
        across = tracks.joint("shoulder")[gap, 0] - tracks.joint("wrist")[gap, 0]
        assert (outward * across > 0.2).all()
        assert (tracks.joint("wrist")[gap, 1] < tracks.joint("shoulder")[gap, 1] - 0.35).all()


@pytest.mark.slow
@pytest.mark.parametrize("preset", list(Preset))
def test_a_seed_is_a_recording_and_errors_do_not_change_the_motion(preset: Preset):
    config = ArmSimulation.preset(preset, repetitions=1, wobble_deg=0.0)
    one, again, other = simulate_arm(config, 7), simulate_arm(config, 7), simulate_arm(config, 8)
    for stream, names in (("imu", ("t_s", "acc", "gyro")), ("arm", ("t_s", "position", "state"))):
        for name in names:
            first, second = (getattr(getattr(made.recording, stream), name) for made in (one, again))
            np.testing.assert_array_equal(first, second)
    assert not np.array_equal(one.recording.imu.acc[:100], other.recording.imu.acc[:100])
    clean = simulate_arm(ArmSimulation.preset("clean", repetitions=1), 7)
    np.testing.assert_array_equal(clean.recording.truth.position, one.recording.truth.position)
    np.testing.assert_array_equal(clean.ideal_imu.acc, one.ideal_imu.acc)


@pytest.mark.parametrize("seed", [0, 1])
def test_another_person_may_take_longer_or_not_so_long(seed: int):
    config = ArmSimulation.preset("white", repetitions=1, cameras=(60.0,), camera_fault="other_person")
    (camera,) = simulate_arm(config, seed).recording.cameras
    assert len(camera.arm) > 300
    assert np.isfinite(camera.arm.joint("shoulder")).all()


@pytest.mark.parametrize("frame", ["kinect", "optical", "zup"])
def test_a_further_camera_without_depth_sees_the_arm(frame: str):
    simulated = make(duration_s=8.0, camera_frame=frame, cameras=(60.0,), rgb="further")
    (camera,) = simulated.recording.cameras
    assert (camera.arm.state[:, [SHOULDER, ELBOW, WRIST]] == JointState.TRACKED).mean() > 0.5


EXACT = MocapSimulation(marker_noise_m=0.0, marker_lost=0.0)
#: Axes (x right, y down, z forward) in the axes of each frame, written out from their definitions.
RIGHT_DOWN_FORWARD = {
    CameraFrame.KINECT: [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    CameraFrame.OPTICAL: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    CameraFrame.ZUP: [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
}


def simulated(
    side: str = "right", frame: CameraFrame = CameraFrame.KINECT, wobble: float = 0.0
) -> SimulatedArm:
    config = ArmSimulation.preset(
        "clean", protocol="random", duration_s=8, side=side, camera_frame=frame, wobble_deg=wobble
    )
    return simulate_arm(config, 11)


def in_camera(marks: MarkerCapture, arm: SimulatedArm) -> dict[str, np.ndarray]:
    """Markers (N, 3) by name in the recording's camera frame."""
    optical = marks.position @ marks.R_C_E.T + marks.translation_m
    axes = np.array(RIGHT_DOWN_FORWARD[arm.recording.camera_frame], float)  # rows: the axes
    place = optical @ axes
    return {name: place[:, number] for number, name in enumerate(marks.names)}


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("frame", list(CameraFrame))
def test_means_of_markers_are_joint_centres(side, frame):
    arm = simulated(side, frame, wobble=2.0)
    marks = capture(arm, EXACT, 4)
    t_imu = marks.t_s * (1 + 1e-6 * marks.skew_ppm) + marks.offset_s
    inside = (t_imu > 0) & (t_imu < 8)
    assert inside.sum() > 900
    truth = arm.motion.joints(t_imu[inside])
    seen = in_camera(marks, arm)
    for joint, names in marks.marker_map.items():
        mean = np.mean([seen[name][inside] for name in names], axis=0)
        true = arm.motion.imu_pose(t_imu[inside])[1] if joint == "imu_plate" else truth[joint]
        np.testing.assert_allclose(mean, true, atol=1e-9)


@pytest.mark.parametrize("side", ["left", "right"])
def test_markers_are_where_anatomy_has_them(side):
    arm = simulate_arm(ArmSimulation.preset("clean", protocol="hang", duration_s=3, side=side), 2)
    marks = capture(arm, EXACT, 0)
    seen = in_camera(marks, arm)
    outwards = -1.0 if side == "left" else 1.0  # the person faces a Kinect, whose x is the person's right
    across = (seen["EL_LAT"] - seen["EL_MED"]).mean(axis=0)
    assert across[0] * outwards > 0.05
    thumb = (seen["WR_RAD"] - seen["WR_ULN"]).mean(axis=0)
    assert thumb[2] < -0.03  # towards the camera


@pytest.mark.parametrize("frame", list(CameraFrame))
def test_the_frame_of_the_mocap_has_z_up(frame):
    arm = simulated(frame=frame)
    marks = capture(arm, EXACT, 9)
    gravity = marks.R_C_E.T @ optical_axes(frame).T @ arm.parameters["gravity"]
    np.testing.assert_allclose(gravity, [0, 0, -9.81], atol=1e-9)
    assert np.linalg.det(marks.R_C_E) == pytest.approx(1)
    rotation = Rotation.from_quat(marks.extrinsics["rotation"], scalar_first=True)
    np.testing.assert_allclose(rotation.as_matrix(), marks.R_C_E, atol=1e-12)
    np.testing.assert_allclose(optical_axes(frame).T, RIGHT_DOWN_FORWARD[frame])


def test_noise_and_lost_markers_are_as_asked():
    arm = simulated()
    clean = capture(arm, EXACT, 4)
    noisy = capture(arm, MocapSimulation(marker_noise_m=0.001, marker_lost=0.0), 4)
    # 1000 frames x 45 numbers: the standard deviation is known to 0.4 %.
    assert (noisy.position - clean.position).std() == pytest.approx(0.001, rel=0.02)
    lost = np.isnan(capture(arm, MocapSimulation(marker_lost=0.2), 4).position)
    assert (lost.any(axis=2) == lost.all(axis=2)).all()
    share = lost[..., 0].mean(axis=0)
    assert (share > 0).all()
    assert share.mean() == pytest.approx(0.18, abs=0.05)  # stretches may lie over each other


DATA = Path(__file__).parents[2] / "data"


def test_the_command_that_is_told_still_makes_the_demo(tmp_path: Path):
    lines = (DATA / "README.md").read_text(encoding="utf-8").splitlines()
    (line,) = (line for line in lines if line.startswith("unocclude simulate"))
    assert run([part.replace("data/", f"{tmp_path}/") for part in shlex.split(line)[1:]]) == 0
    kept, made = (read_recording(each / "demo.mcap") for each in (DATA, tmp_path))
    for stream, names in (
        ("imu", ("t_s", "acc", "gyro")),
        ("arm", ("t_s", "position", "state")),
        ("truth", ("position", "quaternion")),
    ):
        for name in names:
            old, new = (getattr(getattr(one, stream), name) for one in (kept, made))
            # another processor may round the last digits differently
            np.testing.assert_allclose(new, old, rtol=0, atol=2e-9)
    assert kept.side == made.side == "right"
    old, new = (read_calibration(each / "demo_calibration.toml").arm("right") for each in (DATA, tmp_path))
    assert old.upper_arm.value_m == pytest.approx(new.upper_arm.value_m, abs=1e-12)
    for joint in ("elbow", "wrist", "hand"):
        levers = (one.lever_arms[joint].position_m for one in (old, new))
        np.testing.assert_allclose(*levers, rtol=0, atol=1e-12)
    assert sum(path.stat().st_size for path in DATA.iterdir()) < 1_000_000
