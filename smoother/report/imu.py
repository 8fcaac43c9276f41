"""The page of `calibrate imu`: verdict, rests, coverage, residuals, Allan deviation, what to record next."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import plotly.graph_objects as go

from calib.imu.accelerometer import sphere_points
from calib.imu.imu_summary import imu_next, imu_verdict, noise_rows
from calib.imu.sensor_calibration import ImuCalibration, SensorNoise

from ..linalg import unit
from ..recording import ImuStream
from .sheet import figure, listing, tabulated, write_sheet
from .space import cloud, shaded_cloud, space, view_of
from .style import JOINT_COLOURS, OCCLUDED, TRUTH, VISIBLE, curve, dress, shade_times

#: Samples of the recording that are drawn.
MOST_POINTS = 6000
LINE_COLOURS = {"x": VISIBLE, "y": OCCLUDED, "z": JOINT_COLOURS["elbow"]}


def write_imu_report(
    path: str | os.PathLike[str],
    source: str,
    imu: ImuStream,
    calibration: ImuCalibration,
    *,
    force: bool = False,
) -> None:
    """Write the page of an IMU's calibration.

    Parameters
    ----------
    path : path-like
        The page to write.
    source : str
        The recording's name.
    imu : ImuStream
        The raw stream.
    calibration : ImuCalibration
        Its calibration.
    force : bool
        Overwrite a page that exists.
    """
    write_sheet(
        path,
        f"Accelerometer and gyroscope of {imu.name}",
        f"From {source}: {imu.rate_hz:.0f} Hz, {imu.t_s[-1] - imu.t_s[0]:.0f} s.",
        imu_verdict(calibration),
        _sections(imu, calibration),
        force=force,
    )


def _sections(imu: ImuStream, calibration: ImuCalibration) -> Iterator[str]:
    yield listing("For the next recording", imu_next(calibration))
    yield figure(
        "Where the sensor lay still",
        "The three axes of the accelerometer as recorded; rests are shaded. A rest that is not shaded was not"
        " still enough: a table that shakes, a hand that holds the sensor.",
        rests(imu, calibration),
    )
    acc = calibration.accelerometer
    if acc is not None:
        yield coverage(
            "Which directions were covered",
            "Dots: direction of up in the sensor's axes, a rest each. The sphere's colour is the standard"
            " deviation of corrected gravity with that side up: dark is well known, bright is where a rest is"
            " missing. Drag to turn.",
            calibration,
        )
        yield figure(
            "How far each rest misses gravity",
            "Before the correction and after it. After it, what is left is noise and the table; a rest that"
            " stands out was not still.",
            residuals(calibration),
        )
        sigmas = np.sqrt(np.diag(acc.covariance))
        rows = [
            (f"offset {axis}, m/s²", f"{value:+.4f} ± {sigma:.4f}")
            for axis, value, sigma in zip("xyz", acc.offset, sigmas[:3], strict=True)
        ]
        names = ("scale x", "cross xy", "cross xz", "scale y", "cross yz", "scale z")
        rows += [
            (name, f"{value:+.5f} ± {sigma:.5f}")
            for name, value, sigma in zip(names, acc.matrix[np.triu_indices(3)], sigmas[3:], strict=True)
        ]
        yield tabulated(
            "The accelerometer's nine numbers",
            "corrected = matrix (raw - offset); the matrix is symmetric, scales on its diagonal. ±: one"
            " standard deviation.",
            ("number", "value"),
            rows,
        )
    if calibration.gyroscope_noise is not None and calibration.accelerometer_noise is not None:
        yield tabulated(
            "Noise",
            f"From the longest rest ({calibration.gyroscope_noise.duration_s:.0f} s). A dash: the rest was"
            " too short to show it. Random walk: how far the bias wanders in a second, growing with the root"
            " of time.",
            ("figure", "x", "y", "z"),
            noise_rows(calibration),
        )
        for name, noise, unit in (
            ("accelerometer", calibration.accelerometer_noise, "m/s²"),
            ("gyroscope", calibration.gyroscope_noise, "rad/s"),
        ):
            yield figure(
                f"Allan deviation of the {name}",
                "How much means over a time differ from one to the next. The falling part with slope -1/2 is"
                " white noise, its flat bottom the bias instability, the rise after it the random walk."
                " Dashed: white noise as found.",
                allan(noise, unit),
            )


def rests(imu: ImuStream, calibration: ImuCalibration) -> go.Figure:
    """Accelerometer over time, rests shaded."""
    plot = go.Figure()
    step = max(len(imu) // MOST_POINTS, 1)
    for column, (axis, colour) in enumerate(LINE_COLOURS.items()):
        t, values = imu.t_s[::step], imu.acc[::step, column]
        plot.add_trace(curve(t.astype(np.float32), values.astype(np.float32), axis, colour, 1))
    shade_times(plot, [(imu.t_s[a], imu.t_s[b - 1]) for a, b in calibration.rests.ranges.tolist()])
    return dress(plot, 340, xaxis={"title": "s"}, yaxis={"title": "specific force, m/s²"})


def coverage(heading: str, caption: str, calibration: ImuCalibration) -> str:
    """Rests on the sphere, coloured by how well each direction is known."""
    acc = calibration.accelerometer
    assert acc is not None
    directions = sphere_points(2500)
    sigma = 1e3 * acc.sigma_towards(directions, calibration.gravity)
    limits = (float(sigma.min()), float(sigma.max()))
    known = shaded_cloud(directions, "standard deviation", sigma, "cividis", limits, 0.1)
    up = unit(acc.apply(calibration.rests.acc))
    names = [f"rest {number}" for number in range(1, len(up) + 1)]
    rested = cloud(1.03 * up, "rests", OCCLUDED, 10, words=names)
    return sphere(heading, caption, [known, rested], "mm/s²")


def residuals(calibration: ImuCalibration) -> go.Figure:
    """Length of each rest less gravity, before and after."""
    acc = calibration.accelerometer
    assert acc is not None
    number = np.arange(1, len(calibration.rests) + 1)
    before = np.linalg.norm(calibration.rests.acc, axis=1) - calibration.gravity
    plot = go.Figure()
    plot.add_trace(go.Bar(x=number, y=before, name="as recorded", marker={"color": "#bbbbbb"}))
    plot.add_trace(go.Bar(x=number, y=acc.residual, name="corrected", marker={"color": VISIBLE}))
    return dress(plot, 320, xaxis={"title": "rest"}, yaxis={"title": "|force| - gravity, m/s²"})


def allan(noise: SensorNoise, unit: str) -> go.Figure:
    """Allan deviation over averaging time, both logarithmic."""
    plot = go.Figure()
    for column, (axis, colour) in enumerate(LINE_COLOURS.items()):
        plot.add_trace(curve(noise.tau_s, noise.deviation[:, column], axis, colour))
    white = float(np.sqrt(np.mean(noise.density**2))) / np.sqrt(noise.tau_s)
    plot.add_trace(curve(noise.tau_s, white, "white noise", TRUTH, dash="dash"))
    return dress(
        plot,
        380,
        xaxis={"title": "averaging time, s", "type": "log"},
        yaxis={"title": f"Allan deviation, {unit}", "type": "log", "exponentformat": "power"},
    )


def sphere(heading: str, caption: str, items: list[dict[str, Any]], unit_of_values: str) -> str:
    """A section of directions in the sensor's axes, on a ball that nothing shines through."""
    corners = 1.4 * np.vstack([np.eye(3), -np.eye(3)])
    view = view_of(corners, np.array([0.0, 0.0, 1.0]), np.array([1.2, -1.0, 0.8]))
    return space(heading, caption, items, view, axes="xyz", ball=0.97, unit_of_values=unit_of_values)
