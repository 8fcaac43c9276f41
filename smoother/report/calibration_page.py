"""`calibration_page`: any calibration's page, its verdict first; the pages of clocks and sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import plotly.graph_objects as go

from calib.clock.beeps import Beep
from calib.clock.clock_calibration import ClockCalibration, next_time, open_questions, verdict
from calib.clock.links import Leftover
from calib.clock.motion_clock import MotionClock
from calib.forearm.held_pose import ForearmCalibration
from calib.imu.accelerometer import sphere_points
from calib.imu.imu_summary import imu_next, imu_verdict, magnetometer_next, magnetometer_verdict, noise_rows
from calib.imu.magnetometer import MagnetometerCalibration
from calib.imu.sensor_calibration import ImuCalibration, SensorNoise
from calib.panel.panel_calibration import PanelCalibration
from calib.world.world_calibration import WorldCalibration

from ..array_types import FloatArray
from ..linalg import unit
from ..recording import ImuStream
from .forearm import forearm_page
from .panel import panel_page, world_page
from .sheet import Page, figure, label, listing, tabulated
from .space import cloud, shaded_cloud, space, view_of
from .style import JOINT_COLOURS, OCCLUDED, TRUTH, VISIBLE, curve, dots, dress, shade_times


def clock_page(calibration: ClockCalibration) -> Page:
    """The page of a solved clock network."""
    return Page(
        f"Clocks: {calibration.session}",
        "Offsets are valid for this session only.",
        verdict(calibration.network),
        _clock_sections(calibration),
    )


def _clock_sections(calibration: ClockCalibration) -> Iterator[str]:
    network = calibration.network
    yield listing("For the next recording", next_time(calibration))
    rows = [
        (
            link.from_clock,
            link.to_clock,
            f"{link.offset_s:+.6f}",
            f"{1e3 * link.sigma_s:.3f}",
            f"{link.at_s:.3f}",
            f"{link.skew_ppm:+.2f} ± {link.skew_sigma_ppm:.2f}",
        )
        for link in network.links()
    ]
    columns = ("from", "to", "offset, s", "sigma, ms", "at (clock from), s", "skew, ppm")
    yield tabulated(
        "Links",
        "t_to = t_from + offset + skew (t_from - at), for every two connected clocks.",
        columns,
        rows,
    )
    for leftover in network.leftovers:
        if len(leftover.residual_s) > 1:
            yield figure(
                f"Residuals: {leftover.source}",
                "How far each time is from the solved clocks; the band is one standard deviation."
                " Crosses were rejected.",
                residuals(leftover),
            )
    for beep in calibration.beeps:
        yield figure(
            f"The beep that ends at {beep.end_s:.4f} s",
            f"Level of the tone of {beep.frequency_hz:.0f} Hz about its end, what was fitted to it, and the"
            f" end that was found (to {1e3 * beep.sigma_s:.2f} ms).",
            beep_end(beep),
        )
    if calibration.motion is not None:
        yield figure(
            "The clock in the motion",
            "Clock offset of each part of the recording with its sigma, and the line through them."
            " Crosses do not fit.",
            motion_line(calibration.motion),
        )
    yield listing("What stayed open", open_questions(calibration), "Nothing stayed open.")


def residuals(leftover: Leftover) -> go.Figure:
    """Residuals of a source over time, one colour per node."""
    plot = go.Figure()
    names = np.array(leftover.node)
    first = float(leftover.t_s.min())
    for name in dict.fromkeys(leftover.node):
        mine = names == name
        symbols = np.where(leftover.used[mine], "circle", "x").tolist()
        x, y = leftover.t_s[mine] - first, 1e3 * leftover.residual_s[mine]
        plot.add_trace(dots(x, y, label(name), None, 8, symbol=symbols))
    limit = max(
        4 * leftover.sigma_s, 1.2 * float(np.abs(leftover.residual_s[leftover.used]).max(initial=0.0))
    )
    plot.add_hrect(
        -1e3 * leftover.sigma_s, 1e3 * leftover.sigma_s, fillcolor=VISIBLE, opacity=0.12, line_width=0
    )
    plot.update_yaxes(title_text="residual, ms", range=[-1e3 * limit, 1e3 * limit])
    plot.update_xaxes(title_text="time after the first, s")
    return dress(plot, 320)


def beep_end(beep: Beep) -> go.Figure:
    """The envelope about a beep's end."""
    plot = go.Figure()
    t = 1e3 * (beep.t_s - beep.end_s)
    size = float(beep.fitted[0])
    for values, name, colour in ((beep.envelope, "heard", VISIBLE), (beep.fitted, "fitted", OCCLUDED)):
        plot.add_trace(curve(t, values / size, name, colour))
    plot.add_vline(0.0, line_dash="dash", line_color=TRUTH)
    plot.update_xaxes(title_text="time from the end, ms")
    plot.update_yaxes(title_text="level", rangemode="tozero")
    return dress(plot, 320)


def motion_line(motion: MotionClock) -> go.Figure:
    """Offsets of the parts and the line through them."""
    plot, link = go.Figure(), motion.link
    symbols = np.where(motion.used, "circle", "x").tolist()
    offsets = dots(motion.t_s, 1e3 * motion.offset_s, "part", VISIBLE, 9, symbol=symbols)
    plot.add_trace(offsets.update(error_y={"array": 1e3 * motion.sigma_s}))
    ends = np.array([motion.t_s.min() - 5.0, motion.t_s.max() + 5.0])
    line = link.offset_s + 1e-6 * link.skew_ppm * (ends - link.at_s)
    plot.add_trace(curve(ends, 1e3 * line, "line", OCCLUDED))
    plot.update_xaxes(title_text="time on the camera's clock, s")
    plot.update_yaxes(title_text="IMU minus camera, ms")
    return dress(plot, 340)


