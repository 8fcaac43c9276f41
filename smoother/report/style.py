"""How the report's figures look: colours, axes, shaded gaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import plotly.graph_objects as go
from numpy.typing import ArrayLike

from ..array_types import BoolArray, FloatArray
from ..measurements.visibility import Gap
from ..recording import CameraFrame
from .decimate import split_line

#: Told apart by readers with any colour vision.
VISIBLE, OCCLUDED, TRUTH, CAMERA = "#0072B2", "#D55E00", "#111111", "#8a8a8a"
SHADE = "rgba(213, 94, 0, 0.13)"
BAND = "rgba(0, 114, 178, 0.20)"
JOINT_COLOURS = {
    "shoulder": "#CC79A7",
    "elbow": "#009E73",
    "wrist": "#0072B2",
    "hand": "#E69F00",
    "strap": "#56B4E9",
}
#: Of the axes of a sensor, a panel or a camera.
AXIS_COLOURS = {"x": "#c1272d", "y": "#2a7f3f", "z": "#1f4fa8"}
#: More shaded gaps than this make a page slow.
MOST_SHADES = 400

_MEANING = {
    CameraFrame.KINECT: ("left", "up", "away"),
    CameraFrame.OPTICAL: ("right", "down", "away"),
    CameraFrame.ZUP: ("", "", "up"),
}


_AXIS = {"gridcolor": "#e4e7ea", "zerolinecolor": "#cccccc", "automargin": True, "title": {"standoff": 8}}
#: Plain, and without a background, so that a page in dark colours shows through.
_TEMPLATE = go.layout.Template(
    layout={
        "paper_bgcolor": "rgba(0, 0, 0, 0)",
        "plot_bgcolor": "rgba(0, 0, 0, 0)",
        "colorway": [*JOINT_COLOURS.values(), CAMERA],
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "modebar": {"bgcolor": "rgba(0, 0, 0, 0)", "color": "#9a9a9a", "activecolor": VISIBLE},
    }
)


def axis_names(frame: CameraFrame | None) -> tuple[str, str, str]:
    """Names of the camera's axes with their directions, for axis titles (without unit)."""
    meanings = _MEANING[frame] if frame is not None else ("", "", "")
    x, y, z = (
        f"{axis} ({meaning})" if meaning else axis for axis, meaning in zip("xyz", meanings, strict=True)
    )
    return x, y, z


def dress(figure: go.Figure, height: int, head: int = 50, **layout: Any) -> go.Figure:
    """Give a figure the report's plain look; `head` is the room above it for legend and buttons, pixels."""
    figure.update_layout(
        template=_TEMPLATE,
        height=height,
        margin={"l": 70, "r": 20, "t": head, "b": 50},
        font={"family": "system-ui, sans-serif", "size": 13},
        legend={"orientation": "h", "yanchor": "top", "y": 0.995, "yref": "container", "x": 0},
        hovermode="closest",
        **layout,
    )
    return figure


def curve(
    x: ArrayLike,
    y: ArrayLike,
    name: str | None,
    colour: str,
    width: float | None = None,
    dash: str | None = None,
    **more: Any,
) -> go.Scatter:
    """A line."""
    line = {"color": colour, "width": width, "dash": dash}
    return go.Scatter(x=x, y=y, name=name, mode="lines", line=line, **more)


def dots(
    x: ArrayLike, y: ArrayLike, name: str | None, colour: str | None, size: float, **more: Any
) -> go.Scatter:
    """Points, by default discs; `symbol` is another mark for all or for each of them."""
    marker = {"color": colour, "size": size, "symbol": more.pop("symbol", None)}
    return go.Scatter(x=x, y=y, name=name, mode="markers", marker=marker, **more)


def seen_and_recovered(
    t: ArrayLike, values: FloatArray, occluded: BoolArray, width: float = 1.8, prefix: str = ""
) -> list[go.Scatter]:
    """The two lines of a value: where the camera saw the arm, and where it was recovered."""
    visible, hidden = split_line(values, occluded)
    return [
        curve(t, visible, f"{prefix}seen", VISIBLE, width),
        curve(t, hidden, f"{prefix}recovered", OCCLUDED, width),
    ]


def shade(figure: go.Figure, gaps: tuple[Gap, ...]) -> None:
    """Shade the gaps over the whole height (the longest if very many), and show the player's time there."""
    longest = sorted(gaps, key=lambda gap: -gap.length_s)[:MOST_SHADES]
    shade_times(figure, [(gap.start_s, gap.end_s) for gap in longest])
    figure.update_layout(meta={"time": True})


def shade_times(figure: go.Figure, times: Sequence[tuple[float, float]]) -> None:
    """Shade times (start, end) over the whole height."""
    # as one shape: hundreds of them are slow to draw
    path = " ".join(f"M {start:.4f},0 V 1 H {end:.4f} V 0 Z" for start, end in times)
    plain = {"type": "path", "xref": "x", "yref": "paper", "layer": "below", "fillcolor": SHADE}
    shapes = [{**plain, "path": path, "line": {"width": 0}}] if path else []
    figure.update_layout(shapes=shapes)
