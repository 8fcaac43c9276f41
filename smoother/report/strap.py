"""The page of `import strap`: where the strap was seen, brightness along the forearm, pictures, reasons."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go

from calib.strap.strap_in_image import SEARCH

from ..recording import FloatArray
from .sheet import figure, listing, picture, tabulated, write_sheet
from .strap_summary import next_time, verdict
from .style import JOINT_COLOURS, OCCLUDED, dress

if TYPE_CHECKING:
    from ..io.media.strap_cameras import StrapFound

#: Profiles farther apart than so many steps are drawn apart.
APART_STEPS = 2.5


def write_strap_report(
    path: str | os.PathLike[str], name: str, search: StrapFound, *, force: bool = False
) -> None:
    """Write the page of a search for the strap."""
    subtitle = (
        f"Colour {search.topics[0]}, depth {search.topics[1]}. Times count from the first colour image."
    )
    write_sheet(
        path, f"The strap in the images: {name}", subtitle, verdict(search), _sections(search), force=force
    )


def _sections(search: StrapFound) -> Iterator[str]:
    yield listing("For the next recording", next_time(search))
    total = max(len(search.reasons), 1)
    rows = [(what, count, f"{100 * count / total:.1f}") for what, count in sorted(search.counts.items())]
    yield tabulated("Found and rejected", "What became of every colour image.", ("", "images", "%"), rows)
    if search.profiles:
        yield figure(
            "Brightness along the forearm",
            "From elbow to wrist over time: the strap is the dark line; dots are where it was found.",
            brightness(search),
        )
    if any(not reason for reason in search.reasons):
        yield figure(
            "The sensor's place",
            "Position in the camera frame, one axis each, and its standard deviation below.",
            places(search),
        )
    if search.pictures:
        import cv2

        good, png = cv2.imencode(".png", np.concatenate(search.pictures, axis=1))
        if good:
            yield picture(
                "As the camera saw it", "The strap where it was found, at some instants.", png.tobytes()
            )
    yield listing("Notes", search.notes, "There is nothing to note.")


def brightness(search: StrapFound) -> go.Figure:
    """Brightness profiles side by side, and the places found."""
    t = np.array([time for time, _ in search.profiles])
    table = np.stack([profile for _, profile in search.profiles], axis=1)
    part = 100 * np.linspace(*SEARCH, len(table))
    t, table = _blank(t, np.rint(table))
    plot = go.Figure(go.Heatmap(x=t, y=part, z=table, colorscale="gray", showscale=False))
    good = [not reason for reason in search.reasons]
    mark = {"size": 3, "color": OCCLUDED}
    plot.add_trace(
        go.Scattergl(
            x=search.t_s[good], y=100 * search.along[good], mode="markers", marker=mark, name="strap"
        )
    )
    plot.update_xaxes(title_text="time, s")
    plot.update_yaxes(title_text="% of elbow to wrist")
    return dress(plot, 380)


def _blank(t: FloatArray, table: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Profiles (k, n) at times (n,), empty ones between those that lie apart: else a column fills it."""
    step = float(np.median(np.diff(t))) if len(t) > 2 else 0.0
    before = np.flatnonzero(np.diff(t) > APART_STEPS * step) if step > 0 else np.empty(0, dtype=int)
    times = np.concatenate([t[before] + step, t[before + 1] - step])
    where = np.concatenate([before + 1, before + 1])
    return np.insert(t, where, times), np.insert(table, where, np.nan, axis=1)


def places(search: StrapFound) -> go.Figure:
    """Position and sigma over time."""
    from plotly.subplots import make_subplots

    plot = make_subplots(rows=2, cols=1, shared_xaxes=True, row_heights=[0.7, 0.3])
    colours = (JOINT_COLOURS["wrist"], JOINT_COLOURS["elbow"], JOINT_COLOURS["hand"])
    for axis, (name, colour) in enumerate(zip("xyz", colours, strict=True)):
        mark = {"size": 3, "color": colour}
        for row, values, shown in (
            (1, search.position[:, axis], True),
            (2, 1e3 * search.sigma_m[:, axis], False),
        ):
            plot.add_trace(
                go.Scattergl(
                    x=search.t_s, y=values, mode="markers", marker=mark, name=name, showlegend=shown
                ),
                row=row,
                col=1,
            )
    plot.update_yaxes(title_text="m", row=1, col=1)
    plot.update_yaxes(title_text="sigma, mm", rangemode="tozero", row=2, col=1)
    plot.update_xaxes(title_text="time, s", row=2, col=1)
    return dress(plot, 480)
