"""The page of `calibrate clock`: links, residuals, the beep's end, the motion's line."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go

from calib.clock.beeps import Beep
from calib.clock.clock_calibration import ClockCalibration, next_time, open_questions, verdict
from calib.clock.links import Leftover
from calib.clock.motion_clock import MotionClock

from .sheet import Page, figure, label, listing, tabulated
from .style import OCCLUDED, TRUTH, VISIBLE, curve, dots, dress


def clock_page(calibration: ClockCalibration) -> Page:
    """The page of a solved clock network."""
    return Page(
        f"Clocks: {calibration.session}",
        "Offsets are valid for this session only.",
        verdict(calibration.network),
        _sections(calibration),
    )


def _sections(calibration: ClockCalibration) -> Iterator[str]:
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
