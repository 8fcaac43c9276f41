"""What is known of the panel and the lens beforehand, from their files; and the panel's axes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from smoother.array_types import BoolArray, FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import nearest_rotation, unit
from smoother.runtime.inputs import check_input, read_toml

from ..intrinsics import Intrinsics, is_no_pinhole

#: A panel that is larger, or whose markers are nearer, was not measured in metres.
LARGEST_M, NEAREST_M = 5.0, 0.02
#: How far from one line markers may lie and still be an arm of the L, m.
ON_A_LINE_M = 0.01


@dataclass(frozen=True)
class Panel:
    """A flat panel with four markers in the shape of an L."""

    markers_P: FloatArray  # (4, 2) m: the first is the corner of the L, the origin
    extent_P: FloatArray  # (2, 2) m: lower and upper corner of the panel
    height_m: float = 0.0  # Of the markers' centres above the panel; 0 for flat ones

    @property
    def size_m(self) -> float:
        """Largest distance between two markers."""
        return float(np.linalg.norm(self.markers_P[:, None] - self.markers_P[None], axis=2).max())

    def arms(self) -> tuple[FloatArray, FloatArray]:
        """Markers (n, 2) of the arm along x and of the arm along y, the corner in both."""
        away = np.abs(self.markers_P - self.markers_P[0])
        return self.markers_P[away[:, 1] < ON_A_LINE_M], self.markers_P[away[:, 0] < ON_A_LINE_M]


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
    """Read the table `[panel]` of a TOML file: `markers`, `extent` and, if any, `marker_height` (m)."""
    document = _load(Path(path))
    if not isinstance(document.get("panel"), dict):
        raise CalibrationError(f"{path} has no table [panel] with markers and extent.")
    section = _check(_PanelSection, document["panel"], f"{path}: panel")
    return Panel(np.array(section.markers), np.array(section.extent), section.marker_height)


def read_intrinsics(path: str | os.PathLike[str]) -> Intrinsics:
    """Read a lens from TOML: width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3]."""
    table = _load(Path(path))
    if is_no_pinhole(table):
        raise CalibrationError(
            f"{path}: only pinhole lenses with k1, k2, p1, p2, k3 are read; calibrate with that model."
        )
    values = _check(_LensSection, table, str(path)).model_dump()
    return Intrinsics(**values | {"distortion": tuple(values["distortion"])})


def _load(path: Path) -> dict[str, Any]:
    check_input(path, CalibrationError)
    try:
        return read_toml(path)
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:  # also a number of thousands of digits
        raise CalibrationError(f"{path} is not TOML: {error}.") from error


def _check(model: type[Any], values: dict[str, Any], where: str) -> Any:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([where, *map(str, first["loc"])]) if first["loc"] else where
        said = "is missing" if first["type"] == "missing" else first["msg"].removeprefix("Value error, ")
        raise CalibrationError(f"{key}: {said}.") from error


#: Fewer points than this make no group for a principal component.
FEWEST = 20
#: Principal components are taken of not more points than this: more add nothing and cost seconds.
MOST = 20_000
#: Statistical removal of outliers: neighbours looked at, and sigmas allowed.
NEIGHBOURS, SIGMAS = 20, 2.5


@dataclass(frozen=True)
class Frame:
    """Axes of the panel (columns of `R`) and its origin, seen from another frame, m."""

    R: FloatArray
    origin: FloatArray

    def after(self, other: Frame) -> Frame:
        """The transform that takes `other`'s frame to this one's (JA eq 4 and 5)."""
        R = self.R @ other.R.T
        return Frame(R, self.origin - R @ other.origin)


def frame_of_points(
    points_K: FloatArray, along_x: BoolArray, along_y: BoolArray, about_R: FloatArray
) -> Frame | None:
    """The panel in the camera by principal components, as published (JA II-F.1)."""
    if min(along_x.sum(), along_y.sum()) < FEWEST:
        return None
    centre_x, axes_x = principal(points_K[along_x])
    centre_y, axes_y = principal(points_K[along_y])
    axes = np.column_stack([axes_x[:, 0], axes_y[:, 0], principal(points_K)[1][:, 2]])
    axes *= np.sign(np.sum(axes * about_R, axis=0))
    return Frame(nearest_rotation(axes), _meeting(centre_x, axes[:, 0], centre_y, axes[:, 1]))


def frame_of_markers(markers: FloatArray, panel: Panel) -> Frame:
    """The panel from its markers in order, (4, 3) m, as published: axes along the arms, z = x cross y."""
    away = panel.markers_P - panel.markers_P[0]
    axes = np.zeros((3, 3))
    for axis in (0, 1):
        along = np.abs(away[:, axis])
        end = np.argmax(np.where(along > 2 * np.abs(away[:, 1 - axis]), along, -1.0))
        axes[:, axis] = unit((markers[end] - markers[0]) * np.sign(away[end, axis]))
    axes[:, 2] = unit(np.cross(axes[:, 0], axes[:, 1]))
    return Frame(nearest_rotation(axes), markers[0])


def fit_frame(points: FloatArray, panel: Panel) -> Frame:
    """Pose of the panel by least squares on its markers (4, 3), in order; `origin` is {P}'s."""
    return kabsch(np.column_stack([panel.markers_P, np.full(4, panel.height_m)]), points)


def kabsch(source: FloatArray, target: FloatArray) -> Frame:
    """Rotation and shift that take points (N, 3) of one frame to those of another, by least squares."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    R = nearest_rotation((target - b).T @ (source - a))
    return Frame(R, b - R @ a)


def principal(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (3,) and principal components (columns, the largest first) of points (N, 3) less outliers."""
    from smoother.runtime.packages import load_open3d

    open3d = load_open3d()
    points = points[:: -(-len(points) // MOST)]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.ascontiguousarray(points)))
    if len(points) > 2 * NEIGHBOURS:
        cloud, _ = cloud.remove_statistical_outlier(NEIGHBOURS, SIGMAS)
    mean, covariance = cloud.compute_mean_and_covariance()
    axes = np.linalg.eigh(np.asarray(covariance))[1][:, ::-1]
    return np.asarray(mean, dtype=np.float64), np.asarray(axes, dtype=np.float64)


def _meeting(a: FloatArray, x: FloatArray, b: FloatArray, y: FloatArray) -> FloatArray:
    """Middle of the shortest link between the lines a + s x and b + t y."""
    s, t = np.linalg.lstsq(np.column_stack([x, -y]), b - a, rcond=None)[0]
    return np.asarray(0.5 * (a + s * x + b + t * y))
