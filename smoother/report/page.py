"""`write_report`: the sections of the page, in the order in which they are read."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterable, Iterator
from html import escape
from importlib import resources
from string import Template

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from calib.motion.estimates import ArmEstimates, found_in

from ..evaluation.advice import advice
from ..evaluation.coverage import camera_residuals
from ..evaluation.validate import Validation
from ..recording import CameraFrame, Recording, Truth
from ..result import Recovery
from ..runtime.atomic import writing
from . import tables
from .decimate import MOST_POINTS, decimate
from .mount import mount
from .path3d import flat_views, path_in_space
from .points import points
from .summary import summary
from .traces import angles, coordinates, residuals, uncertainty
from .trust import against_truth, honesty, honesty_words, timeline
from .truth_comparison import compared

#: Stands for the sections while the page around them is put together.
_HERE = "<!-- sections -->"
_SEEN = '<span class="seen">blue</span> where the camera saw the forearm'
_RECOVERED = '<span class="recovered">orange</span> where it was hidden and was recovered'


def write_report(
    recovery: Recovery,
    path: str | os.PathLike[str],
    *,
    recording: Recording | None = None,
    validation: Validation | None = None,
    truth: Truth | None = None,
    force: bool = False,
) -> None:
    """Write a result as one HTML page that needs nothing else, the network included.

    Parameters
    ----------
    recovery : the result.
    path : the page to write.
    recording : what it was made of; tells the directions of the camera's axes and its own notes.
    validation : figures against a reference.
    truth : the reference, drawn beside the answer.
    force : overwrite a page that exists.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    from .. import __version__

    title = f"Recovered arm motion: {recovery.name}"
    template = Template(resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8"))
    page = template.substitute(
        title=escape(title),
        made=escape(_made(recovery)),
        style=resources.files(__package__).joinpath("style.css").read_text(encoding="utf-8"),
        plotly=get_plotlyjs(),
        content=_HERE,
        version=escape(__version__),
    )
    before, after = page.split(_HERE)
    with writing(path, force) as temporary, open(temporary, "w", encoding="utf-8") as file:
        file.write(before)
        for number, section in enumerate(_sections(recovery, recording, validation, truth)):
            file.write(f"\n{section}" if number else section)
        file.write(after)


def _made(recovery: Recovery) -> str:
    """When the recording was made, where its clock says so."""
    if recovery.origin_ns <= 0:
        return "Times count from the recording's own zero."
    start = datetime.datetime.fromtimestamp(recovery.origin_ns / 1e9, datetime.UTC)
    return f"Times count from {start:%Y-%m-%d %H:%M:%S} UTC."


def _sections(
    recovery: Recovery, recording: Recording | None, validation: Validation | None, truth: Truth | None
) -> Iterator[str]:
    frame = None if recording is None else recording.camera_frame
    found = found_in(recovery, recording)
    words = "".join(f"<p>{escape(text)}</p>" for text in summary(recovery, validation))
    yield f'<div class="summary">{words}</div>'
    if len(recovery):
        yield f"<h2>For the next recording</h2>{_list(advice(recovery, found))}"
        yield from _figures(recovery, truth, frame)
    yield f"<h2>Gaps</h2>{_GAPS}{tables.gaps(recovery)}"
    if validation is not None:
        heading = escape(validation.title("Errors against the reference"))
        yield f"<h2>{heading}</h2>{_ERRORS}{tables.validation(validation)}"
        yield _list(validation.notes)
        for title, caption, drawn, below in () if truth is None else compared(recovery, truth, validation):
            head = f'<h2>{escape(title)}</h2><p class="caption">{caption}</p>'
            yield (_figure(title, caption, drawn) if drawn is not None else head) + below
    if len(recovery):
        yield from _trust(recovery, truth)
    yield from _found(recovery, found)
    yield f"<h2>Figures</h2>{tables.overview(recovery)}"
    notes = dict.fromkeys([*(recording.notes if recording is not None else ()), *recovery.notes])
    yield f"<h2>Notes</h2>{_list(notes) or '<p>There is nothing to note.</p>'}"
    yield f"<h2>Settings</h2>{tables.settings(recovery.config)}"


def _figures(recovery: Recovery, truth: Truth | None, frame: CameraFrame | None) -> Iterator[str]:
    thinned = ""
    if len(recovery) > MOST_POINTS:
        thinned = (
            f" The recording is long: of its {len(recovery)} samples about {MOST_POINTS} are drawn,"
            " closer together in the gaps."
        )
    recovery = recovery.rows(decimate(recovery.occluded))
    reference = " The dashed black line is the reference." if truth is not None else ""
    arms = " The thick lines are the arm (shoulder, elbow, wrist, hand) at a few instants."
    directions = ": left, right and away are as seen from it" if frame not in (None, CameraFrame.ZUP) else ""
    yield _figure(
        "The path in space",
        f"Path of the sensor on the forearm, {_SEEN}, {_RECOVERED}.{reference}"
        f"{arms if len(recovery.joints) > 1 else ''} Drag to turn, scroll to come closer. Axes are the"
        f" camera's{directions}.{thinned}",
        path_in_space(recovery, truth, frame),
    )
    yield _figure(
        "The path, flat",
        "The same path in two flat views, to the same scale.",
        flat_views(recovery, truth, frame),
    )
    shown = points(recovery, truth)
    buttons = " Buttons choose the point: a joint, or the sensor itself." if len(shown) > 1 else ""
    yield _figure(
        "Coordinates over time",
        f"Curves are {_SEEN} and {_RECOVERED}; gaps are shaded. Grey dots are the camera's own samples. The"
        " pale blue band is two standard deviations (sigma) to either side: 95 of 100 true values should lie"
        f" in it.{reference}{buttons} Drag over a stretch to enlarge it, double-click to come back.",
        coordinates(recovery, shown, frame),
    )
    yield _figure(
        "Angles of the arm",
        "Elbow flexion: 0 degrees is a straight arm. Forearm elevation: 0 degrees is level, 90 degrees points"
        " straight up.",
        angles(recovery),
    )
    yield _figure(
        "How certain the answer is",
        "Sigma is one standard deviation of the sensor's position (worst axis) and of its orientation, as"
        " stated by the method. It grows into a gap and falls towards its end."
        + (" The black line is the true error, for comparison." if truth is not None else ""),
        uncertainty(recovery, truth),
    )
    yield _figure(
        "What the camera disagrees with",
        "Distance between each joint that the camera tracked and the recovered joint. Dots took part in the"
        " solution, crosses were set aside (the reason appears under the pointer). A joint that stays far off"
        " for long was seen wrongly, or the sensor has slipped on the arm.",
        residuals(recovery),
    )


def _figure(heading: str, caption: str, figure: go.Figure | None) -> str:
    if figure is None:
        return ""
    for trace in figure.data:  # half the size, and still finer than any screen
        for axis in ("x", "y", "z"):
            if axis in trace and isinstance(trace[axis], np.ndarray) and trace[axis].dtype == np.float64:
                trace[axis] = trace[axis].astype(np.float32)
    drawn = figure.to_html(
        full_html=False,
        include_plotlyjs=False,
        config={"displaylogo": False, "responsive": True, "plotlyServerURL": ""},
        div_id="figure-" + re.sub("[^a-z0-9]+", "-", heading.lower()).strip("-"),
    )
    return f'<h2>{escape(heading)}</h2><p class="caption">{caption}</p><div class="figure">{drawn}</div>'


def _trust(recovery: Recovery, truth: Truth | None) -> Iterator[str]:
    camera, reference = camera_residuals(recovery), against_truth(recovery, truth)
    yield _figure(
        "Whether sigma can be believed",
        "Left: for every probability, the share of samples that lie inside the region in which this"
        " probability is stated to lie. Right: the stated standard deviation of samples against their actual"
        " root mean square. On the dashed line the statement is honest; under it on the left, or above it on"
        " the right, it is too bold. For the camera, the statement is of the distance between a sample that"
        " took part and the recovered joint: the camera's noise, and the joint's own sigma as far as it is"
        " not the same all the time."
        + (" For the reference, it is the sigma of the sensor's position." if reference else "")
        + f" {honesty_words(camera, reference)}",
        honesty(camera, reference),
    )
    aside = tables.set_aside(recovery)
    drawn = timeline(recovery)
    if drawn is not None:
        yield _figure("What was set aside", _ASIDE, drawn) + aside
    elif recovery.residuals is not None:
        yield f"<h2>What was set aside</h2>{aside}"


def _found(recovery: Recovery, found: ArmEstimates | None) -> Iterator[str]:
    """How the sensor sits on the arm: drawn, as tables, and what stayed open."""
    heading, about = (
        "How the sensor sits on the arm",
        tables.calibration(recovery.calibration, recovery.figures),
    )
    drawn = mount(found)
    if found is not None:
        about += tables.camera(found)
        if found.not_determined:
            about += f"<p>What the recording did not determine:</p>{_list(found.not_determined)}"
    if drawn is None:
        yield f'<h2>{heading}</h2><p class="caption">{_CALIBRATION}</p>{about}'
    else:
        yield _figure(heading, f"{_CALIBRATION} {_DRAWN}", drawn) + about


def _list(sentences: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(text[:1].upper() + text[1:])}</li>" for text in sentences)
    return f"<ul>{items}</ul>" if items else ""


_GAPS = (
    '<p class="caption">Stretches in which the camera did not see the forearm. A gap seen on both sides is'
    " held by the camera before and after it; one seen on one side only is not.</p>"
)
_ERRORS = (
    '<p class="caption">rms: root mean square. NEES: mean squared error in standard deviations; 1 where the'
    " stated uncertainty is honest, above 1 where it is too small. Of the last column 95 % is honest.</p>"
)
_CALIBRATION = (
    "Where the joints lie as seen from the sensor, and the length of the upper arm: what was given, improved"
    " by the recording, or what the recording told where nothing was given."
)
_DRAWN = (
    "The dark square is the sensor (drawn 2 cm large) with its axes x, y, z; the ellipse about each joint is"
    " two standard deviations of where it lies."
)
_ASIDE = (
    "Camera samples that called themselves tracked and were not believed, by joint, a colour a reason; pale"
    " ticks took part, gaps are shaded. Whole stretches in one colour mean that the camera was mistaken for"
    " that long; single ticks here and there are ordinary."
)
