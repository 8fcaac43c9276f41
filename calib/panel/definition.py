"""What is known beforehand: the panel's markers and outline, and the camera's lens, from their files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.runtime.inputs import check_input, read_toml

from ..intrinsics import Intrinsics

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
    markers_P : ndarray, shape (4, 2), m
        The first is the corner of the L, the origin.
    extent_P : ndarray, shape (2, 2), m
        Lower and upper corner of the panel.
    height_m : float, m
        Of the markers' centres above the panel; 0 for flat ones.
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

    Parameters
    ----------
    path : path-like
        The TOML file.

    Returns
    -------
    panel : Panel

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

    Parameters
    ----------
    path : path-like
        The TOML file.

    Returns
    -------
    lens : Intrinsics

    Raises
    ------
    CalibrationError
        The file or a key is missing, or a value is wrong.
    """
    values = _check(_LensSection, _load(Path(path)), str(path)).model_dump()
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
