"""What is known beforehand: the panel's markers and outline, the camera's lens."""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from smoother.errors import CalibrationError
from smoother.recording import FloatArray

#: A panel that is larger, or whose markers are nearer, was not measured in metres.
LARGEST_M, NEAREST_M = 5.0, 0.02
#: How far from one line markers may lie and still be an arm of the L, m.
ON_A_LINE_M = 0.01


@dataclass(frozen=True)
class Panel:
    """A flat panel with four markers in the shape of an L.

    The panel frame {P}: x along the longer arm, y along the shorter, z = x cross y towards the camera.

    Attributes
    ----------
    markers_P : (4, 2) m; the first is the corner of the L, the origin.
    extent_P : (2, 2) m; lower and upper corner of the panel.
    height_m : of the markers' centres above the panel; 0 for flat ones.
    """

    markers_P: FloatArray
    extent_P: FloatArray
    height_m: float = 0.0

    @property
    def size_m(self) -> float:
        """Largest distance between two markers."""
        return float(np.linalg.norm(self.markers_P[:, None] - self.markers_P[None], axis=2).max())

    def arms(self) -> tuple[FloatArray, FloatArray]:
        """Markers (n, 2) of the arm along x and of the arm along y, the corner in both."""
        away = np.abs(self.markers_P - self.markers_P[0])
        return self.markers_P[away[:, 1] < ON_A_LINE_M], self.markers_P[away[:, 0] < ON_A_LINE_M]


@dataclass(frozen=True)
class Intrinsics:
    """Lens of the depth and infrared camera; the centre of the first pixel is (0, 0).

    Attributes
    ----------
    width, height : of the images, pixels.
    fx, fy, cx, cy : focal lengths and principal point, pixels.
    distortion : k1, k2, p1, p2, k3 (Brown-Conrady, as OpenCV has it).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def focal_px(self) -> float:
        """Mean focal length."""
        return 0.5 * (self.fx + self.fy)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Undistorted rays (N, 2), x/z and y/z, of pixels (N, 2)."""
        import cv2

        if len(pixels) == 0:
            return np.empty((0, 2))
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        found = cv2.undistortPointsIter(
            points, self._matrix(), np.array(self.distortion), np.eye(3), np.eye(3), stop
        )
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)

    def pixels(self, points_K: FloatArray) -> FloatArray:
        """Pixels (N, 2) of points (N, 3) in {K}, in front of the camera."""
        import cv2

        if len(points_K) == 0:
            return np.empty((0, 2))
        points = np.ascontiguousarray(points_K, dtype=np.float64).reshape(-1, 1, 3)
        seen, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), self._matrix(), np.array(self.distortion)
        )
        return np.asarray(seen, dtype=np.float64).reshape(-1, 2)

    def ray_image(self) -> FloatArray:
        """Undistorted rays (height, width, 2) of all pixels."""
        return _ray_image(self)

    def _matrix(self) -> FloatArray:
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@lru_cache(maxsize=4)
def _ray_image(lens: Intrinsics) -> FloatArray:
    u, v = np.meshgrid(np.arange(lens.width, dtype=float), np.arange(lens.height, dtype=float))
    rays = lens.rays(np.column_stack([u.ravel(), v.ravel()])).reshape(lens.height, lens.width, 2)
    rays.setflags(write=False)
    return rays


_Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class _Section(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)


class _PanelSection(_Section):
    markers: Annotated[list[_Pair], Field(min_length=4, max_length=4)]
    extent: Annotated[list[_Pair], Field(min_length=2, max_length=2)]
    marker_height: float = Field(default=0.0, ge=0.0, le=0.1)

    @model_validator(mode="after")
    def _sound(self) -> Self:
        markers, extent = np.array(self.markers), np.array(self.extent)
        gaps = np.linalg.norm(markers[:, None] - markers[None], axis=2)[np.triu_indices(4, 1)]
        if gaps.max() > LARGEST_M:
            raise ValueError(f"the markers are up to {gaps.max():.0f} m apart; give them in metres")
        if gaps.min() < NEAREST_M:
            raise ValueError("two markers are less than 2 cm apart")
        if not (extent[1] > extent[0]).all():
            raise ValueError("extent must be [[xmin, ymin], [xmax, ymax]]")
        if (markers < extent[0]).any() or (markers > extent[1]).any():
            raise ValueError("a marker lies outside extent")
        spread = np.linalg.svd(markers - markers.mean(axis=0), compute_uv=False)
        if spread[1] < 0.1 * spread[0]:
            raise ValueError("the markers lie on one line; they must form an L")
        return self


class _LensSection(_Section):
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float
    distortion: Annotated[list[float], Field(max_length=5)] = Field(default_factory=list)


def read_panel(path: str | os.PathLike[str]) -> Panel:
    """Read the table `[panel]` of a TOML file: `markers`, `extent` and, if any, `marker_height` (m).

    Raises
    ------
    CalibrationError
        The file or a key is missing, or the markers are not four in the shape of an L.
    """
    document = _load(Path(path))
    if not isinstance(document.get("panel"), dict):
        raise CalibrationError(f"{path} has no table [panel] with markers and extent.")
    section = _check(_PanelSection, document["panel"], f"{path}: panel")
    return Panel(np.array(section.markers), np.array(section.extent), section.marker_height)


def read_intrinsics(path: str | os.PathLike[str]) -> Intrinsics:
    """Read a lens from TOML: width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3].

    Raises
    ------
    CalibrationError
        The file or a key is missing, or a value is wrong.
    """
    section = _check(_LensSection, _load(Path(path)), str(path))
    return intrinsics(
        section.width, section.height, section.fx, section.fy, section.cx, section.cy, section.distortion
    )


def intrinsics(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, distortion: list[float]
) -> Intrinsics:
    """A lens whose distortion has up to five terms."""
    k1, k2, p1, p2, k3 = [*map(float, distortion), 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return Intrinsics(int(width), int(height), fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def _load(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror or error}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path} is not TOML: {error}.") from error


def _check(model: type[Any], values: dict[str, Any], where: str) -> Any:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([where, *map(str, first["loc"])]) if first["loc"] else where
        said = "is missing" if first["type"] == "missing" else first["msg"].removeprefix("Value error, ")
        raise CalibrationError(f"{key}: {said}.") from error
