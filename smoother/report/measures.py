"""The page of a session's measures: how far, how fast, how smooth, where to, and how well that is known."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import plotly.graph_objects as go

from ..evaluation.progress import MOSTLY_RECOVERED
from ..evaluation.words import first_of, interval, is_main, measure_table, measure_words
from ..measures import BothArms, Measure, Measures
from ..table import Table
from .sheet import (
    NO_DIAGNOSIS,
    Html,
    Page,
    PageSection,
    badge,
    capitalised,
    caption,
    explained,
    label,
    limits,
    rendered,
)
from .style import VISIBLE, dress, interval_bars, values_with_intervals

#: Rows of the table, and sentences of the limits.
MOST_ROWS, MOST_LIMITS = 10, 6
#: Angles whose range is drawn.
RANGES = ("elbow_flexion", "shoulder_elevation", "pronation")
#: What the hand may reach.
REACHED = {
    "hand_to_mouth_reached": "hand to mouth",
    "hand_to_head_reached": "hand to head",
    "hand_behind_back_reached": "hand behind the back",
}
#: What is drawn of each movement, and under which heading.
BY_MOVEMENT = {"hand_peak_speed_m_s": "How fast the hand was", "sparc": "How smoothly the hand moved"}
#: More movements are not drawn one by one.
MOST_MOVEMENTS = 24


def measures_page(measures_by_arm: Sequence[Measures], pairs: Sequence[BothArms] = ()) -> Page:
    """The page of a recording's measures."""
    arms = list(measures_by_arm)
    names = ", ".join(dict.fromkeys(arm.name for arm in arms))
    length_s = max((arm.end_s - arm.start_s for arm in arms), default=math.nan)
    labels = " and ".join(arm.arm_label for arm in arms) or "no arm"
    return Page(
        f"Measures of {names or 'a recording'}",
        f"{capitalised(labels)}, {length_s:.0f} s" if math.isfinite(length_s) else labels,
        _verdict(arms),
        _sections(arms, pairs),
    )


def _verdict(arms: Sequence[Measures]) -> Iterator[str]:
    for arm in arms:
        who = f"{capitalised(arm.arm_label)}: "
        if arm.trusted is False:
            yield f"{who}{arm.verdict or 'Not to be trusted.'} Do not use these numbers"
        elif arm.verdict:
            yield f"{who}{arm.verdict}"
    known = [row for arm in arms for row in arm.session if row.is_known]
    if not known:
        yield "Nothing could be measured; the reasons are below"
    elif all(arm.n_draws == 0 for arm in arms):
        yield (
            "The values have no intervals: their uncertainty is unknown. Recover the recording with"
            " draws (smooth --draws 64)"
        )
    main = (each.recovered_share for each in known if is_main(each.key))
    if shares := [round(100 * share) for share in main if math.isfinite(share)]:
        least, most = min(shares), max(shares)
        part = f"{most} %" if least == most else f"Between {least} % and {most} %"
        yield f"{part} of each value comes from recovered time"
    yield NO_DIAGNOSIS


def _sections(arms: Sequence[Measures], pairs: Sequence[BothArms]) -> Iterator[PageSection]:
    trusted = all(arm.trusted is not False for arm in arms)
    symmetry = pairs[0].rows if len(arms) == 2 and len(pairs) == 1 and trusted else ()
    yield _ranges(arms)
    yield _reach(arms)
    for key, heading in BY_MOVEMENT.items():
        yield _by_movement(arms, key, heading)
    known = [row.key for arm in arms for row in arm.session if row.is_known and row.key not in REACHED]
    for arm in arms:
        main = filter(None, map(arm.by_key.get, first_of(list(dict.fromkeys(known)), MOST_ROWS)))
        table = measure_table(f"The main measures{_of(arm, arms)}", "measure", main)
        yield rendered(table, caption("The main measures"))
    alike = measure_table(
        "Right against left, in percent", "0 = alike, above it the right has more", symmetry
    )
    yield rendered(alike)
    yield limits((sentence for arm in arms for sentence in _limits(arm, _of(arm, arms))), MOST_LIMITS)
    keys = [row.key for arm in arms for row in arm.session if row.is_known and is_main(row.key)]
    words = ["interval", "recovered", *(["symmetry"] if symmetry else [])]
    yield explained([*words, *(["unknown"] if REACHED.keys() & set(keys) else [])], keys)


def _of(arm: Measures, arms: Sequence[Measures]) -> str:
    """Which arm, where there are several."""
    return f", {arm.arm_label.replace(' arm', '')}" if len(arms) > 1 else ""


