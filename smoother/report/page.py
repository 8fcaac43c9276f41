"""`write_report`: the sections of the page in the order in which they are read; and several arms on one."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calib.motion import found_in

from ..angles import joint_angles
from ..evaluation.advice import advice
from ..evaluation.measure_agreement import agreement_table, pair_table
from ..evaluation.summary import cameras, trust_word
from ..evaluation.validate import Validation
from ..recording import CameraFrame, Recording, Truth
from ..result import Recovery, arm_tags
from ..result.untrusted import untrusted_gaps
from ..table import Table
from . import tables, traces
from .player import player, points
from .sheet import (
    NOT_TRUSTED,
    Fold,
    Html,
    Page,
    PageSection,
    badge,
    capitalised,
    caption,
    notes,
    rendered,
)
from .style import MOST_POINTS, decimate
from .summary import below, box

_SEEN = '<span class="seen">blue</span> where the camera saw the forearm'
_RECOVERED = '<span class="recovered">orange</span> where it was hidden and was recovered'
_UNTRUSTED = '<span class="untrusted">red</span>'
_REFERENCE = " The dashed line is the reference."

#: An arm's recording, answer, and what it was held against, where it was.
Arm = tuple[Recording | None, Recovery] | tuple[Recording | None, Recovery, Validation | None, Truth | None]


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
    arm = (recording, recovery, validation, truth)
    write_arms_report([arm], path, camera_frame=camera_frame, force=force)


def write_arms_report(
    arms: Sequence[Arm],
    path: str | os.PathLike[str],
    *,
    camera_frame: CameraFrame | None = None,
    force: bool = False,
) -> None:
    """Write the results of several arms as one HTML page: a summary of each, then arm by arm."""
    reports = [_ArmReport(arm, camera_frame, len(arms) > 1) for arm in arms]
    worst_first = sorted(reports, key=lambda each: each.recovery.estimates.trusted is not False)
    first = reports[0]
    if len(reports) == 1:
        sections: list[PageSection | Fold] = [*first.first(), Fold(first.details(), has_contents=True)]
    else:
        tags = [
            re.sub("[^a-z0-9]+", "-", tag.lower()) for tag in arm_tags([each.recovery for each in reports])
        ]
        sections = [_arms(reports, tags), *(section for each in reports for section in each.first())]
        for each, tag in zip(reports, tags, strict=True):
            words = f"Details: {each.name}"
            sections.append(Fold(each.details(), words, f"arm-{tag}", has_contents=each is first))
    Page(
        f"Recovered arm motion: {first.recovery.name}",
        _origin(first.recovery),
        [f"{each.prefix}{text}" for each in worst_first for text in below(each.recovery, each.validation)],
        sections,
        boxes=[box(each.recovery, each.validation, each.name) for each in worst_first],
        beside=_in_motion(reports),
    ).write(path, force)


def _origin(recovery: Recovery) -> str:
    """When the recording was made, where its clock shows it."""
    if recovery.origin_ns <= 0:
        return "Times are relative to the recording's own zero."
    start = datetime.datetime.fromtimestamp(recovery.origin_ns / 1e9, datetime.UTC)
    return f"Times are relative to {start:%Y-%m-%d %H:%M:%S} UTC."


def _arms(reports: Sequence[_ArmReport], tags: Sequence[str]) -> PageSection:
    rows = [
        (
            Html('<a href="#arm-{}">{}</a>').format(tag, each.name),
            len(each.recovery.gaps),
            f"{sum(gap.length_s for gap in each.recovery.gaps):.1f}",
            _trusted(each.recovery),
            each.recovery.estimates.verdict,
        )
        for each, tag in zip(reports, tags, strict=True)
    ]
    return PageSection(tables=[Table("", ("arm", "gaps", "hidden, s", "trusted", "verdict"), rows)])


def _trusted(recovery: Recovery) -> str:
    """Whether an arm's answer is to be trusted, as a word in its colour."""
    trusted, untrusted = recovery.estimates.trusted, len(untrusted_gaps(recovery))
    if trusted is False:
        return badge(NOT_TRUSTED)
    word = trust_word(trusted, len(recovery.gaps), untrusted)
    return badge(word) if untrusted else word or "–"


