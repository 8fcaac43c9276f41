"""`write_report`: the sections of the page in the order in which they are read; and several arms on one."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterator, Sequence
from html import escape

import numpy as np
import plotly.graph_objects as go

from calib.motion import ArmEstimates, found_in

from ..angles import joint_angles
from ..evaluation.advice import advice
from ..evaluation.compare import Comparison
from ..evaluation.coverage import camera_residuals
from ..evaluation.summary import trust_word
from ..evaluation.validate import Validation
from ..recording import CameraFrame, Recording, Truth
from ..result import Recovery, arm_tags
from ..result.untrusted import untrusted_gaps
from . import tables
from .chart import NOT_TRUSTED, badge
from .method_comparison import sections as of_comparison
from .method_comparison import verdict
from .player import flat_views, player, points
from .sheet import (
    CONTENTS,
    Html,
    Page,
    bullets,
    capitalised,
    figure,
    folded,
    headed,
    listing,
    qualified,
    table,
)
from .style import MOST_POINTS, decimate
from .summary import below, box
from .traces import angles, coordinates, residuals, uncertainty
from .truth_comparison import against_truth, calibration_curves, compared, share_inside, timeline

_SEEN = '<span class="seen">blue</span> where the camera saw the forearm'
_RECOVERED = '<span class="recovered">orange</span> where it was hidden and was recovered'
_UNTRUSTED = '<span class="untrusted">red</span> where the answer is not to be trusted'
_REFERENCE = " The dashed line is the reference."


def write_report(
    recovery: Recovery,
    path: str | os.PathLike[str],
    *,
    recording: Recording | None = None,
    validation: Validation | None = None,
    truth: Truth | None = None,
    camera_frame: CameraFrame | None = None,
    force: bool = False,
) -> None:
    """Write a result as one HTML page that needs no network and no other file."""
    Page(
        f"Recovered arm motion: {recovery.name}",
        origin(recovery),
        below(recovery, validation),
        sections(recovery, recording, validation, truth, camera_frame),
        boxes=[box(recovery, validation)],
        beside=in_motion([(recovery, truth)], _frame(recording, camera_frame)),
    ).write(path, force)


def origin(recovery: Recovery) -> str:
    """When the recording was made, where its clock shows it."""
    if recovery.origin_ns <= 0:
        return "Times are relative to the recording's own zero."
    start = datetime.datetime.fromtimestamp(recovery.origin_ns / 1e9, datetime.UTC)
    return f"Times are relative to {start:%Y-%m-%d %H:%M:%S} UTC."


def sections(
    recovery: Recovery,
    recording: Recording | None,
    validation: Validation | None,
    truth: Truth | None,
    frame: CameraFrame | None,
) -> Iterator[str]:
    """The sections about one arm below its first screen, as HTML; parameters as of `write_report`."""
    frame = _frame(recording, frame)
    yield from _first(recovery, recording, truth)
    yield from folded(details(recovery, recording, validation, truth, frame), below=CONTENTS)


def _frame(recording: Recording | None, frame: CameraFrame | None) -> CameraFrame | None:
    return frame if recording is None else recording.camera_frame or frame


def _first(recovery: Recovery, recording: Recording | None, truth: Truth | None) -> Iterator[str]:
    """What follows the first screen: what to do where the set-up is wrong, and the angles."""
    if not len(recovery):
        return
    if recovery.estimates.trusted is False:
        yield listing("What to do", advice(recovery, found_in(recovery, recording)))
    yield _angles(recovery, truth)


def _angles(recovery: Recovery, truth: Truth | None) -> str:
    """The joint angles with their bands, and why those that are not there are not."""
    found = joint_angles(recovery)
    missing = [
        f"{angle.title}: {found.reasons[angle.name]}" for angle in found.angles if angle.name in found.reasons
    ]
    plot = angles(recovery, found, truth)
    if plot is None:
        return listing("Joint angles", missing, "The recording has no joint angle.")
    meanings = "; ".join(
        f"{angle.title}: {angle.meaning.removesuffix('.')}"
        for angle in found.angles
        if np.isfinite(found.values[angle.name]).any()
    )
    around = _NO_BAND
    if recovery.trusted.any():
        around = "The band contains 95 of 100 true values; gaps are shaded."
    reference = _REFERENCE if truth is not None else ""
    caption = f"Curves are {_colours([recovery])}. {around}{reference}"
    below = f'<p class="caption"><small>{escape(capitalised(meanings))}.</small></p>'
    return _figure("Joint angles", caption, plot) + bullets(missing) + below


def details(
    recovery: Recovery,
    recording: Recording | None,
    validation: Validation | None,
    truth: Truth | None,
    frame: CameraFrame | None,
) -> Iterator[str]:
    """All else about one arm, for those who look for it; parameters as of `write_report`."""
    estimates = found_in(recovery, recording)
    if len(recovery) and recovery.estimates.trusted is not False:
        yield listing("For the next recording", advice(recovery, estimates))
    yield headed("Gaps", _GAPS) + tables.gaps(recovery, validation)
    if validation is not None:
        heading = validation.title("Errors against the reference")
        yield headed(heading, _ERRORS) + tables.validation(validation, recovery) + bullets(validation.notes)
        yield tables.measured(validation)
        for title, caption, plot, below in () if truth is None else compared(recovery, truth, validation):
            yield (_figure(title, caption, plot) or headed(title, caption)) + below
    if len(recovery):
        yield from _figures(recovery, truth, frame)
        yield from _trust(recovery, truth)
    yield _mounting(recovery, estimates)
    if recovery.estimates.cameras:
        yield headed("Cameras", _CAMERAS) + tables.cameras(recovery)
    yield headed("Figures") + tables.overview(recovery)
    notes = dict.fromkeys([*(recording.notes if recording is not None else ()), *recovery.notes])
    yield listing("Notes", notes, "There is nothing to note.")
    yield headed("Settings") + tables.settings(recovery.config)


def in_motion(
    arms: Sequence[tuple[Recovery, Truth | None]],
    frame: CameraFrame | None,
) -> str:
    """The section in which the arms move; "" where none has an answer."""
    reference = _REFERENCE if any(truth is not None for _, truth in arms) else ""
    joint = "wrist" if any("wrist" in recovery.joints for recovery, _ in arms) else "sensor"
    colours = _colours([recovery for recovery, _ in arms])
    ellipse = f", the ellipse about the {joint} contains it in 95 of 100 cases"
    if not any(recovery.trusted.any() for recovery, _ in arms):
        ellipse = ""
    return player(
        "The arm in motion" if len(arms) == 1 else "The arms in motion",
        Html(
            f"The arm is {colours}. The thin grey skeleton is the camera's own, the square is the"
            f" sensor{ellipse}.{reference} Axes are the"
            f" camera's{_directions(frame)}. On paper: the whole path, and the arm at some instants."
        ),
        arms,
        frame,
    )


def _colours(recoveries: Sequence[Recovery]) -> str:
    """What the colours mean that are there."""
    if not any(recovery.trusted.any() for recovery in recoveries):
        return f"{_UNTRUSTED[: _UNTRUSTED.index('</span>')]}</span>: the answer is not to be trusted"
    if all(recovery.trusted.all() for recovery in recoveries):
        return f"{_SEEN} and {_RECOVERED}"
    return f"{_SEEN}, {_RECOVERED} and {_UNTRUSTED}"


def _directions(frame: CameraFrame | None) -> str:
    return ": left, right and away are as seen from it" if frame not in (None, CameraFrame.ZUP) else ""


def _figures(recovery: Recovery, truth: Truth | None, frame: CameraFrame | None) -> Iterator[str]:
    decimated = ""
    if len(recovery) > MOST_POINTS:
        decimated = (
            f" The recording is long: of its {len(recovery)} samples about {MOST_POINTS} are drawn,"
            " closer together in the gaps."
        )
    reference = _REFERENCE if truth is not None else ""
    colours = _colours([recovery])
    recovery = recovery.rows(decimate(recovery.occluded))
    yield _figure(
        "The path, flat",
        f"The path of the sensor on the forearm in two flat views, to the same scale.{decimated}",
        flat_views(recovery, truth, frame),
    )
    around = _BAND if recovery.trusted.any() else _NO_BAND
    shown = points(recovery, truth)
    buttons = " Buttons choose the point: a joint, or the sensor itself." if len(shown) > 1 else ""
    yield _figure(
        "Coordinates over time",
        f"Curves are {colours}; gaps are shaded. Grey dots are the camera's own samples."
        f" {around}{reference}{buttons} Drag over a time to enlarge it, double-click to come back.",
        coordinates(recovery, shown, frame),
    )
    yield _figure(
        "How certain the answer is",
        "In 95 of 100 cases the error of the sensor's position (in space), and of its orientation, lies below"
        " the curve, as stated by the method. It grows into a gap and falls towards its end."
        + (" The thin line is the true error: 95 % of it should lie below." if truth is not None else ""),
        uncertainty(recovery, truth),
    )
    yield _figure(
        "Camera residuals",
        "Distance between each joint that the camera tracked and the recovered joint. Dots were used in the"
        " solution, crosses were rejected (the reason appears under the pointer). A joint that stays far off"
        " for long was seen wrongly, or the sensor has slipped on the arm.",
        residuals(recovery),
    )


def _figure(heading: str, caption: str, plot: go.Figure | None) -> str:
    """A section with a plot, its data in single precision: half the size, and still finer than any screen."""
    if plot is None:
        return ""
    for trace in plot.data:
        for axis in ("x", "y"):
            if axis in trace and isinstance(trace[axis], np.ndarray) and trace[axis].dtype == np.float64:
                trace[axis] = trace[axis].astype(np.float32)
    return figure(heading, Html(caption), plot)


def _trust(recovery: Recovery, truth: Truth | None) -> Iterator[str]:
    if recovery.estimates.trusted is not False:
        yield _consistency(recovery, truth)
    if recovery.residuals is not None:
        heading = "Rejected camera samples"
        yield (_figure(heading, _REJECTED, timeline(recovery)) or headed(heading)) + tables.rejections(
            recovery
        )


def _consistency(recovery: Recovery, truth: Truth | None) -> str:
    """Whether what is stated holds: against the camera, and against a reference."""
    camera, reference = camera_residuals(recovery), against_truth(recovery, truth)
    return _figure(
        "Whether sigma is consistent with the errors",
        "Left: for every probability, the share of samples that lie inside the region in which this"
        " probability is stated to lie. Right: the stated standard deviation of samples against their actual"
        " root mean square. On the dashed line both are consistent; under it on the left, or above it on the"
        " right, the statement is over-confident. For the camera, the statement is of the distance between a"
        " sample that was used and the recovered joint: the camera's noise, and the joint's own sigma as far"
        " as it is not the same all the time."
        + (" For the reference, it is the sigma of the sensor's position." if reference else "")
        + f" {share_inside(camera, reference)}",
        calibration_curves(camera, reference),
    )


def _mounting(recovery: Recovery, estimates: ArmEstimates | None) -> str:
    """Sensor mounting on the arm: as tables, and what stayed open."""
    about = tables.calibration(recovery.calibration, recovery.estimates)
    if estimates is not None:
        about += tables.camera(estimates)
        if estimates.not_determined:
            about += f"<p>What the recording did not determine:</p>{bullets(estimates.not_determined)}"
    return headed("Sensor mounting on the arm", _CALIBRATION) + about


_CAMERAS = (
    "Each camera was placed by the joints that it and the first one saw. A gap is a time in which none of"
    " them saw the forearm."
)
_GAPS = (
    "Times in which the camera did not see the forearm. 95 of 100 errors lie below what is stated, at"
    " the least certain moment of a gap. The camera constrains a gap seen on both sides before and after it;"
    " one seen on one side only is not."
)
_BAND = "The pale blue band contains 95 of 100 true values of each coordinate."
_NO_BAND = "No band is drawn: it would not be valid."
_ERRORS = (
    "rms: root mean square. NEES: mean squared error in standard deviations; 1 where the stated uncertainty"
    " is consistent with the errors, above 1 where it is over-confident. Of the samples, 95 %"
    " inside the stated region is consistent."
)
_CALIBRATION = (
    "Where the joints lie as seen from the sensor, and the length of the upper arm: as given and improved by"
    " the recording, or as estimated from the recording where nothing was given."
)
_REJECTED = (
    "Tracked camera samples that were not used, by joint, one colour per reason; pale ticks were used,"
    " gaps are shaded. A long line in one colour means that the camera was mistaken for that long;"
    " single ticks here and there are ordinary."
)


#: An arm's recording, answer, and what it was held against, where it was.
Arm = tuple[Recording | None, Recovery] | tuple[Recording | None, Recovery, Validation | None, Truth | None]


def write_arms_report(
    arms: Sequence[Arm],
    path: str | os.PathLike[str],
    *,
    camera_frame: CameraFrame | None = None,
    force: bool = False,
) -> None:
    """Write the results of several arms as one HTML page: a summary of each, then arm by arm."""
    recoveries = [arm[1] for arm in arms]
    marks = [_mark(tag) for tag in arm_tags(recoveries)]
    frame = next((arm[0].camera_frame for arm in arms if arm[0] is not None), None) or camera_frame
    worst_first = sorted(arms, key=lambda arm: arm[1].estimates.trusted is not False)
    Page(
        f"Recovered arm motion: {recoveries[0].name}",
        origin(recoveries[0]),
        [f"{_name(arm[1])}: {text}" for arm in worst_first for text in below(arm[1], _of(arm)[0])],
        _sections(arms, marks, frame),
        boxes=[box(arm[1], _of(arm)[0], _name(arm[1])) for arm in worst_first],
        beside=in_motion([(arm[1], _of(arm)[1]) for arm in arms], frame),
    ).write(path, force)


def _sections(arms: Sequence[Arm], marks: Sequence[str], frame: CameraFrame | None) -> Iterator[str]:
    links = [
        Html(f'<a href="#arm-{mark}">{escape(_name(arm[1]))}</a>')
        for arm, mark in zip(arms, marks, strict=True)
    ]
    rows = [
        (
            link,
            len(arm[1].gaps),
            f"{sum(gap.length_s for gap in arm[1].gaps):.1f}",
            Html(_trusted(arm[1])),
            arm[1].estimates.verdict,
        )
        for link, arm in zip(links, arms, strict=True)
    ]
    yield table(("arm", "gaps", "hidden, s", "trusted", "verdict"), rows)
    for arm, mark in zip(arms, marks, strict=True):
        for section in _first(arm[1], arm[0], _of(arm)[1]):
            yield qualified(section.replace("<h2>", f"<h2>{escape(_name(arm[1]))}: ", 1), mark)
    for number, (arm, mark) in enumerate(zip(arms, marks, strict=True)):
        yield f'<section id="arm-{mark}">'
        inside = details(arm[1], arm[0], *_of(arm), frame)
        name = f"Details: {_name(arm[1])}"
        for section in folded(inside, name, below=CONTENTS if not number else ""):
            yield qualified(section, mark)
        yield "</section>"


def _trusted(recovery: Recovery) -> str:
    """Whether an arm's answer is to be trusted, as a word in its colour."""
    trusted, untrusted = recovery.estimates.trusted, len(untrusted_gaps(recovery))
    word = trust_word(trusted, len(recovery.gaps), untrusted)
    if trusted is False:
        return badge(NOT_TRUSTED)
    return badge(word, "care") if untrusted else escape(word) or "–"


def _of(arm: Arm) -> tuple[Validation | None, Truth | None]:
    """What an arm was held against."""
    return (arm[2], arm[3]) if len(arm) == 4 else (None, None)


def _name(recovery: Recovery) -> str:
    return capitalised(recovery.arm_label)


def arms_comparison_page(compared: Sequence[tuple[Recording, Comparison]]) -> Page:
    """The comparisons of several arms on one page, arm by arm."""
    arms = [
        (capitalised(recording.arm_label), verdict(comparison), of_comparison(comparison, recording))
        for recording, comparison in compared
    ]
    recording, comparison = compared[0]
    return Page(
        comparison.title(f"Methods compared: {recording.name}"),
        f"{len(comparison.rows)} methods, {len(compared)} arms, each compared with its own truth.",
        [f"{name}: {text}" for name, texts, _ in arms for text in texts],
        (
            part
            for name, _, parts in arms
            for part in (f"<h1>{escape(name)}</h1>", *(qualified(one, _mark(name)) for one in parts))
        ),
    )


def _mark(name: str) -> str:
    """A name as a part of an id."""
    return re.sub("[^a-z0-9]+", "-", name.lower())