def _ranges(arms: Sequence[Measures]) -> PageSection:
    """The smallest and the largest angle of each joint, each with its interval."""
    figure, names = go.Figure(), []
    for angle, arm in ((angle, arm) for angle in RANGES for arm in arms):
        low, high, whole = (arm.by_key.get(f"{angle}_{what}_deg") for what in ("min", "max", "range"))
        if low is None or high is None or whole is None or not (low.is_known and high.is_known):
            continue
        about = capitalised(whole.name.removesuffix(", range") + _of(arm, arms))
        names.append(f"{label(about)}<br><b>{interval(low.value, high.value, 'deg')}</b>")
        bar = go.Bar(x=[high.value - low.value], y=names[-1:], base=[low.value], orientation="h")
        figure.add_trace(bar.update(marker_color=VISIBLE, marker_opacity=0.45, width=0.4))
        bars = interval_bars(
            *([getattr(end, part) for end in (low, high)] for part in ("value", "low", "high"))
        )
        ends = go.Scatter(x=[low.value, high.value], y=names[-1:] * 2, mode="markers", error_x=bars)
        figure.add_trace(ends.update(marker_color=VISIBLE))
    if not names:
        return PageSection()
    figure.update_xaxes(ticksuffix="°", rangemode="tozero").update_yaxes(autorange="reversed")
    return PageSection(
        "How far the joints moved", plot=dress(figure, 60 + 42 * len(names), head=5, showlegend=False)
    )


def _reach(arms: Sequence[Measures]) -> PageSection:
    """What the hand reached where the draws agree, how near it came, and the volume that it swept."""

    def reached(arm: Measures, key: str) -> Html:
        row, distance = arm.by_key.get(key), arm.by_key.get(key.replace("_reached", "_distance_m"))
        word = "cannot be assessed"
        if row is not None and row.has_interval and row.low == row.high:
            word = "reached" if row.value >= 1 else "not reached"
        is_away = distance is not None and distance.is_known and distance.value > 0
        return badge(word) + (f" {measure_words(distance)} away" if is_away else "")

    def any_known(key: str) -> bool:
        return any((row := arm.by_key.get(key)) is not None and row.is_known for arm in arms)

    rows = [[words, *(reached(arm, key) for arm in arms)] for key, words in REACHED.items() if any_known(key)]
    if any_known(volume := "hand_reach_hull_l"):
        rows.append(["reach volume", *(measure_words(arm.by_key.get(volume)) for arm in arms)])
    columns = ["goal", *(arm.arm_label for arm in arms)]
    return rendered(Table("Where the hand reached", columns, rows))


def _by_movement(arms: Sequence[Measures], key: str, heading: str) -> PageSection:
    """A measure over the movements of each arm, with its intervals."""
    panels, most = [], max((len(arm.movements) for arm in arms), default=0)
    for arm in arms:
        found = [arm.of("movement", place).get(key) for place in range(len(arm.movements))]
        rows = [row for row in found if row is not None][:MOST_MOVEMENTS]
        if not any(row.is_known for row in rows):
            continue
        values = ([getattr(row, part) for row in rows] for part in ("value", "low", "high"))
        figure = go.Figure(values_with_intervals((1 + (row.movement or 0) for row in rows), *values))
        figure.update_xaxes(title_text="movement", dtick=max(1, len(rows) // 12))
        title = Html("<h3>{}</h3>").format(capitalised(arm.arm_label)) if len(arms) > 1 else Html("")
        panels.append((title, dress(figure, 170, head=8, showlegend=False)))
    more = f" The first {MOST_MOVEMENTS} of {most} movements are drawn." if most > MOST_MOVEMENTS else ""
    return PageSection(heading, caption(heading, more=more), panels=panels)


def _limits(arm: Measures, mark: str) -> Iterator[str]:
    """What limits an arm's numbers: what is not known and why, what comes from recovered samples."""

    def listed(rows: Sequence[Measure]) -> str:
        names = [row.name for row in rows]
        return (
            ", ".join(names) if len(names) <= 2 else f"{names[0]} and {len(names) - 1} measures more"
        ) + mark

    main = [row for row in arm.session if is_main(row.key)]
    if doubtful := [row for row in main if row.is_known and row.note]:
        most = 100 * max(row.untrusted_share for row in doubtful)
        yield f"{listed(doubtful)}: up to {most:.0f} % of it comes from gaps that are not trusted"
    unknown = [row for row in main if not row.is_known and row.note]
    for note in dict.fromkeys(row.note for row in unknown):
        yield f"{listed([row for row in unknown if row.note == note])} cannot be assessed: {note}"
    if weak := [row for row in main if row.is_known and row.recovered_share > MOSTLY_RECOVERED]:
        yield f"More than half of {listed(weak)} comes from recovered time"
    yield from arm.notes