#: Samples of the recording that are drawn.
MOST_POINTS = 6000
LINE_COLOURS = {"x": VISIBLE, "y": OCCLUDED, "z": JOINT_COLOURS["elbow"]}


def imu_page(calibration: ImuCalibration, source: str, imu: ImuStream) -> Page:
    """The page of an IMU's calibration, from its raw stream and the recording's name."""
    return Page(
        f"Accelerometer and gyroscope of {imu.name}",
        recorded_at(source, imu),
        imu_verdict(calibration),
        _imu_sections(imu, calibration),
    )


def recorded_at(source: str, imu: ImuStream) -> str:
    """The line under the heading: where the samples are from."""
    return f"From {source}: {imu.rate_hz:.0f} Hz, {imu.t_s[-1] - imu.t_s[0]:.0f} s."


def _imu_sections(imu: ImuStream, calibration: ImuCalibration) -> Iterator[str]:
    yield listing("For the next recording", imu_next(calibration))
    yield figure(
        "Where the sensor lay still",
        "The three axes of the accelerometer as recorded; rests are shaded. A rest that is not shaded was not"
        " still enough: a table that shakes, a hand that grips the sensor.",
        rests(imu, calibration),
    )
    acc = calibration.accelerometer
    if acc is not None:
        yield rest_coverage(
            "Which directions were covered",
            "Dots: direction of up in the sensor's axes, a rest each. The sphere's colour is the standard"
            " deviation of corrected gravity with that side up: dark is well determined, bright needs"
            " another rest. Drag to turn.",
            calibration,
        )
        yield figure(
            "Error of gravity in each rest",
            "Before the correction and after it. The remaining error is noise and the table; an outlier"
            " was not still.",
            rest_residuals(calibration),
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
            " too short to determine it. Random walk: how far the bias wanders in a second; it grows with"
            " the square root of time.",
            ("figure", "x", "y", "z"),
            noise_rows(calibration),
        )
        for name, noise, unit in (
            ("accelerometer", calibration.accelerometer_noise, "m/s²"),
            ("gyroscope", calibration.gyroscope_noise, "rad/s"),
        ):
            yield figure(
                f"Allan deviation of the {name}",
                "How much successive averages over a time differ. The falling part with slope -1/2 is"
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


def rest_coverage(heading: str, caption: str, calibration: ImuCalibration) -> str:
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


def rest_residuals(calibration: ImuCalibration) -> go.Figure:
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


#: Samples that are drawn.
MOST_MAGNETIC = 4000


def magnetometer_page(calibration: MagnetometerCalibration, source: str, imu: ImuStream) -> Page:
    """The page of a magnetometer's calibration, from its raw stream and the recording's name."""
    return Page(
        f"Magnetometer of {imu.name}",
        recorded_at(source, imu),
        magnetometer_verdict(calibration),
        _magnetometer_sections(imu, calibration),
    )


def _magnetometer_sections(imu: ImuStream, calibration: MagnetometerCalibration) -> Iterator[str]:
    assert imu.mag is not None
    good = np.isfinite(imu.mag).all(axis=1)
    raw, t = imu.mag[good], imu.t_s[good]
    step = max(len(raw) // MOST_MAGNETIC, 1)
    raw, t = raw[::step], t[::step]
    corrected = calibration.apply(raw)
    yield listing("For the next recording", magnetometer_next(calibration))
    yield sphere_coverage(
        "Coverage of the sphere",
        "Corrected samples, coloured by how far they lie off the unit sphere: they should cover it evenly."
        " Grey dots mark directions without samples nearby. Drag to turn.",
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
        "Distance of the samples from the sphere",
        "Length of the corrected field over time; 1 is undisturbed. Slow waves: the field is not"
        " homogeneous. A single bump: a magnetic object came near.",
        field_residuals(t, np.linalg.norm(corrected, axis=1)),
    )
    rows = [(f"offset {axis}", f"{value:.4g}") for axis, value in zip("xyz", calibration.offset, strict=True)]
    rows += [("radii", ", ".join(f"{value:.4g}" for value in calibration.radii))]
    yield tabulated("The ellipsoid", "In the sensor's own unit.", ("number", "value"), rows)


def sphere_coverage(heading: str, caption: str, corrected: FloatArray) -> str:
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


def field_residuals(t: FloatArray, length: FloatArray) -> go.Figure:
    """Length of the corrected field over time."""
    plot = go.Figure(dots(t.astype(np.float32), length.astype(np.float32), None, VISIBLE, 3))
    return dress(plot, 300, xaxis={"title": "s"}, yaxis={"title": "length"})


#: What makes the page of each kind of calibration.
PAGES: dict[type, Callable[..., Page]] = {
    ClockCalibration: clock_page,
    ForearmCalibration: forearm_page,
    ImuCalibration: imu_page,
    MagnetometerCalibration: magnetometer_page,
    PanelCalibration: panel_page,
    WorldCalibration: world_page,
}


def calibration_page(calibration: Any, *inputs: Any) -> Page:
    """The page of a calibration.

    Parameters
    ----------
    calibration : ClockCalibration, ForearmCalibration, ImuCalibration, ..
        One of `PAGES`.
    *inputs
        What it was made of, as its function in `PAGES` takes it.
    """
    return PAGES[type(calibration)](calibration, *inputs)
