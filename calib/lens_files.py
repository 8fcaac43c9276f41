"""Lenses and places of cameras as other programs write them: OpenCV, ROS, Kalibr, Pose2Sim."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import CameraPose
from smoother.rotation import Rotation
from smoother.runtime.inputs import check_input, read_toml

from .intrinsics import Intrinsics

_MATRIX = ("camera_matrix", "cameraMatrix", "matrix", "intrinsics", "K", "mtx", "camera_matrix_left")
_DISTORTION = (
    *("distortion_coefficients", "distortion_coeffs", "distCoeffs", "dist_coeffs", "distortions"),
    *("distortion", "dist", "D"),
)
_SIZE = ("size", "resolution", "image_size", "img_size", "imageSize")
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
    """The cameras of a calibration file by name; "" where it has one without a name.

    Read are OpenCV's and ROS's YAML and JSON (`camera_matrix`, `distortion_coefficients`), Kalibr's camchain,
    Pose2Sim's and Caliscope's `Calib.toml`, and TOML with fx, fy, cx, cy.

    Raises
    ------
    CalibrationError
        It is none of these, a lens is not whole, or its model is another one.
    """
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


def _is_camera(table: Mapping[str, Any]) -> bool:
    return any(name in table for name in _MATRIX) or {"fx", "fy", "cx", "cy"} <= table.keys()


def _document(path: Path) -> dict[str, Any]:
    try:
        if path.suffix.lower() == ".toml":
            return read_toml(path)
        text = path.read_text(encoding="utf-8")
        found = json.loads(text) if text.lstrip().startswith("{") else plain_yaml(text)
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror or error}.") from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError(
            f"{path} is not a calibration that can be read (TOML, JSON or YAML): {error}."
        ) from error
    if not isinstance(found, dict):
        raise CalibrationError(f"{path} contains no table of a camera.")
    return found


def plain_yaml(text: str) -> dict[str, Any]:
    """The part of YAML that calibration files use: tables by indentation, numbers, words, lists.

    Raises
    ------
    ValueError
        A line is of another kind.
    """
    lines: list[str] = []
    for raw in text.splitlines():
        line = re.sub(r"(^|\s)#.*$", "", raw).rstrip()
        if not line or line.startswith(("%", "---", "...")):
            continue
        if lines and lines[-1].count("[") > lines[-1].count("]"):
            lines[-1] += " " + line.strip()  # a list goes on
        else:
            lines.append(line)
    root: dict[str, Any] = {}
    open_tables: list[tuple[int, dict[str, Any]]] = [(-1, root)]
    last: tuple[dict[str, Any], str] | None = None
    for line in lines:
        indent, body = len(line) - len(line.lstrip()), line.strip()
        if body.startswith("- "):
            if last is None:
                raise ValueError("a list without a name")
            table, key = last
            if not isinstance(table[key], list):
                table[key] = []
            table[key].append(_scalar(body[2:]))
            continue
        key, mark, rest = body.partition(":")
        if not mark:
            raise ValueError(f"line '{body[:40]}'")
        while len(open_tables) > 1 and indent <= open_tables[-1][0]:
            open_tables.pop()
        parent = open_tables[-1][1]
        key, rest = key.strip().strip("\"'"), re.sub(r"^\s*!!\S+", "", rest).strip()
        if rest:
            parent[key] = _scalar(rest)
        else:
            parent[key] = {}
            open_tables.append((indent, parent[key]))
        last = parent, key
    return root


def _scalar(text: str) -> Any:
    text = text.strip()
    if text.startswith("["):
        return json.loads(re.sub(r"(?<![\d.])\.(?=\d)", "0.", re.sub(r"(?<=\d)\.(?=[\s,\]eE])", ".0", text)))
    try:
        return float(text)
    except ValueError:
        return text.strip("\"'")


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


def _lens(where: str, table: Mapping[str, Any]) -> Intrinsics:
    model = " ".join(str(table.get(key, "")) for key in ("camera_model", "distortion_model")).lower()
    distortion = _numbers(next((table[name] for name in _DISTORTION if name in table), []))
    if not distortion.size:
        distortion = np.array([float(table.get(name, 0.0)) for name in ("k1", "k2", "p1", "p2", "k3")])
    fisheye = table.get("fisheye") in (True, "true") or any(
        word in model for word in ("equi", "fisheye", "omni", "fov", "ds", "eucm")
    )
    if (fisheye and distortion.any()) or distortion[5:].any():
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
    values = np.array([fx, fy, cx, cy, *size, *distortion])
    if not (np.isfinite(values).all() and min(fx, fy, *size) > 0):
        raise CalibrationError(f"{where}: focal lengths and sizes are above zero, in pixels.")
    terms = tuple(float(value) for value in distortion[:5])
    return Intrinsics(int(size[0]), int(size[1]), fx, fy, cx, cy, terms if any(terms) else ())


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
