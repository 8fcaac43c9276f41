"""A camera's lens and place: from points to pixels and back; as OpenCV, ROS, Kalibr and Pose2Sim write it.

`calibrate cameras`: places of further cameras from recordings of one set-up, and their table of a file.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from smoother.array_types import FloatArray
from smoother.cameras.joining import placed_camera
from smoother.errors import CalibrationError
from smoother.recording import FIRST_CAMERA, FOCAL_CALIBRATED, FOCAL_DATA_SHEET, CameraPose, Recording
from smoother.rotation import Rotation
from smoother.runtime.inputs import check_input, read_toml

from .file import CalibrationFile
from .protocol import Answer, Check

#: A point nearer to the lens than this has no pixel, m.
NEAREST_M = 0.05
#: A focal length that may be farther off is not known.
LARGEST_SHARE = 0.5
SHARE_RANGE = f"focal_share is the focal length's standard error as a part of it, 0 to {LARGEST_SHARE:g}"


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole with OpenCV's distortion (Brown-Conrady); the centre of the first pixel is (0, 0)."""

    width: int  # pixels: of the images that these hold for
    height: int  # pixels: of the images that these hold for
    fx: float  # pixels: focal lengths
    fy: float  # pixels: focal lengths
    cx: float  # pixels: principal point
    cy: float  # pixels: principal point
    distortion: tuple[float, ...] = ()  # k1, k2, p1, p2, k3; fewer where the rest is zero, empty for none
    focal_share: float = 0.0  # Standard error of the focal length, as a part of it

    def __post_init__(self) -> None:
        if not self.focal_share:
            share = FOCAL_CALIBRATED if any(self.distortion) else FOCAL_DATA_SHEET
            object.__setattr__(self, "focal_share", share)

    @property
    def focal_px(self) -> float:
        """Mean focal length."""
        return 0.5 * (self.fx + self.fy)

    @property
    def matrix(self) -> FloatArray:
        """The camera matrix (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same lens for images of another size and the same shape."""
        scale = width / self.width
        numbers = {name: scale * getattr(self, name) for name in ("fx", "fy", "cx", "cy")}
        return replace(self, width=width, height=height, **numbers)

    def rays(self, pixels: FloatArray) -> FloatArray:  # pixels (n, 2) -> (n, 2)
        """Undistorted rays of pixels (OpenCV's `undistortPointsIter`)."""
        if not any(self.distortion) or len(pixels) == 0:
            return np.asarray((pixels - [self.cx, self.cy]) / [self.fx, self.fy], dtype=np.float64)
        import cv2

        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        straight = cv2.undistortPointsIter(points, self.matrix, self._terms, np.eye(3), np.eye(3), stop)
        return np.asarray(straight, dtype=np.float64).reshape(-1, 2)

    def pixels(self, points: FloatArray) -> FloatArray:  # points (n, 3) m -> (n, 2)
        """Where points appear (OpenCV's `projectPoints`)."""
        pixels = np.full((len(points), 2), np.nan)
        front = points[:, 2] > NEAREST_M
        if not any(self.distortion):
            flat = points[front, :2] / points[front, 2:]
            pixels[front] = flat * [self.fx, self.fy] + [self.cx, self.cy]
        elif front.any():
            import cv2

            own = np.ascontiguousarray(points[front], dtype=np.float64).reshape(-1, 1, 3)
            bent, _ = cv2.projectPoints(own, np.zeros(3), np.zeros(3), self.matrix, self._terms)
            pixels[front] = bent.reshape(-1, 2)
        return pixels

    def ray_image(self) -> FloatArray:
        """Undistorted rays (height, width, 2) of all pixels."""
        return _ray_image(self)

    @property
    def _terms(self) -> FloatArray:
        return np.array([*self.distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5])


@lru_cache(maxsize=4)
def _ray_image(lens: Intrinsics) -> FloatArray:
    u, v = np.meshgrid(np.arange(lens.width, dtype=float), np.arange(lens.height, dtype=float))
    rays = lens.rays(np.column_stack([u.ravel(), v.ravel()])).reshape(lens.height, lens.width, 2)
    rays.setflags(write=False)
    return rays