def _in_motion(reports: Sequence[_ArmReport]) -> PageSection | None:
    """The section in which the arms move; None where none has an answer."""
    recoveries = [each.recovery for each in reports]
    reference = _REFERENCE if any(each.truth is not None for each in reports) else ""
    joint = "wrist" if any("wrist" in recovery.joints for recovery in recoveries) else "sensor"
    ellipse = f", the ellipse about the {joint} contains it in 95 of 100 cases"
    if not any(recovery.trusted.any() for recovery in recoveries):
        ellipse = ""
    frame = reports[0].frame
    seen_from = ": left, right and away are as seen from it"
    return player(
        "The arm in motion" if len(reports) == 1 else "The arms in motion",
        caption(
            "The arm in motion",
            colours=_colours(recoveries),
            ellipse=ellipse,
            reference=reference,
            seen_from=seen_from if frame not in (None, CameraFrame.ZUP) else "",
        ),
        [(each.recovery, each.truth) for each in reports],
        frame,
    )


def _colours(recoveries: Sequence[Recovery]) -> Html:
    """What the colours mean that are there."""
    if not any(recovery.trusted.any() for recovery in recoveries):
        return Html(f"{_UNTRUSTED}: the answer is not to be trusted")
    if all(recovery.trusted.all() for recovery in recoveries):
        return Html(f"{_SEEN} and {_RECOVERED}")
    return Html(f"{_SEEN}, {_RECOVERED} and {_UNTRUSTED} where the answer is not to be trusted")


