"""How the report's figures look: colours, axes, shaded gaps."""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

from ..measurements.visibility import Gap
from ..recording import CameraFrame

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
        template="plotly_white",
        height=height,
        margin={"l": 70, "r": 20, "t": head, "b": 50},
        font={"family": "system-ui, sans-serif", "size": 13},
        legend={"orientation": "h", "yanchor": "top", "y": 0.995, "yref": "container", "x": 0},
        hovermode="closest",
        **layout,
    )
    return figure


def shade(figure: go.Figure, gaps: tuple[Gap, ...]) -> None:
    """Shade the gaps over the whole height; the longest ones if there are very many."""
    longest = sorted(gaps, key=lambda gap: -gap.length_s)[:MOST_SHADES]
    plain = {"type": "rect", "xref": "x", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    plain |= {"fillcolor": SHADE, "line": {"width": 0}}
    # all at once: plotly checks every shape again whenever one is added
    figure.update_layout(shapes=[{**plain, "x0": gap.start_s, "x1": gap.end_s} for gap in longest])
