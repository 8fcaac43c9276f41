"""The page of a session's measures: how far, how fast, how smooth, where to, and how well that is known."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import plotly.graph_objects as go

from ..evaluation.progress import MOSTLY_RECOVERED
from ..evaluation.words import first_of, interval, is_main, number, quantity, shown_unit
from ..measures import BothArms, Measure, Measures
from ..table import Table
from .sheet import (
    NO_DIAGNOSIS,
    Html,
    Page,
    PageSection,
    badge,
    capitalised,
    explained,
    label,
    limits,
    rendered,
)
from .style import VISIBLE, dress, interval_bars


def with_interval(row: Measure) -> str:
    """The value, its 95 % interval in brackets, and the unit."""
    if not row.has_interval:
        return quantity(row.value, row.unit)
    if row.unit.startswith("deg"):
        return f"{quantity(row.value, row.unit)} ({interval(row.low, row.high, row.unit)})"
    between = f"{number(row.low, row.unit)} to {number(row.high, row.unit)}"
    return f"{number(row.value, row.unit)} ({between})\u00a0{shown_unit(row.unit)}".rstrip()


def share(row: Measure | None) -> str:
    """How much comes from recovered samples, in percent."""
    if row is None or not math.isfinite(row.recovered_share):
        return "–"
    return f"{100 * row.recovered_share:.0f}\u00a0%"


def reached(arm: Measures, key: str) -> Html:
    """In words where the draws agree, and how near the hand came."""
    row, distance = arm.by_key.get(key), arm.by_key.get(key.replace("_reached", "_distance_m"))
    if row is None or not row.has_interval or row.low != row.high:
        word = "cannot be assessed"
    else:
        word = "reached" if row.value >= 1 else "not reached"
    away = distance is not None and distance.is_known and distance.value > 0
    return badge(word) + (f" {with_interval(distance)} away" if distance is not None and away else "")


def listed(names: Sequence[str]) -> str:
    """Two names, or the first and how many more."""
    return ", ".join(names) if len(names) <= 2 else f"{names[0]} and {len(names) - 1} measures more"


def of_arm(arm: Measures, arms: Sequence[Measures]) -> str:
    """Which arm, where there are several."""
    return f", {arm.arm_label.replace(' arm', '')}" if len(arms) > 1 else ""


def symmetry(index: Measure | None) -> str | None:
    """A symmetry index and its interval in whole percent; None where there is none."""
    if index is None or not index.is_known:
        return None
    between = f" ({index.low:.0f} to {index.high:.0f})" if index.has_interval else ""
    return f"{index.value:+.0f}\u00a0%{between}".replace("-", "−")


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
    if not any(row.is_known for arm in arms for row in arm.session):
        yield "Nothing could be measured; the reasons are below"
    elif all(arm.n_draws == 0 for arm in arms):
        yield (
            "The values have no intervals: their uncertainty is unknown. Recover the recording with"
            " draws (smooth --draws 64)"
        )
    shares = [
        row.recovered_share
        for arm in arms
        for row in arm.session
        if is_main(row.key) and math.isfinite(row.recovered_share)
    ]
    if shares:
        least, most = round(100 * min(shares)), round(100 * max(shares))
        part = f"{most} %" if least == most else f"Between {least} % and {most} %"
        yield f"{part} of each value comes from recovered time"
    yield NO_DIAGNOSIS


def _sections(arms: Sequence[Measures], pairs: Sequence[BothArms]) -> Iterator[PageSection]:
    yield _ranges(arms)
    yield _reach(arms)
    yield _by_movement(
        arms,
        "hand_peak_speed_m_s",
        "How fast the hand was",
        "The hand's highest speed in each movement, m/s, in the order of time.",
    )
    yield _by_movement(
        arms,
        "sparc",
        "How smoothly the hand moved",
        "SPARC of each movement, in the order of time: nearer to zero is smoother. A long movement with many"
        " turns is less smooth than a short one, whoever performs it.",
    )
    yield _table(arms, pairs)
    yield _limits(arms)
    keys = [row.key for arm in arms for row in arm.session if row.is_known and is_main(row.key)]
    words = ["interval", "recovered", *(["symmetry"] if _indices(arms, pairs) else [])]
    words += ["unknown"] if REACHED.keys() & set(keys) else []
    yield explained(words, keys)


def _ranges(arms: Sequence[Measures]) -> PageSection:
    """The smallest and the largest angle of each joint, each with its interval."""
    figure, names = go.Figure(), []
    for angle in RANGES:
        for arm in arms:
            low, high, whole = (arm.by_key.get(f"{angle}_{what}_deg") for what in ("min", "max", "range"))
            if low is None or high is None or whole is None or not (low.is_known and high.is_known):
                continue
            about = capitalised(whole.name.removesuffix(", range") + of_arm(arm, arms))
            names.append(f"{label(about)}<br><b>{interval(low.value, high.value, 'deg')}</b>")
            bar = go.Bar(x=[high.value - low.value], y=names[-1:], base=[low.value], orientation="h")
            figure.add_trace(bar.update(marker_color=VISIBLE, marker_opacity=0.45, width=0.4))
            ends = (low, high)
            bars = interval_bars(*([getattr(end, part) for end in ends] for part in ("value", "low", "high")))
            dots = go.Scatter(x=[end.value for end in ends], y=names[-1:] * 2, mode="markers", error_x=bars)
            figure.add_trace(dots.update(marker_color=VISIBLE))
    if not names:
        return PageSection()
    figure.update_xaxes(ticksuffix="°", rangemode="tozero").update_yaxes(autorange="reversed")
    return PageSection(
        "How far the joints moved",
        "The blue bar goes from the smallest to the largest angle; the dark lines at its ends are their 95 %"
        " intervals.",
        dress(figure, 60 + 42 * len(names), head=5, showlegend=False),
    )


def _reach(arms: Sequence[Measures]) -> PageSection:
    """What the hand reached, and the volume that it passed through."""
    rows: list[list[object]] = [
        [words, *(reached(arm, key) for arm in arms)]
        for key, words in REACHED.items()
        if any((row := arm.by_key.get(key)) is not None and row.is_known for arm in arms)
    ]
    volumes = [arm.by_key.get("hand_reach_hull_l") for arm in arms]
    if any(volume is not None and volume.is_known for volume in volumes):
        known = [with_interval(volume) if volume is not None else "–" for volume in volumes]
        rows.append(["reach volume", *known])
    caption = "Reached: at least once in every drawn motion; followed by the hand's closest distance."
    columns = ["goal", *(arm.arm_label for arm in arms)]
    return rendered(Table("Where the hand reached", columns, rows, caption))


def _by_movement(arms: Sequence[Measures], key: str, heading: str, caption: str) -> PageSection:
    """A measure over the movements of each arm, with its intervals."""
    found = {}
    for arm in arms:
        rows = [row for n in range(len(arm.movements)) if (row := arm.of("movement", n).get(key)) is not None]
        if any(row.is_known for row in rows):
            found[capitalised(arm.arm_label) if len(arms) > 1 else ""] = rows
    if not found:
        return PageSection()
    most = max(map(len, found.values()))
    if most > MOST_MOVEMENTS:
        caption += f" The first {MOST_MOVEMENTS} of {most} movements are drawn."
    panels = []
    for name, rows in found.items():
        rows = rows[:MOST_MOVEMENTS]
        value, low, high = ([getattr(row, part) for row in rows] for part in ("value", "low", "high"))
        numbers = [1 + (row.movement or 0) for row in rows]
        dots = go.Scatter(x=numbers, y=value, mode="markers", error_y=interval_bars(value, low, high))
        figure = go.Figure(dots.update(marker_color=VISIBLE))
        figure.update_xaxes(title_text="movement", dtick=max(1, len(rows) // 12))
        title = Html("<h3>{}</h3>").format(name) if name else Html("")
        panels.append((title, dress(figure, 170, head=8, showlegend=False)))
    return PageSection(heading, caption, panels=panels)


def _table(arms: Sequence[Measures], pairs: Sequence[BothArms]) -> PageSection:
    """The main measures; of two arms also whether one clearly has more, and by how much."""
    known = [row.key for arm in arms for row in arm.session if row.is_known and row.key not in REACHED]
    indices = _indices(arms, pairs)
    rows = []
    for key in first_of(list(dict.fromkeys(known)), MOST_ROWS):
        of_arms = [arm.by_key.get(key) for arm in arms]
        cells: list[object] = [next(row.name for row in of_arms if row is not None)]
        cells += ["–" if row is None else with_interval(row) for row in of_arms]
        cells.append("\u00a0/\u00a0".join(map(share, of_arms)))
        cells += [symmetry(indices.get(f"{key}_symmetry_percent"))] if indices else []
        rows.append(cells)
    columns = ["measure", *(f"95 % interval{of_arm(arm, arms)}" for arm in arms), "recovered"]
    columns += ["right against left"] if indices else []
    caption = "Over the whole recording: the value, and its 95 % interval in brackets."
    return rendered(Table("The main measures", columns, rows, caption))


def _indices(arms: Sequence[Measures], pairs: Sequence[BothArms]) -> dict[str, Measure]:
    """The symmetry indices of one person's two arms; none where an arm is not to be trusted."""
    trusted = all(arm.trusted is not False for arm in arms)
    return pairs[0].by_key if len(arms) == 2 and len(pairs) == 1 and trusted else {}


def _limits(arms: Sequence[Measures]) -> PageSection:
    """What limits the numbers: what is not known and why, what comes from recovered samples."""
    sentences: list[str] = []
    for arm in arms:
        mark, main = of_arm(arm, arms), [row for row in arm.session if is_main(row.key)]
        doubtful = [row for row in main if row.is_known and row.note]
        if doubtful:
            most = max(row.untrusted_share for row in doubtful)
            names = [row.name for row in doubtful]
            words = f"{'up to ' if len(names) > 1 else ''}{100 * most:.0f} %"
            sentences.append(f"{listed(names)}{mark}: {words} of it comes from gaps that are not trusted")
        why: dict[str, list[str]] = {}
        for row in main:
            if not row.is_known and row.note:
                why.setdefault(row.note, []).append(row.name)
        for note, names in why.items():
            sentences.append(f"{listed(names)}{mark} cannot be assessed: {note}")
        weak = [row.name for row in main if row.is_known and row.recovered_share > MOSTLY_RECOVERED]
        if weak:
            sentences.append(f"More than half of {listed(weak)}{mark} comes from recovered time")
        sentences += arm.notes
    return limits(sentences, MOST_LIMITS)
