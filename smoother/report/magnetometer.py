"""The page of `calibrate magnetometer`: verdict, the samples in space, residuals, what to record next."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go

from calib.imu.accelerometer import sphere_points
from calib.imu.imu_summary import magnetometer_next, magnetometer_verdict
from calib.imu.magnetometer import MagnetometerCalibration

from ..array_types import FloatArray
from ..recording import ImuStream
from .imu import sphere
from .sheet import figure, listing, tabulated, write_sheet
from .space import cloud, shaded_cloud, space, view_of
from .style import OCCLUDED, TRUTH, VISIBLE, dots, dress

#: Samples that are drawn.
MOST_POINTS = 4000


def write_magnetometer_report(
    path: str | os.PathLike[str],
    source: str,
    imu: ImuStream,
    calibration: MagnetometerCalibration,
    *,
    force: bool = False,
) -> None:
    """Write the page of a magnetometer's calibration; parameters as in `imu.write_imu_report`."""
    write_sheet(
        path,
        f"Magnetometer of {imu.name}",
        f"From {source}: {imu.rate_hz:.0f} Hz, {imu.t_s[-1] - imu.t_s[0]:.0f} s.",
        magnetometer_verdict(calibration),
        _sections(imu, calibration),
        force=force,
    )


def _sections(imu: ImuStream, calibration: MagnetometerCalibration) -> Iterator[str]:
    assert imu.mag is not None
    good = np.isfinite(imu.mag).all(axis=1)
    raw, t = imu.mag[good], imu.t_s[good]
    step = max(len(raw) // MOST_POINTS, 1)
    raw, t = raw[::step], t[::step]
    corrected = calibration.apply(raw)
    yield listing("For the next recording", magnetometer_next(calibration))
    yield coverage(
        "The sphere, and what was covered of it",
        "Corrected samples, coloured by how far they lie off the unit sphere: they should cover it evenly."
        " Grey dots mark where no sample came near. Drag to turn.",
        corrected,
    )
    yield recorded(
        "As recorded",
        "Samples as recorded, and the middle of the ellipsoid that they lie on (cross): its distance from"
        " zero is hard iron, its flattening soft iron.",
        raw,
        calibration,
    )
    yield figure(
        "How far the samples lie off the sphere",
        "Length of the corrected field over time; 1 is undisturbed. Slow waves: the field is not the same"
        " all over the place. A single bump: something of iron came near.",
        residuals(t, np.linalg.norm(corrected, axis=1)),
    )
    rows = [(f"offset {axis}", f"{value:.4g}") for axis, value in zip("xyz", calibration.offset, strict=True)]
    rows += [("radii", ", ".join(f"{value:.4g}" for value in calibration.radii))]
    yield tabulated("The ellipsoid", "In the sensor's own unit.", ("number", "value"), rows)


def coverage(heading: str, caption: str, corrected: FloatArray) -> str:
    """Corrected samples in space, and where there are none."""
    from scipy.spatial import cKDTree

    length = np.linalg.norm(corrected, axis=1)
    grid = sphere_points(1500)
    apart, _ = cKDTree(corrected / length[:, None]).query(grid)
    empty = grid[apart > 2.0 * np.sin(np.radians(12.0) / 2.0)]
    off = 100.0 * (length - 1.0)
    most = max(float(np.percentile(np.abs(off), 99)), 0.1)
    items = [shaded_cloud(corrected, "samples", off, "blue-red", (-most, most), 0.025)]
    if len(empty):
        items.append(cloud(empty, "not covered", "#9a9a9a", 5))
    return sphere(heading, caption, items, "% off")


def recorded(heading: str, caption: str, raw: FloatArray, calibration: MagnetometerCalibration) -> str:
    """Raw samples and the ellipsoid's middle."""
    middle, zero = calibration.offset[None], np.zeros((1, 3))
    items = [
        cloud(raw, "as recorded", VISIBLE, 2.5),
        cloud(middle, "middle", OCCLUDED, 14, symbol="cross", words=["middle of the ellipsoid"]),
        cloud(zero, "zero", TRUTH, 9, words=["zero"]),
    ]
    up = np.array([0.0, 0.0, 1.0])
    view = view_of(np.concatenate([raw, middle, zero]), up, np.array([1.2, -1.0, 0.8]))
    size = view["radius"]
    view |= {"axes_at": [0.0, 0.0, 0.0], "axes_length": 0.4 * size}
    return space(heading, caption, items, view | {"grid": False}, axes="xyz")


def residuals(t: FloatArray, length: FloatArray) -> go.Figure:
    """Length of the corrected field over time."""
    plot = go.Figure(dots(t.astype(np.float32), length.astype(np.float32), None, VISIBLE, 3))
    return dress(plot, 300, xaxis={"title": "s"}, yaxis={"title": "length"})
