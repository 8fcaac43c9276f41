"""Calibration files of other programs: lenses and places, against OpenCV and rotations worked out by hand."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.intrinsics import read_camera_file, read_intrinsics
from smoother.errors import CalibrationError

MATRIX = np.array([[910.5, 0.0, 633.0], [0.0, 905.0, 362.5], [0.0, 0.0, 1.0]])
TERMS = (-0.12, 0.03, 1e-3, -2e-3, 0.004)


def opencvs_own(path: Path) -> None:
    """As cv2.FileStorage writes them."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1280)
    storage.write("image_height", 720)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", np.array([TERMS]))
    storage.release()


ROS = (
    "image_width: 1280\nimage_height: 720\ncamera_name: front  # the left one\ncamera_matrix:\n"
    "  rows: 3\n  cols: 3\n  data: [910.5, 0., 633., 0., 905.,\n     362.5, 0., 0., 1.]\n"
    "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
    f"  data: {list(TERMS)}\n"
)
PLAIN = json.dumps({"K": MATRIX.tolist(), "dist": [TERMS], "image_size": [1280, 720]})


@pytest.mark.parametrize(
    ("name", "text"), [("lens.yml", ""), ("lens.json", ""), ("ros.yaml", ROS), ("plain.json", PLAIN)]
)
def test_a_file_of_one_lens(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    if text:
        path.write_text(text)
    else:
        opencvs_own(path)
    ((key, camera),) = read_camera_file(path).items()
    lens = camera.lens
    assert key == "" and camera.R is None
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (910.5, 905.0, 633.0, 362.5)
    assert (lens.width, lens.height) == (1280, 720)
    np.testing.assert_allclose(lens.distortion, TERMS)


def test_kalibrs_chain_of_cameras(tmp_path: Path) -> None:
    turn = Rotation.from_euler("y", 60, degrees=True).as_matrix()
    steps = [np.eye(4), np.eye(4)]
    for step in steps:
        step[:3, :3], step[:3, 3] = turn, [0.1, 0.2, 0.3]
    text = ""
    for number in range(3):
        text += (
            f"cam{number}:\n  cam_overlaps: [0, 1]\n  camera_model: pinhole\n  distortion_coeffs:"
            f" {list(TERMS[:4])}\n  distortion_model: radtan\n  intrinsics: [910.5, 905.0, 633.0, 362.5]\n"
            f"  resolution: [1280, 720]\n  rostopic: /cam{number}/image\n"
        )
        if number:
            text += "  T_cn_cnm1:\n" + "".join(f"  - {row.tolist()}\n" for row in steps[number - 1])
    path = tmp_path / "camchain.yaml"
    path.write_text(text)
    cameras = read_camera_file(path)
    assert list(cameras) == ["cam0", "cam1", "cam2"]
    np.testing.assert_allclose(cameras["cam2"].lens.distortion, TERMS[:4])
    pose = cameras["cam2"].seen_from(cameras["cam0"])
    back = np.linalg.inv(steps[1] @ steps[0])  # from the third camera to the first
    np.testing.assert_allclose(pose.R_K_C, back[:3, :3], atol=1e-12)
    np.testing.assert_allclose(pose.p_K_C_m, back[:3, 3], atol=1e-12)


def test_pose2sims_calibration(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    turns, shifts = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    text = "".join(
        f'[cam_{at}]\nname = "view{at}"\nsize = [1280.0, 720.0]\nmatrix = {MATRIX.tolist()}\n'
        f"distortions = {list(TERMS[:4])}\nrotation = {turns[at].tolist()}\n"
        f"translation = {shifts[at].tolist()}\nfisheye = false\n\n"
        for at in range(2)
    )
    path = tmp_path / "Calib.toml"
    path.write_text(text + "[metadata]\nadjusted = false\nerror = 0.0\n")
    cameras = read_camera_file(path)
    assert list(cameras) == ["view0", "view1"]
    pose = cameras["view1"].seen_from(cameras["view0"])
    world = rng.normal(size=3)
    in_first, in_other = (
        Rotation.from_rotvec(turn).apply(world) + t for turn, t in zip(turns, shifts, strict=True)
    )
    np.testing.assert_allclose(pose.to_first(in_other), in_first, atol=1e-12)
    # OpenCV agrees on where the point appears
    pixel = cv2.projectPoints(world[None], turns[1], shifts[1], MATRIX, np.array(TERMS[:4]))[0].ravel()
    np.testing.assert_allclose(cameras["view1"].lens.pixels(in_other[None])[0], pixel, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a: 1\n", "has no lens"),
        ("camera_matrix:\n  data: [1.0, 2.0]\n", "not whole"),
        ("camera_matrix: [-9, 0, 1, 0, 9, 1, 0, 0, 1]\n", "above zero"),
        ("cam0:\n  camera_model: pinhole\n  distortion_model: equidistant\n  intrinsics: [9, 9, 4, 4]\n"
         "  distortion_coeffs: [0.1, 0, 0, 0]\n  resolution: [8, 8]\n", "only pinhole lenses"),
        ("- 1\n", "not a calibration that can be read"),
        ("{", "not a calibration that can be read"),
        ("camera_matrix: [1, 2\n", "not a calibration that can be read"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "lens.yaml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=why):
        read_camera_file(path)


_NUMBERS = {"width": 8, "height": 8, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 4.0}


@pytest.mark.parametrize("terms", [(0.0, 0.0, 0.0, 0.0), TERMS[:4]], ids=["no terms", "terms"])
@pytest.mark.parametrize(
    ("key", "value"),
    [("fisheye_model", 1), ("fisheye", True), ("distortion_model", "equidistant"),
     ("camera_model", "OPENCV_FISHEYE"), ("distortion_model", "kannala_brandt"), ("xi", 1.2),
     ("fisheye_model", 0), ("fisheye", False), ("distortion_model", "plumb_bob")],
)  # fmt: skip
@pytest.mark.parametrize("kind", ["opencv.yml", "opencv.json", "pose2sim.toml", "panel.toml"])
def test_a_lens_that_is_no_pinhole_is_refused_by_every_reader(
    tmp_path: Path, kind: str, key: str, value: object, terms: tuple[float, ...]
) -> None:
    path, matrix = tmp_path / kind, [9.0, 0.0, 4.0, 0.0, 9.0, 4.0, 0.0, 0.0, 1.0]
    text = json.dumps(value)
    if kind == "opencv.yml":
        path.write_text(
            f"%YAML:1.0\n---\n{key}: {text}\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   data: {matrix}\n"
            f"distortion_coefficients: !!opencv-matrix\n   rows: 4\n   data: {list(terms)}\n"
        )
    elif kind == "opencv.json":
        matrices = {"camera_matrix": {"data": matrix}, "distortion_coefficients": {"data": terms}}
        path.write_text(json.dumps({key: value, **matrices}))
    elif kind == "pose2sim.toml":
        path.write_text(
            f'[cam]\nname = "a"\nsize = [8, 8]\nmatrix = {matrix}\n'
            f"distortions = {list(terms)}\n{key} = {text}\n"
        )
    else:
        values = {**_NUMBERS, "distortion": list(terms), key: value}
        path.write_text("".join(f"{name} = {json.dumps(each)}\n" for name, each in values.items()))
    read = read_intrinsics if kind == "panel.toml" else read_camera_file
    if value in (0, False, "plumb_bob"):
        read(path)
        return
    with pytest.raises(CalibrationError, match="only pinhole lenses"):
        read(path)