class _ArmReport:
    """The sections about one arm."""

    def __init__(self, arm: Arm, frame: CameraFrame | None, several: bool) -> None:
        self.recording, self.recovery = arm[:2]
        self.validation, self.truth = arm[2:] if len(arm) == 4 else (None, None)
        own = None if self.recording is None else self.recording.camera_frame
        self.frame = own or frame
        self.estimates = found_in(self.recovery, self.recording)
        self.name = capitalised(self.recovery.arm_label) if several else ""
        self.prefix = f"{self.name}: " if several else ""
        self.reference = _REFERENCE if self.truth is not None else ""
        self.colours = _colours([self.recovery])

    def first(self) -> Iterator[PageSection]:
        """What follows the first screen: what to do where the set-up is wrong, and the angles."""
        if not len(self.recovery):
            return
        if self.recovery.estimates.trusted is False:
            sentences = advice(self.recovery, self.estimates)
            yield PageSection(f"{self.prefix}What to do", sentences=sentences)
        yield self._angles()

    def _angles(self) -> PageSection:
        """The joint angles with their bands, and why those that are not there are not."""
        found = joint_angles(self.recovery)
        missing = [f"{a.title}: {found.reasons[a.name]}" for a in found.angles if a.name in found.reasons]
        heading = f"{self.prefix}Joint angles"
        plot = traces.angles(self.recovery, found, self.truth)
        if plot is None:
            nothing = "" if missing else "There is no joint angle."
            return PageSection(heading, "", sentences=missing, below=nothing)
        meanings = "; ".join(
            f"{angle.title}: {angle.meaning.removesuffix('.')}"
            for angle in found.angles
            if np.isfinite(found.values[angle.name]).any()
        )
        around = _NO_BAND
        if self.recovery.trusted.any():
            around = "The band contains 95 of 100 true values; gaps are shaded."
        said = caption("Joint angles", colours=self.colours, around=around, reference=self.reference)
        return PageSection(heading, said, plot, sentences=missing, below=capitalised(f"{meanings}."))

    def details(self) -> Iterator[PageSection]:
        """All else about the arm, for those who look for it."""
        recovery, validation = self.recovery, self.validation
        if len(recovery) and recovery.estimates.trusted is not False:
            yield PageSection("For the next recording", sentences=advice(recovery, self.estimates))
        found = tables.gaps(recovery, validation)
        yield replace(rendered(found), below="" if found.rows else "There is no gap.")
        if validation is not None:
            yield from self._against_reference(validation)
        if len(recovery):
            yield from self._curves()
            yield from self._trust()
        mounting = tables.calibration(recovery)
        yield replace(rendered(mounting), below="" if mounting.rows else "None was given or needed.")
        if self.estimates is not None:
            yield rendered(tables.camera(self.estimates))
            open_questions = self.estimates.not_determined
            yield PageSection("What the recording did not determine", sentences=open_questions)
        yield rendered(cameras(recovery))
        yield rendered(tables.overview(recovery))
        yield notes([*(self.recording.notes if self.recording is not None else ()), *recovery.notes])
        yield rendered(tables.settings(recovery.config))

    def _against_reference(self, found: Validation) -> Iterator[PageSection]:
        heading = found.alignment.titled("Errors against the reference")
        of_sensor = found.all.position_rms_m is not None or found.all.orientation_rms_deg is not None
        own = [found.errors] if of_sensor or not found.joint_errors.rows else []
        said = "" if own else "The reference has joints only."
        about = caption("Errors against the reference")
        yield PageSection(heading, about, tables=own, below=said, sentences=found.notes)
        yield from map(rendered, (found.joint_errors, found.gap_errors))
        if (measures := found.measures) is not None:
            for heading, table in (
                ("Measures against the reference", pair_table),
                ("How well the measures agree", agreement_table),
            ):
                about = caption(heading, notes=" ".join(measures.notes))
                yield rendered(table(found.alignment.titled(heading), measures), about)
        if found.angles:
            carrying = found.carrying_truth_deg
            said = "" if carrying is None else f"Carrying angle of the reference: {carrying:.1f} degrees."
            about = caption("Angles against the reference")
            yield replace(rendered(found.angle_errors, about), below=said)

    def _curves(self) -> Iterator[PageSection]:
        decimated = ""
        if len(self.recovery) > MOST_POINTS:
            decimated = (
                f" The recording is long: of its {len(self.recovery)} samples about {MOST_POINTS} are drawn,"
                " closer together in the gaps."
            )
        recovery = self.recovery.rows(decimate(self.recovery.occluded))
        shown = points(recovery, self.truth)
        yield PageSection(
            "Coordinates over time",
            caption(
                "Coordinates over time",
                colours=self.colours,
                band=_BAND if recovery.trusted.any() else _NO_BAND,
                reference=self.reference,
                decimated=decimated,
                buttons=_BUTTONS if len(shown) > 1 else "",
            ),
            traces.coordinates(recovery, shown, self.frame),
        )
        yield PageSection(
            "How certain the answer is",
            caption("How certain the answer is", true=_TRUE if self.truth is not None else ""),
            traces.uncertainty(recovery, self.truth),
        )
        yield PageSection("Camera residuals", plot=traces.residuals(recovery))

    def _trust(self) -> Iterator[PageSection]:
        """Whether what is stated holds, against the camera and a reference; which samples were rejected."""
        if self.recovery.estimates.trusted is not False:
            yield rendered(tables.consistent(self.recovery, self.truth))
        if self.recovery.residuals is not None:
            rejected = tables.rejections(self.recovery)
            nothing = "" if rejected.rows else "Nothing: all tracked samples were used."
            yield replace(rendered(rejected), below=nothing)


_BAND = "The pale blue band contains 95 of 100 true values of each coordinate."
_BUTTONS = " Buttons choose the point: a joint, or the sensor itself."
_TRUE = (
    " The thin line is the true error: 95 % of it should lie below; click on a joint's name for its error."
)
_NO_BAND = "No band is drawn: it would not be valid."