@dataclass(frozen=True)
class PlacedCamera:
    """A lens and where it is in {K}."""

    lens: Intrinsics  # Its own axes {C} are x right, y down, z forward
    R_C_K: FloatArray = field(default_factory=lambda: np.eye(3))  # (3, 3): maps a vector from {K} to {C}
    t_C_K: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,) m: p_C = R_C_K p_K + t_C_K

    @property
    def origin(self) -> FloatArray:
        """Where the rays begin, (3,) m in {K}."""
        return np.asarray(-self.R_C_K.T @ self.t_C_K)

    def pixels(self, points_K: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of points (n, 3), m in {K}, and their z in {C} (n,); nan behind the camera."""
        points = points_K @ self.R_C_K.T + self.t_C_K
        return self.lens.pixels(points), points[:, 2]

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Directions (n, 3) in {K} of pixels (n, 2), with z = 1 in {C}."""
        flat = self.lens.rays(pixels)
        return np.concatenate([flat, np.ones((len(flat), 1))], axis=1) @ self.R_C_K


_MATRIX = ("camera_matrix", "cameraMatrix", "matrix", "intrinsics", "K", "mtx", "camera_matrix_left")
_DISTORTION = (
    *("distortion_coefficients", "distortion_coeffs", "distCoeffs", "dist_coeffs", "distortions"),
    *("distortion", "dist", "D"),
)
_SIZE = ("size", "resolution", "image_size", "img_size", "imageSize")
#: Switches: of Pose2Sim and Anipose, of OpenCV's calibration sample.
_IS_FISHEYE = ("fisheye", "fisheye_model")
_MODEL = ("camera_model", "distortion_model", "projection_model", "camera_type", "lens_type")
#: In their values: lenses of ROS, Kalibr, COLMAP, OpenCV's omnidir (xi) and others that are no pinholes.
_OTHER_LENSES = ("equi", "fisheye", "omni", "fov", "ds", "eucm", "kannala", "kb4", "mei", "spherical")
#: How well a calibration with a board places cameras, unless its file states it: rad and m.
PLACE_RAD, PLACE_M = float(np.radians(0.3)), 0.01


@dataclass(frozen=True)
class CameraFile:
    """A camera of a calibration file: its lens, and `x_camera = R x_world + t` where the file has it."""

    lens: Intrinsics
    R: FloatArray | None = None
    t_m: FloatArray | None = None

    def seen_from(self, first: CameraFile) -> CameraPose | None:
        """Its place in the first camera's frame; None where one of the two is not known."""
        if self.R is None or self.t_m is None or first.R is None or first.t_m is None:
            return None
        R_K_C = first.R @ self.R.T
        return CameraPose(R_K_C, first.t_m - R_K_C @ self.t_m, PLACE_RAD, PLACE_M)


def read_camera_file(path: Path) -> dict[str, CameraFile]:
    """The cameras of a calibration file by name; "" where it has one without a name."""
    check_input(path, CalibrationError)
    document = _document(path)
    if _is_camera(document):
        return {"": _camera(path, "", document)}
    cameras: dict[str, CameraFile] = {}
    before: CameraFile | None = None
    for key, table in document.items():
        if not isinstance(table, Mapping) or not _is_camera(table):
            continue
        camera = _camera(path, key, table, before)
        cameras[str(table.get("name", key))] = before = camera
    if not cameras:
        raise CalibrationError(
            f"{path} has no lens: neither camera_matrix (OpenCV, ROS), nor intrinsics (Kalibr), nor matrix"
            " (Pose2Sim), nor fx, fy, cx, cy."
        )
    return cameras


def read_intrinsics(path: str | os.PathLike[str]) -> Intrinsics:
    """The lens of a file with one camera."""
    cameras = read_camera_file(Path(path))
    if len(cameras) > 1:
        raise CalibrationError(f"{path} has the lenses {', '.join(cameras)}; give a file with one of them.")
    return next(iter(cameras.values())).lens


def _is_camera(table: Mapping[str, Any]) -> bool:
    return any(name in table for name in _MATRIX) or {"fx", "fy", "cx", "cy"} <= table.keys()


def _document(path: Path) -> dict[str, Any]:
    import yaml

    try:
        if path.suffix.lower() == ".toml":
            return read_toml(path)
        text = path.read_text(encoding="utf-8")
        if text.lstrip().startswith("{"):
            found = json.loads(text)
        else:  # OpenCV's first line and tags are not YAML's
            found = yaml.safe_load(re.sub(r"^%.*$|!!opencv[\w-]*", "", text, flags=re.MULTILINE))
        if not isinstance(found, dict):
            raise ValueError("it contains no table")
        return found
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror or error}.") from error
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise CalibrationError(
            f"{path} is not a calibration that can be read (TOML, JSON or YAML): {error}."
        ) from error


def _numbers(value: Any) -> FloatArray:
    inner = value.get("data", []) if isinstance(value, Mapping) else value
    return np.asarray(inner, float).ravel()


