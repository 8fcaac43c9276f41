"""Depth and infrared image of one moment, as arrays."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.runtime.inputs import check_input

from ..image_size import unpacked
from ..intrinsics import Intrinsics


@dataclass(frozen=True)
class View:
    """What the camera saw of the panel in one pose.

    Attributes
    ----------
    depth_m : ndarray, shape (height, width), m
        z of every pixel, m; nan where the camera has none.
    infrared : ndarray, shape (height, width)
        In the image's own unit.
    name : str
        What to call it in messages.
    """

    depth_m: FloatArray
    infrared: FloatArray
    name: str = "the view"


def read_view(depth_png: str | os.PathLike[str], infrared_png: str | os.PathLike[str]) -> View:
    """Read a depth image (16 bit, mm, 0 where there is none) and its infrared image (8 or 16 bit).

    Raises
    ------
    CalibrationError
        A file is missing, is no image, or the depth is not of 16 bit.
    """
    depth = _read(depth_png)
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise CalibrationError(
            f"{depth_png} is not a depth image: it must have one channel of 16 bit, depth in millimetres."
        )
    infrared = _read(infrared_png)
    if infrared.ndim == 3:
        infrared = infrared[..., :3].max(axis=2)
    return view(depth, infrared, Path(depth_png).name)


def view(depth_mm: NDArray, infrared: NDArray, name: str) -> View:
    """A view of images as cameras give them: depth in mm, 0 where there is none."""
    depth = np.asarray(depth_mm, dtype=np.float64)
    known = (depth > 0) & (depth < 65535)  # both ends of the range mean "none"
    return View(np.where(known, 1e-3 * depth, np.nan), np.asarray(infrared, dtype=np.float64), name)


def check_size(seen: View, lens: Intrinsics) -> None:
    """Refuse images that the lens does not belong to.

    Raises
    ------
    CalibrationError
        Depth, infrared and intrinsics are not of one size.
    """
    for what, image in (("depth", seen.depth_m), ("infrared", seen.infrared)):
        height, width = image.shape
        if (width, height) != (lens.width, lens.height):
            raise CalibrationError(
                f"{seen.name}: the {what} image has {width} x {height} pixels and the intrinsics are of"
                f" {lens.width} x {lens.height}; give the intrinsics of this camera and mode."
            )


def _read(path: str | os.PathLike[str]) -> NDArray:
    check_input(path, CalibrationError)
    try:
        with open(path, "rb") as file:
            packed = file.read()
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror or error}.") from error
    try:
        return unpacked(packed, others=True)
    except ValueError as error:
        raise CalibrationError(
            f"{path} is not an image that can be read ({error}); PNG is expected."
        ) from error
