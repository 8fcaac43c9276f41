"""Rendered panels, exact and the same by seed; a panel session, what its IMUs measure and its files."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from commands import done, refused
from mcap_messages import every
from scipy.spatial.transform import Rotation

from smoother.cli.run import run
from smoother.io.mcap.container import Container
from smoother.io.recording.read import open_recording
from smoother.io.wire.schemas import message_class
from smoother.simulation.panel import FIELD_W, PanelSimulation, SimulatedPanel, simulate_panel


def board_depth(panel: SimulatedPanel, number: int = 0) -> np.ndarray:
    """Depth of the panel's plane in every pixel, mm: ray against plane, by hand."""
    pose, rays = panel.poses[number], panel.lens.ray_image()
    normal = pose.R_K_P[:, 2]
    return 1000 * (normal @ pose.p_K_P) / (rays @ normal[:2] + normal[2])


def on_board(panel: SimulatedPanel, inset_px: int, number: int = 0) -> np.ndarray:
    """Pixels inside the panel's outline, some way from its rim and from the markers."""
    pose = panel.poses[number]
    outline = panel.lens.pixels(panel.config.corners @ pose.R_K_P.T + pose.p_K_P)
    mask = np.zeros(pose.depth.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(outline).astype(np.int32), 1)
    mask = cv2.erode(mask, np.ones((2 * inset_px + 1,) * 2, np.uint8))
    for u, v in pose.marker_pixels:
        cv2.circle(mask, (round(u), round(v)), 10, 0, -1)
    return mask > 0


@pytest.fixture(scope="module")
def ideal() -> SimulatedPanel:
    return simulate_panel(PanelSimulation.ideal(poses=4, quantised=False), seed=5)


@pytest.mark.slow
def test_depth_is_the_panels_plane(ideal: SimulatedPanel):
    for number in range(len(ideal.poses)):
        mask = on_board(ideal, 3, number)
        assert mask.sum() > 5000
        error = ideal.poses[number].depth[mask] - board_depth(ideal, number)[mask]
        assert np.abs(error).max() < 0.002  # mm; rays are single precision


def test_answer_brings_the_mocap_markers_to_the_panel(ideal: SimulatedPanel):
    for pose in ideal.poses:
        markers = np.array(ideal.config.markers)[pose.marker_order]
        flat = np.column_stack([markers, np.zeros(len(markers))])
        in_camera = pose.markers @ ideal.R_K_E.T + ideal.t_K_E
        np.testing.assert_allclose(in_camera, flat @ pose.R_K_P.T + pose.p_K_P, atol=1e-12)
        assert np.linalg.det(pose.R_K_P) == pytest.approx(1)
        assert pose.R_K_P[:, 2] @ pose.p_K_P < 0  # z towards the camera
    assert any((p.marker_order != np.arange(4)).any() for p in ideal.poses)  # shuffled


@pytest.mark.slow
def test_spots_that_are_added():
    def bright(config: PanelSimulation) -> int:
        pose = simulate_panel(config, seed=8).poses[0]
        return int(cv2.connectedComponents((pose.infrared > 40000).astype(np.uint8))[0]) - 1

    assert bright(PanelSimulation()) == 4
    assert bright(PanelSimulation(distractors=2)) == 6
    assert bright(PanelSimulation(marker_shape="sphere")) == 4


SMALL = [*("--set", "width=128", "--set", "height=106", "--set", "focal_px=91"), "--set=distortion=0,0,0,0,0"]


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


def test_folder_and_recording_hold_the_session(tmp_path: Path):
    folder, mcap = tmp_path / "session", tmp_path / "session.mcap"
    done(
        *("simulate", "panel", "-o", folder, "--mcap", mcap, "--set", "poses=2", "--seed", "3", *SMALL),
        *("--set", "magnetometer=true"),
    )
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
    for message in every(Container(mcap)):
        if message.topic.schema == "foxglove.RawImage":
            image = message_class("foxglove.RawImage").FromString(bytes(message.data))
            pixels = np.frombuffer(image.data, "<u2").reshape(image.height, image.width)
            images[message.topic.name, image.timestamp.ToNanoseconds() / 1e9] = pixels
    depth = cv2.imread(str(folder / "pose_02_depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(images["/camera/depth/image", 5.5], depth)


@pytest.mark.slow
def test_a_marker_beside_the_panel_is_refused():
    with pytest.raises(ValueError, match="outside the panel"):
        PanelSimulation(markers=((0, 0), (0.9, 0), (0.2, 0), (0, 0.3)))


def test_folder_is_whole_or_not_there(tmp_path: Path, capsys: pytest.CaptureFixture):
    folder = tmp_path / "session"
    refused(capsys, "simulate", "panel", "-o", folder, *SMALL, "--set", "distance_m=0.35,0.36")
    assert list(tmp_path.iterdir()) == []
    arguments = ["simulate", "panel", "-o", str(folder), *SMALL]
    done(*arguments)
    assert run(arguments) == 1 and "--force" in capsys.readouterr().err
    before = (folder / "pose_01_depth.png").read_bytes()
    done(*arguments, "--force")
    assert (folder / "pose_01_depth.png").read_bytes() == before  # same seed, same bytes
    (folder / "truth.toml").unlink()
    assert run([*arguments, "--force"]) == 1 and "other things" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["session"]
