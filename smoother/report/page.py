"""`write_report`: the sections of the page in the order in which they are read; its tables."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib.motion import found_in
from calib.protocol import tables_of

from ..angles import joint_angles
from ..evaluation.measure_agreement import pair_table
from ..evaluation.summary import (
    cameras,
    gap_summaries,
    gap_table,
    rejections,
)
from ..evaluation.validate import Validation
from ..recording import CameraFrame, Recording, Truth
from ..result import Recovery, arm_tags
from ..result.untrusted import untrusted_gaps
from ..table import Table
from . import traces
from .player import player
from .sheet import Fold, Html, Page, PageSection, capitalised, caption, notes, phrase, rendered, trust_badge
from .summary import below, box
from .traces import MOST_POINTS, decimate

#: An arm's recording, result, validation and reference; None where there is none.
Arm = tuple[Recording | None, Recovery, Validation | None, Truth | None]


def write_report(
    arms: Sequence[Arm],
    path: str | os.PathLike[str],
    *,
    camera_frame: CameraFrame | None = None,
    methods: Sequence[Table] = (),
    force: bool = False,
) -> None:
    """Write results as one HTML page that needs no network and no other file: first all, then arm by arm.

    `methods` are tables in which the results are compared with those of other methods.
    """
    reports = [_ArmReport(arm, camera_frame, len(arms) > 1) for arm in arms]
    worst_first = sorted(reports, key=lambda each: each.recovery.estimates.trusted is not False)
    first, start = reports[0], "the recording's own zero"
    if first.recovery.origin_ns > 0:
        began = datetime.datetime.fromtimestamp(first.recovery.origin_ns / 1e9, datetime.UTC)
        start = f"{began:%Y-%m-%d %H:%M:%S} UTC"
    if len(reports) == 1:
        sections: list[PageSection | Fold] = [*first.first(), Fold(first.details(), has_contents=True)]
    else:
        own_tags = arm_tags([each.recovery for each in reports])
        tags = [re.sub("[^a-z0-9]+", "-", tag.lower()) for tag in own_tags]
        rows = []
        for each, tag in zip(reports, tags, strict=True):
            gaps, estimates = each.recovery.gaps, each.recovery.estimates
            link = Html('<a href="#arm-{}">{}</a>').format(tag, each.name)
            hidden = f"{sum(gap.length_s for gap in gaps):.1f}"
            trusted = trust_badge(estimates.trusted, len(gaps), len(untrusted_gaps(each.recovery)))
            rows.append((link, len(gaps), hidden, trusted, estimates.verdict))
        whole = Table("", ("arm", "gaps", "hidden, s", "trusted", "verdict"), rows)
        sections = [rendered(whole), *(section for each in reports for section in each.first())]
        for each, tag in zip(reports, tags, strict=True):
            words = f"Details: {each.name}"
            sections.append(Fold(each.details(), words, f"arm-{tag}", has_contents=each is first))
    sections[:0] = [rendered(each, caption("Methods compared")) for each in methods]
    Page(
        f"Recovered arm motion: {first.recovery.name}",
        f"Method: {first.recovery.method}. Times are relative to {start}.",
        [f"{each.prefix}{text}" for each in worst_first for text in below(each.recovery, each.validation)],
        sections,
        boxes=[box(each.recovery, each.validation, each.name) for each in worst_first],
        beside=_in_motion(reports),
    ).write(path, force)


def _in_motion(reports: Sequence[_ArmReport]) -> PageSection | None:
    """The section in which the arms move; None where none has an answer."""
    recoveries, frame = [each.recovery for each in reports], reports[0].frame
    joint = "wrist" if any("wrist" in recovery.joints for recovery in recoveries) else "sensor"
    said = caption(
        "The arm in motion",
        colours=_colours(recoveries),
        ellipse=any(recovery.trusted.any() for recovery in recoveries) and phrase("ellipse", joint=joint),
        reference=any(each.truth is not None for each in reports) and phrase("reference"),
        seen_from=frame not in (None, CameraFrame.ZUP) and phrase("seen_from"),
    )
    heading = "The arm in motion" if len(reports) == 1 else "The arms in motion"
    return player(heading, said, [(each.recovery, each.truth) for each in reports], frame)


def _colours(recoveries: Sequence[Recovery]) -> Html:
    """What the colours mean that are there."""
    if not any(recovery.trusted.any() for recovery in recoveries):
        return phrase("red")
    return phrase("blue" if all(recovery.trusted.all() for recovery in recoveries) else "blue_and_red")


class _ArmReport:
    """The sections about one arm."""

    def __init__(self, arm: Arm, frame: CameraFrame | None, several: bool) -> None:
        self.recording, self.recovery, self.validation, self.truth = arm
        own = None if self.recording is None else self.recording.camera_frame
        self.frame = own or frame
        self.estimates = found_in(self.recovery, self.recording)
        self.name = capitalised(self.recovery.arm_label) if several else ""
        self.prefix = f"{self.name}: " if several else ""
        self.words = {
            "colours": _colours([self.recovery]),
            "reference": self.truth is not None and phrase("reference"),
            "band": phrase("band" if self.recovery.trusted.any() else "no_band"),
        }

    def first(self) -> Iterator[PageSection]:
        """What follows the first screen: the angles."""
        if not len(self.recovery):
            return
        found, heading = joint_angles(self.recovery), f"{self.prefix}Joint angles"
        missing = [f"{a.title}: {found.reasons[a.name]}" for a in found.angles if a.name in found.reasons]
        plot = traces.angles(self.recovery, found, self.truth)
        if plot is None:
            nothing = "" if missing else "There is no joint angle."
            yield PageSection(heading, "", sentences=missing, below=nothing)
            return
        meanings = "; ".join(
            f"{angle.title}: {angle.meaning.removesuffix('.')}"
            for angle in found.angles
            if np.isfinite(found.values[angle.name]).any()
        )
        around = phrase("angle_band" if self.recovery.trusted.any() else "no_band")
        said = caption("Joint angles", **self.words, around=around)
        yield PageSection(heading, said, plot, sentences=missing, below=capitalised(f"{meanings}."))

    def details(self) -> Iterator[PageSection]:
        """All else about the arm, for those who look for it."""
        recovery, estimates = self.recovery, self.estimates
        errors = () if self.validation is None else self.validation.gaps
        true = {gap.start_s: figures.position_p95_m for gap, figures in errors}
        yield rendered(gap_table("Gaps", gap_summaries(recovery), true), nothing="There is no gap.")
        if self.validation is not None:
            yield from self._against_reference(self.validation)
        if len(recovery):
            yield from self._curves()
        if len(recovery) and recovery.residuals is not None:
            yield rendered(rejections(recovery), nothing="Nothing: all tracked samples were used.")
        if estimates is not None:
            yield from map(rendered, tables_of(estimates.figures))
            yield PageSection("What the recording did not determine", sentences=estimates.not_determined)
        yield rendered(cameras(recovery))
        yield notes([*(self.recording.notes if self.recording is not None else ()), *recovery.notes])
        yield rendered(settings(recovery.config))

    def _against_reference(self, found: Validation) -> Iterator[PageSection]:
        titled = found.alignment.titled
        of_sensor = found.all.position_rms_m is not None or found.all.orientation_rms_deg is not None
        heading, said = "Errors against the reference", "" if of_sensor else "The reference has joints only."
        yield PageSection(
            titled(heading), caption(heading), tables=[found.errors], below=said, sentences=found.notes
        )
        if found.measures is not None:
            heading = "Measures against the reference"
            yield rendered(pair_table(titled(heading), found.measures), caption(heading))
        if found.angles:
            carrying = found.carrying_truth_deg
            said = "" if carrying is None else f"Carrying angle of the reference: {carrying:.1f} degrees."
            yield replace(rendered(found.angle_errors, caption("Angles against the reference")), below=said)

    def _curves(self) -> Iterator[PageSection]:
        recovery = self.recovery.rows(decimate(self.recovery.occluded))
        count = len(self.recovery)
        long = count > MOST_POINTS and phrase("decimated", count=count, most=MOST_POINTS)
        for heading, plot in (
            ("Coordinates over time", traces.coordinates(recovery, self.truth, self.frame)),
            ("How certain the answer is", traces.uncertainty(recovery, self.truth)),
        ):
            true = self.truth is not None and phrase("true")
            said = caption(heading, **self.words, decimated=long, true=true)
            yield PageSection(heading, said, plot)


def settings(config: Mapping[str, Any]) -> Table:
    """The effective configuration, a setting a row."""
    parts = [(name, part if isinstance(part, Mapping) else {"": part}) for name, part in config.items()]
    rows = [(f"{name}.{key}".rstrip("."), str(value)) for name, part in parts for key, value in part.items()]
    return Table("Settings", ("setting", "value"), rows)