def _camera(path: Path, name: str, table: Mapping[str, Any], before: CameraFile | None = None) -> CameraFile:
    where = f"{path}{f', {name}' if name else ''}"
    try:
        lens = _lens(where, table)
        R, t_m = _place(table, before)
    except (TypeError, ValueError, KeyError, IndexError) as error:
        raise CalibrationError(f"{where}: the camera's numbers are not whole ({error}).") from error
    return CameraFile(lens, R, t_m)


def _is_no_pinhole(table: Mapping[str, Any]) -> bool:
    """Whether a camera's table names a lens with another projection, whatever its coefficients are."""
    said = any(str(table.get(key, 0)).lower() in ("true", "1", "1.0") for key in _IS_FISHEYE)
    model = " ".join(str(table.get(key, "")) for key in _MODEL).lower()
    return said or "xi" in table or any(word in model for word in _OTHER_LENSES)


def _lens(where: str, table: Mapping[str, Any]) -> Intrinsics:
    distortion = _numbers(next((table[name] for name in _DISTORTION if name in table), []))
    if not distortion.size:
        distortion = np.array([float(table.get(name, 0.0)) for name in ("k1", "k2", "p1", "p2", "k3")])
    if _is_no_pinhole(table) or distortion[5:].any():
        raise CalibrationError(
            f"{where}: only pinhole lenses with k1, k2, p1, p2, k3 are read; calibrate with that model."
        )
    matrix = _numbers(next((table[name] for name in _MATRIX if name in table), []))
    if matrix.size >= 9:
        fx, cx, fy, cy = matrix[[0, 2, 4, 5]].tolist()
    elif matrix.size == 4:  # Kalibr
        fx, fy, cx, cy = matrix.tolist()
    else:
        fx, fy, cx, cy = (float(table[key]) for key in ("fx", "fy", "cx", "cy"))
    size = _numbers(next((table[name] for name in _SIZE if name in table), []))
    if size.size != 2:
        size = np.array(
            [float(table.get(f"image_{name}", table.get(name, np.nan))) for name in ("width", "height")]
        )
    if not np.isfinite(size).all():
        size = np.round([2 * cx, 2 * cy])  # OpenCV's samples leave it out, and rays do not need it
    share = float(table.get("focal_share", 0.0))
    values = np.array([fx, fy, cx, cy, *size, *distortion])
    if not 0.0 <= share <= LARGEST_SHARE:
        raise CalibrationError(f"{where}: {SHARE_RANGE}.")
    if not (np.isfinite(values).all() and min(fx, fy, *size) > 0):
        raise CalibrationError(f"{where}: focal lengths and sizes are above zero, in pixels.")
    terms = tuple(float(value) for value in distortion[:5])
    return Intrinsics(int(size[0]), int(size[1]), fx, fy, cx, cy, terms if any(terms) else (), share)


def _place(
    table: Mapping[str, Any], before: CameraFile | None
) -> tuple[FloatArray | None, FloatArray | None]:
    """`R` and `t` of `x_camera = R x_world + t`; Kalibr's chain is in its first camera's frame."""
    if "rotation" in table and "translation" in table:
        turn, t_m = _numbers(table["rotation"]), _numbers(table["translation"])
        R = turn.reshape(3, 3) if turn.size == 9 else Rotation.from_rotvec(turn.reshape(3)).as_matrix()
        if t_m.shape != (3,) or not np.allclose(R @ R.T, np.eye(3), atol=1e-3):
            raise ValueError("rotation and translation do not form a pose")
        return np.asarray(R), t_m
    if "T_cn_cnm1" in table:
        step = np.asarray(table["T_cn_cnm1"], float).reshape(4, 4)
        if before is None or before.R is None or before.t_m is None:
            raise ValueError("T_cn_cnm1 of the first camera")
        return step[:3, :3] @ before.R, step[:3, :3] @ before.t_m + step[:3, 3]
    if "intrinsics" in table:
        return np.eye(3), np.zeros(3)
    return None, None


#: The top-level table of a calibration file, one table per camera.
TABLE = "cameras"
#: A pose is good for the answer where its sigmas, per axis, are below these, degrees and m.
GOOD_DEG, GOOD_M = 0.5, 0.01
FAR = "record a minute in which both cameras see the arm reach far to all sides"
#: A rotation matrix may be off by this.
ROUNDING = 1e-4


