"""The simulated motion: exact physics, plausible people, occlusions, IMUs on upper arm, trunk and others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation
from simulated_points import PointSimulation, simulate_point

from smoother.linalg import runs
from smoother.recording import Truth
from smoother.simulation import ArmSimulation, PeopleSimulation, SimulatedArm, simulate_arm, simulate_people

SEEDS = range(25)


@pytest.fixture(scope="module")
def people() -> list[SimulatedArm]:
    return [simulate_arm(ArmSimulation.preset("clean"), seed) for seed in SEEDS]


def rotations(truth: Truth) -> Rotation:
    return Rotation.from_quat(np.roll(truth.quaternion, -1, axis=1))


def integrate(simulated: SimulatedArm, begin: int, end: int, shift_s: float = 0.0) -> tuple[float, float]:
    """Error (m, rad) after strapdown integration from sample `begin` to `end`, stamps shifted by `shift_s`.

    The sums of averages are exact integrals at the ends of the samples; a quintic spline through them gives
    the momentary values.
    """
    imu, truth = simulated.ideal_imu, simulated.recording.truth
    step = 1.0 / imu.rate_hz
    edges = np.concatenate([[imu.t_s[0] - step / 2], imu.t_s + step / 2]) + shift_s
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"side": "left", "camera_frame": "optical"},
        {"wobble_deg": 3, "camera_frame": "zup", "imu_rate_hz": 200},
        {"protocol": "random", "duration_s": 20},
        None,
    ],
    ids=["left, optical", "wobbling strap, z up, 200 Hz", "random", "point"],
)
def test_integrated_samples_reproduce_the_truth(changes: dict | None):
    """Sub-millimetre over 2 s in motion: forces, rates, gravity, frames and stamps all agree."""
    if changes is None:
        simulated = simulate_point(PointSimulation.preset("clean", duration_s=20, tilt_deg=5), 4)
    else:
        simulated = simulate_arm(ArmSimulation.preset("clean", **({"repetitions": 1} | changes)), 1)
    rate = round(simulated.ideal_imu.rate_hz)
    for start_s in (3.7, 8.6, 11.5):  # the movements of `behind` (and any time of the others)
        begin = round(start_s * rate)
        position, attitude = integrate(simulated, begin, begin + 2 * rate)
        assert position < 0.5e-3
        assert attitude < 2e-4


def test_the_stamp_is_the_centre_of_the_sample():
    simulated = simulate_arm(ArmSimulation.preset("clean", repetitions=1), 0)
    begin = round(3.7 * 80)
    right = integrate(simulated, begin, begin + 160)[0]
    for half_sample in (-0.5 / 80, 0.5 / 80):
        assert integrate(simulated, begin, begin + 160, half_sample)[0] > 20 * right


def test_at_rest_the_accelerometer_shows_gravity_upwards():
    simulated = simulate_arm(ArmSimulation.preset("clean", still_all=True, repetitions=1), 0)
    acc, truth = simulated.recording.imu.acc, simulated.recording.truth
    up = rotations(truth).apply(acc)
    np.testing.assert_allclose(up, -np.tile(simulated.parameters["gravity"], (len(up), 1)), atol=1e-6)
    np.testing.assert_allclose(simulated.recording.imu.gyro, 0, atol=1e-9)
    np.testing.assert_allclose(np.ptp(truth.position, axis=0), 0, atol=1e-12)
    assert not simulated.occluded.any()


@pytest.mark.slow
def test_two_occlusions_a_repetition_of_one_to_three_seconds(people: list[SimulatedArm]):
    for person in people:
        gaps = runs(person.occluded)
        assert len(gaps) == 4
        for gap in gaps:
            assert 1.0 <= (gap.stop - gap.start) / 30 <= 3.0
        tracks, hidden = person.recording.arm, person.occluded
        for joint in ("wrist", "hand"):
            np.testing.assert_array_equal(tracks.tracked(joint), ~hidden)
        # The elbow may stay a little longer, never come back earlier.
        assert (tracks.tracked("elbow") & hidden).sum() <= 4 * 3
        assert tracks.tracked("shoulder").all()
        assert np.isnan(tracks.joint("wrist")[hidden]).all()


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


def test_camera_frames_are_the_same_motion_in_other_axes():
    kinect, optical, zup = (
        simulate_arm(
            ArmSimulation.preset("clean", repetitions=1, camera_frame=frame), 3
        ).recording.truth.position
        for frame in ("kinect", "optical", "zup")
    )
    np.testing.assert_allclose(optical, kinect * [-1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(zup, kinect[:, [2, 0, 1]], atol=1e-12)


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
    with pytest.raises(ValueError, match="8 places"):
        simulate_people(PeopleSimulation(sensors=10, on_table=1), CLEAN, 1)
