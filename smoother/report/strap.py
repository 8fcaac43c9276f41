"""The page of `import strap`: verdict, where the strap was seen, brightness along the forearm, pictures."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go

from calib.strap import SEARCH

from ..array_types import FloatArray
from ..linalg import robust_sigma
from .sheet import Page, figure, listing, picture, tabulated
from .style import JOINT_COLOURS, OCCLUDED, dots, dress

if TYPE_CHECKING:
    from ..io.media.strap import StrapFound


#: A strap that wanders along the forearm by more than this part of it was at times something else.
WANDER = 0.06
FEW = 0.3

_ADVICE = {
    "nothing on the forearm is dark enough": "wear a black strap on a bare or light forearm, and light"
    " it evenly",
    "no dark stretch with two edges": "wear the strap some centimetres above the wrist, with skin on"
    " both sides of it",
    "the dark stretch is not as wide as a strap": "use a strap of 2 to 5 cm; dark sleeves hide it",
    "no depth at the strap": "see that depth is recorded where the arm is; sunlight and shiny straps"
    " blind it",
    "the forearm points to the camera": "move the camera to the side of the movement",
    "the strap is nearer to the elbow than to the wrist": "wear the strap at the wrist; no dark sleeves",
    "no depth image": "record depth at the rate of the colour images",
}


def verdict(search: StrapFound) -> list[str]:
    """How often and how well the strap was seen."""
    total = len(search.reasons)
    good = np.array([not reason for reason in search.reasons], dtype=bool)
    if not good.any():
        worst = max(search.counts, key=lambda name: search.counts[name]) if total else "there are no images"
        return [f"the strap was found in none of {total} images: {worst}"]
    sigma = 1e3 * float(np.sqrt(np.mean(np.median(search.sigma_m[good], axis=0) ** 2)))
    sentences = [
        f"the strap was found in {int(good.sum())} of {total} images ({100 * good.mean():.0f} %), the"
        f" sensor's place to {sigma:.0f} mm per axis"
    ]
    along = search.along[good]
    middle = float(np.median(along))
    wander = float(robust_sigma(along - middle))
    sentences.append(
        f"it sits at {100 * middle:.0f} % of the way from elbow to wrist, +- {100 * wander:.1f} % from"
        " image to image"
    )
    if wander > WANDER:
        sentences.append("that is too much for a tight strap: something else was sometimes detected instead")
    return sentences


def next_time(search: StrapFound) -> list[str]:
    """What to record next, one sentence each."""
    total = max(len(search.reasons), 1)
    sentences = [text for reason, text in _ADVICE.items() if search.counts.get(reason, 0) > 0.1 * total]
    return sentences or ["record in the same way: nothing is missing"]


#: Profiles farther apart than this many steps are drawn apart.
APART_STEPS = 2.5
#: Columns of the picture of profiles.
MOST_COLUMNS = 1600


def strap_page(name: str, search: StrapFound) -> Page:
    """The page of a search for the strap."""
    subtitle = (
        f"Colour {search.topics[0]}, depth {search.topics[1]}. Times are relative to the first colour image."
    )
    return Page(f"The strap in the images: {name}", subtitle, verdict(search), _sections(search))


def _sections(search: StrapFound) -> Iterator[str]:
    yield listing("For the next recording", next_time(search))
    total = max(len(search.reasons), 1)
    rows = [(what, count, f"{100 * count / total:.1f}") for what, count in sorted(search.counts.items())]
    yield tabulated("Found and rejected", "Result for every colour image.", ("", "images", "%"), rows)
    if search.profiles:
        yield figure(
            "Brightness along the forearm",
            "From elbow to wrist over time, as the image has it: the strap is the dark line; dots are where"
            " it was found.",
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
    """Brightness profiles side by side as a picture, and where in them the strap was found."""
    t = np.array([time for time, _ in search.profiles])
    table = np.stack([profile for _, profile in search.profiles], axis=1)
    edges, picture = side_by_side(t, table)
    good = np.array([not reason for reason in search.reasons], bool)
    plot = go.Figure(dots(search.t_s[good], 100 * search.in_profile[good], "strap", OCCLUDED, 6))
    low, high = 100 * SEARCH[0], 100 * SEARCH[1]
    plot.add_layout_image(
        source=f"data:image/png;base64,{b64encode(picture).decode('ascii')}",
        xref="x",
        yref="y",
        x=edges[0],
        y=high,
        sizex=edges[1] - edges[0],
        sizey=high - low,
        sizing="stretch",
        layer="below",
    )
    plot.update_xaxes(title_text="time, s", range=list(edges), showgrid=False)
    plot.update_yaxes(title_text="% of elbow to wrist", range=[low, high], showgrid=False)
    return dress(plot, 380)


def side_by_side(t: FloatArray, table: FloatArray) -> tuple[tuple[float, float], bytes]:
    """Profiles (k, n) at times (n,) as a picture: the times of its edges, and PNG.

    Its columns are even in time, each the nearest profile; where none is near it is transparent, and the
    wrist is at the top.
    """
    import cv2

    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    count = int(np.clip(np.rint((t[-1] - t[0]) / step) + 1, 1, MOST_COLUMNS))
    at = np.linspace(t[0], t[-1], count)
    nearest = np.abs(t[None, :] - at[:, None]).argmin(axis=1)
    near = np.abs(t[nearest] - at) < 0.5 * APART_STEPS * step
    grey = np.rint(table[::-1, nearest]).clip(0, 255).astype(np.uint8)
    alpha = np.broadcast_to(np.where(near, 255, 0).astype(np.uint8), grey.shape)
    _, png = cv2.imencode(".png", np.dstack([grey, grey, grey, alpha]))
    return (float(t[0] - 0.5 * step), float(t[-1] + 0.5 * step)), png.tobytes()


def places(search: StrapFound) -> go.Figure:
    """Position and sigma over time."""
    from plotly.subplots import make_subplots

    plot = make_subplots(rows=2, cols=1, shared_xaxes=True, row_heights=[0.7, 0.3])
    colours = (JOINT_COLOURS["wrist"], JOINT_COLOURS["elbow"], JOINT_COLOURS["hand"])
    for axis, (name, colour) in enumerate(zip("xyz", colours, strict=True)):
        for row, values, shown in (
            (1, search.position[:, axis], True),
            (2, 1e3 * search.sigma_m[:, axis], False),
        ):
            plot.add_trace(dots(search.t_s, values, name, colour, 4, showlegend=shown), row=row, col=1)
    plot.update_yaxes(title_text="m", row=1, col=1)
    plot.update_yaxes(title_text="sigma, mm", rangemode="tozero", row=2, col=1)
    plot.update_xaxes(title_text="time, s", row=2, col=1)
    return dress(plot, 480)