def calibrate_cameras(recordings: Sequence[Recording]) -> Answer:
    """Place the further cameras of a set-up by the joints that they and the first one see.

    Clocks are of a recording: they are shown, and not kept in the file.
    """
    names = [recording.name for recording in recordings]
    if not any(recording.cameras for recording in recordings):
        raise CalibrationError(f"{', '.join(names)}: there is only one camera, so there is no pose to find.")
    poses: dict[str, CameraPose] = {}
    offsets: dict[str, list[float]] = {}  # to the first one's clock, of each recording that it is used in
    fits: dict[str, dict[str, float]] = {}
    left_out: list[str] = []
    for recording in recordings:
        for camera in recording.cameras:
            known = poses.get(camera.name, camera.pose)
            row = placed_camera(replace(camera, pose=known), recording.arm)
            if row.reason or row.pose is None:
                left_out.append(f"{recording.name}: {camera.name} was left out: {row.reason}")
                continue
            if known is not None and row.note:
                left_out.append(f"{recording.name}: {camera.name} {row.note}")
                continue
            before_m = poses[camera.name].sigma_m if camera.name in poses else np.inf
            poses[camera.name] = replace(row.pose, sigma_m=min(row.pose.sigma_m, before_m))
            offsets.setdefault(camera.name, []).append(row.clock.offset_s)
            fits[camera.name] = {"misfit_m": row.misfit_m, "together_s": row.together_s}
    if not poses:
        raise CalibrationError(f"No camera could be placed. {' '.join(left_out)}")
    table, sentences, checks = {}, [], [Check(text) for text in left_out]
    for name, pose in poses.items():
        sigma_deg, sigma_m = float(np.degrees(pose.sigma_rad)), float(pose.sigma_m)
        checks += [
            Check(f"{name}: sigma of the turn", sigma_deg, GOOD_DEG, "degrees", FAR),
            Check(f"{name}: sigma of the place", sigma_m, GOOD_M, "m", FAR),
        ]
        place = {"R_K_C": pose.R_K_C.tolist(), "p_K_C_m": pose.p_K_C_m.tolist()}
        table[name] = place | {"sigma_deg": sigma_deg, "sigma_m": sigma_m}
        cosine = 0.5 * (float(np.trace(pose.R_K_C)) - 1.0)
        sentences.append(
            f"{name} is {np.linalg.norm(pose.p_K_C_m):.2f} m from {FIRST_CAMERA}, turned by"
            f" {np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} degrees; sigma {sigma_deg:.2f} degrees"
            f" and {100 * sigma_m:.1f} cm per axis where the arm is"
        )
    is_good = all(check.is_good for check in checks)
    figures = {
        "recordings": names,
        "cameras": {name: each | {"offset_s": offsets[name]} | fits[name] for name, each in table.items()},
        "left_out": left_out,
    }
    grade = "not good enough" if left_out else "good" if is_good else "usable"
    return Answer(grade, "; ".join(sentences), checks, CalibrationFile().with_table(TABLE, table), figures)


def camera_poses(file: CalibrationFile) -> dict[str, CameraPose]:
    """The poses that a calibration file contains, by camera."""
    table = file.tables.get(TABLE, {})
    if not isinstance(table, Mapping):
        raise CalibrationError(f"{file.source}: {TABLE} is not a table; make it with `calibrate cameras`.")
    return {str(name): _pose(f"{file.source}: [{TABLE}.{name}]", each) for name, each in table.items()}


def _pose(where: str, values: Any) -> CameraPose:
    try:
        R = np.array(values["R_K_C"], float).reshape(3, 3)
        p = np.array(values["p_K_C_m"], float).reshape(3)
        sigma_deg, sigma_m = float(values["sigma_deg"]), float(values["sigma_m"])
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{where} needs R_K_C (3 x 3), p_K_C_m (3), sigma_deg and sigma_m; make it with"
            " `calibrate cameras`."
        ) from error
    proper = np.abs(R @ R.T - np.eye(3)).max() < ROUNDING and np.linalg.det(R) > 0
    if not (proper and np.isfinite(p).all() and sigma_deg > 0 and sigma_m > 0):
        raise CalibrationError(f"{where}: R_K_C is not a rotation, or a sigma is not above zero; correct it.")
    return CameraPose(R, p, float(np.radians(sigma_deg)), sigma_m)


def with_camera_poses(recording: Recording, poses: Mapping[str, CameraPose]) -> Recording:
    """The recording with what is known of where its further cameras stand."""
    cameras = tuple(replace(camera, pose=poses.get(camera.name, camera.pose)) for camera in recording.cameras)
    return replace(recording, cameras=cameras) if cameras else recording
