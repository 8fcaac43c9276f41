"""A panel session: what its IMUs measure, and the files it is written to."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.cli.run import run
from smoother.io.mcap.container import Container
from smoother.io.recording.read import open_recording
from smoother.io.wire.schemas import message_class
from smoother.simulation.panel import PanelSimulation, SimulatedPanel, simulate_panel
from smoother.simulation.panel.simulate import FIELD_W

SMALL = ["--width", "128", "--height", "106", "--focal-px", "91", "--distortion=0,0,0,0,0"]


@pytest.fixture(scope="module")
def clean() -> SimulatedPanel:
    config = PanelSimulation.ideal(
        poses=3, camera_tilt_deg=25, magnetometer=True, width=128, height=106, focal_px=91
    )
    return simulate_panel(config, seed=4)


def held(panel: SimulatedPanel, number: int, values: np.ndarray) -> np.ndarray:
    """Mean over the middle of a hold."""
    near = np.abs(panel.imu_panel.t_s - panel.poses[number].t_s) < 0.8
    return values[near].mean(axis=0)


def test_imus_at_rest_feel_gravity_and_the_field(clean: SimulatedPanel):
    for number, pose in enumerate(clean.poses):
        for imu, R_K_imu in ((clean.imu_panel, pose.R_K_P @ clean.R_P_I), (clean.imu_base, clean.R_K_B)):
            R_W_imu = pose.R_W_K @ R_K_imu
            np.testing.assert_allclose(held(clean, number, imu.acc), R_W_imu.T @ [0, 0, 9.81], atol=1e-6)
            np.testing.assert_allclose(held(clean, number, imu.gyro), 0, atol=1e-6)
            assert imu.mag is not None
            np.testing.assert_allclose(held(clean, number, imu.mag), R_W_imu.T @ FIELD_W, atol=1e-6)


def test_gyroscopes_carry_the_way_between_the_poses(clean: SimulatedPanel):
    """Integrated rates bring each IMU from one pose to the next: the exponential of each sample's mean."""
    dt = 1 / clean.imu_panel.rate_hz
    for imu, at in (
        (clean.imu_panel, [p.R_W_K @ p.R_K_P @ clean.R_P_I for p in clean.poses]),
        (clean.imu_base, [p.R_W_K @ clean.R_K_B for p in clean.poses]),
    ):
        for i in range(2):
            between = (imu.t_s > clean.poses[i].t_s) & (imu.t_s < clean.poses[i + 1].t_s)
            turned = Rotation.identity()
            for step in Rotation.from_rotvec(imu.gyro[between] * dt):
                turned = turned * step
            error = turned.inv() * Rotation.from_matrix(at[i].T @ at[i + 1])
            assert np.degrees(error.magnitude()) < 0.01


def test_mounting_is_as_far_off_as_asked(clean: SimulatedPanel):
    assert np.degrees(Rotation.from_matrix(clean.R_P_I).magnitude()) == pytest.approx(3)
    tilts = [pose.R_W_K for pose in clean.poses]
    assert np.degrees(Rotation.from_matrix(tilts[0].T @ tilts[1]).magnitude()) > 2


def test_folder_and_recording_hold_the_session(tmp_path: Path):
    folder, mcap = tmp_path / "session", tmp_path / "session.mcap"
    options = ["--poses", "2", "--seed", "3", *SMALL, "--magnetometer"]
    assert run(["simulate", "panel", "-o", str(folder), "--mcap", str(mcap), *options]) == 0
    truth = tomllib.loads((folder / "truth.toml").read_text())
    lens = tomllib.loads((folder / "intrinsics.toml").read_text())
    defined = np.array(tomllib.loads((folder / "panel.toml").read_text())["panel"]["markers"])
    assert lens["width"] == 128 and len(lens["distortion"]) == 5

    def matrix(table: dict) -> np.ndarray:
        return Rotation.from_quat(np.roll(table["rotation"], -1)).as_matrix()

    mocap = truth["camera_from_mocap"]
    for number in ("01", "02"):
        depth = cv2.imread(str(folder / f"pose_{number}_depth.png"), cv2.IMREAD_UNCHANGED)
        infrared = cv2.imread(str(folder / f"pose_{number}_infrared.png"), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == infrared.dtype == np.uint16 and depth.shape == (106, 128)
        rows = (folder / f"pose_{number}_markers.csv").read_text().splitlines()
        assert rows[0] == "marker,x,y,z"
        markers = np.array([[float(x) for x in row.split(",")[1:]] for row in rows[1:]])
        pose = truth["pose"][number]
        flat = np.column_stack([defined, np.zeros(4)])[pose["marker_order"]]
        np.testing.assert_allclose(
            markers @ matrix(mocap).T + mocap["translation"],
            flat @ matrix(pose).T + pose["translation"],
            atol=0.0012,  # six sigma of the mocap's noise
        )
        u, v = np.rint(pose["marker_pixels"][0]).astype(int)
        # In an image this small a marker is about one pixel: bright all the same.
        assert infrared[v - 1 : v + 2, u - 1 : u + 2].max() > 4 * np.median(infrared)
        header = (folder / f"pose_{number}_imu_base.csv").read_text().splitlines()[0]
        assert header == "t_s,ax,ay,az,gx,gy,gz,mx,my,mz"

    recording = open_recording(mcap)
    assert {imu.topic for imu in recording.imus} == {"/imu/panel", "/imu/base"}
    assert all(len(imu.stamp_ns) == 650 for imu in recording.imus)  # 2 + 2.5 + 2 s at 100 Hz
    images = {}
    for message in Container(mcap).messages():
        if message.topic.schema == "foxglove.RawImage":
            image = message_class("foxglove.RawImage").FromString(bytes(message.data))
            pixels = np.frombuffer(image.data, "<u2").reshape(image.height, image.width)
            images[message.topic.name, image.timestamp.ToNanoseconds() / 1e9] = pixels
    depth = cv2.imread(str(folder / "pose_02_depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(images["/camera/depth/image", 5.5], depth)


def test_folder_is_whole_or_not_there(tmp_path: Path, capsys: pytest.CaptureFixture):
    folder = tmp_path / "session"
    assert run(["simulate", "panel", "-o", str(folder), *SMALL, "--distance-m", "0.35,0.36"]) == 1
    assert "does not fit" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    arguments = ["simulate", "panel", "-o", str(folder), *SMALL]
    assert run(arguments) == 0
    assert run(arguments) == 1 and "--force" in capsys.readouterr().err
    before = (folder / "pose_01_depth.png").read_bytes()
    assert run([*arguments, "--force"]) == 0
    assert (folder / "pose_01_depth.png").read_bytes() == before  # same seed, same bytes
    (folder / "truth.toml").unlink()
    assert run([*arguments, "--force"]) == 1 and "other things" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["session"]
    assert run(["simulate", "panel", "-o", str(folder), "--tilt-deg", "steep"]) == 2
