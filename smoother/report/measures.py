"""The page of a session's measures: how far, how fast, how smooth, where to, and how well that is known."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape

from ..evaluation.progress import (
    SessionValue,
    change_between,
    first_of,
    interval,
    is_main,
    number,
    quantity,
    shown_unit,
    without_like_movements,
)
from ..measures import BothArms, Measure, Measures
from ..measures.layout import BY_MOVEMENT
from .chart import Mark, Strip, badge, bars, charted, sessions, strips
from .sheet import (
    NO_DIAGNOSIS,
    Html,
    Page,
    bullets,
    capitalised,
    explained,
    headed,
    tabulated,
    terms_of,
)


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


def mark_of(row: Measure, name: str = "") -> Mark:
    """The value as it is drawn."""
    return Mark(name, row.value, row.low, row.high, number(row.value, row.unit))


def reached(arm: Measures, key: str) -> str:
    """In words where the draws agree, and how near the hand came, as HTML."""
    row = arm.by_key.get(key)
    if row is None or not row.has_interval or row.low != row.high:
        word = "cannot be assessed"
    else:
        word = "reached" if row.value >= 1 else "not reached"
    return f"{badge(word)} {escape(_distance(arm, key))}"


def _distance(arm: Measures, key: str) -> str:
    """How near the hand came, where it was not there."""
    row = arm.by_key.get(key.replace("_reached", "_distance_m"))
    if row is None or not row.is_known or row.value <= 0:
        return ""
    return f"{with_interval(row)} away"


def listed(names: Sequence[str]) -> str:
    """Two names, or the first and how many more."""
    return ", ".join(names) if len(names) <= 2 else f"{names[0]} and {len(names) - 1} measures more"


def of_arm(arm: Measures, arms: Sequence[Measures]) -> str:
    """Which arm, where there are several."""
    return f", {arm.arm_label.replace(' arm', '')}" if len(arms) > 1 else ""


def both_arms(arms: Sequence[Measures]) -> tuple[Measures, Measures] | None:
    """Left and right arm of one person, both to be trusted."""
    by_side = {arm.side: arm for arm in arms}
    if len(arms) != 2 or by_side.keys() != {"left", "right"} or arms[0].body != arms[1].body:
        return None
    if any(arm.trusted is False for arm in arms):
        return None
    return by_side["left"], by_side["right"]


def compared(left: Measures, right: Measures, key: str) -> str:
    """Whether the right arm clearly has more, in words."""
    one, other = left.by_key.get(key), right.by_key.get(key)
    if one is None or other is None:
        return "cannot be assessed"
    change = change_between(_value(one, "left"), _value(other, "right"))
    if key in BY_MOVEMENT:
        ours, others = (arm.by_key.get("movement_count") for arm in (left, right))
        if ours is None or others is None:
            return "cannot be assessed"
        change = without_like_movements(change, _value(ours, "left"), _value(others, "right"))
    return "no clear difference" if change.word == "no clear change" else change.word


def symmetry(index: Measure | None) -> str:
    """A symmetry index and its interval in whole percent, behind a word; "" where there is none."""
    if index is None or not index.is_known:
        return ""
    between = f" ({index.low:.0f} to {index.high:.0f})" if index.has_interval else ""
    return f" {index.value:+.0f}\u00a0%{between}".replace("-", "−")


def _value(row: Measure, side: str) -> SessionValue:
    return SessionValue(
        side, 0.0, row.value, row.low, row.high, row.sigma, row.recovered_share, row.n_draws, row.note
    )


#: Rows of the table, and sentences of the limits.
MOST_ROWS, MOST_LIMITS = 10, 6
#: Angles whose range is drawn, and those whose time is.
RANGES = ("elbow_flexion", "shoulder_elevation", "pronation")
TIMES = ("elbow_flexion", "shoulder_elevation")
#: What the hand may reach.
REACHED = {
    "hand_to_mouth_reached": "hand to mouth",
    "hand_to_head_reached": "hand to head",
    "hand_behind_back_reached": "hand behind the back",
}
#: More movements are not drawn one by one.
MOST_MOVEMENTS = 24
#: Values from more recovered samples get a note.
MOSTLY_RECOVERED = 0.5


def measures_page(measures_by_arm: Sequence[Measures], pairs: Sequence[BothArms] = ()) -> Page:
    """The page of a recording's measures; printed, it takes two pages."""
    arms = list(measures_by_arm)
    names = ", ".join(dict.fromkeys(arm.name for arm in arms))
    length_s = max((arm.end_s - arm.start_s for arm in arms), default=math.nan)
    labels = " and ".join(arm.arm_label for arm in arms) or "no arm"
    return Page(
        f"Measures of {names or 'a recording'}",
        f"{capitalised(labels)}, {length_s:.0f} s" if math.isfinite(length_s) else labels,
        _verdict(arms),
        list(_sections(arms, pairs)),
        two_pages=True,
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


def _sections(arms: Sequence[Measures], pairs: Sequence[BothArms]) -> Iterator[str]:
    figures = [_ranges(arms), _times(arms), _reach(arms), _speed(arms), _smoothness(arms)]
    yield from (figure for figure in figures if figure)
    yield _table(arms, pairs)
    yield _limits(arms)
    keys = [row.key for arm in arms for row in arm.session if row.is_known and is_main(row.key)]
    words = ["interval", "recovered"]
    if both_arms(arms) is not None:
        words += ["clear", "unclear", "unknown", *(["symmetry"] if pairs else [])]
    elif REACHED.keys() & set(keys):
        words += ["unknown"]
    yield explained("The words on this page", [*words, *terms_of(keys)])


def _ranges(arms: Sequence[Measures]) -> str:
    """Figure 1: the smallest and the largest angle of each joint."""
    rows = []
    for angle in RANGES:
        for arm in arms:
            low, high, whole = (arm.by_key.get(f"{angle}_{what}_deg") for what in ("min", "max", "range"))
            if low is None or high is None or whole is None or not (low.is_known and high.is_known):
                continue
            text = f"{quantity(low.value, 'deg')} to {quantity(high.value, 'deg')}, range"
            text += f" {quantity(whole.value, 'deg')}"
            name = whole.name.removesuffix(", range") + of_arm(arm, arms)
            rows.append(Strip(capitalised(name), text, mark_of(low), mark_of(high)))
    if not rows:
        return ""
    ends = [mark.value for row in rows for mark in (row.start, row.end)]
    first, last = 30 * math.floor(min(ends) / 30), 30 * math.ceil(max(ends) / 30)
    first, last = min(first, 0), max(last, first + 60)
    step = 30 if last - first <= 240 else 60
    return charted(
        "How far the joints moved",
        "The blue bar goes from the smallest to the largest angle; the dark lines at its ends are their 95 %"
        " intervals.",
        strips(rows, first, last, range(first, last + 1, step), "°"),
    )


def _times(arms: Sequence[Measures]) -> str:
    """Figure 2: how long each angle was held."""
    boxes = ""
    for angle in TIMES:
        for arm in arms:
            zones = {
                int(row.key.split("_zone_")[1].split("_")[0]): row
                for row in arm.session
                if row.key.startswith(f"{angle}_zone_") and row.is_known
            }
            if not zones:
                continue
            width = 10
            starts = range(min(zones), max(zones) + 1, width)
            marks = [
                mark_of(zones[start], f"{start}°") if start in zones else Mark(f"{start}°", 0.0)
                for start in starts
            ]
            name = zones[min(zones)].name.partition(",")[0]
            title = f"<h3>{escape(capitalised(name.partition(' ')[0]) + of_arm(arm, arms))}</h3>"
            boxes += f"<div>{title}{bars(marks, ' %', f'time by {name}')}</div>"
    caption = "Percentage of the time in each range of ten degrees."
    drawing = f'<div class="charts narrow">{boxes}</div>'
    return charted("Time in each angle range", caption, drawing) if boxes else ""


def _reach(arms: Sequence[Measures]) -> str:
    """Figure 3: what the hand reached, and the volume that it passed through."""
    rows = [
        [words, *(Html(reached(arm, key)) for arm in arms)]
        for key, words in REACHED.items()
        if any((row := arm.by_key.get(key)) is not None and row.is_known for arm in arms)
    ]
    volumes = [arm.by_key.get("hand_reach_hull_l") for arm in arms]
    if any(volume is not None and volume.is_known for volume in volumes):
        known = [with_interval(volume) if volume is not None else "–" for volume in volumes]
        rows.append(["reach volume", *known])
    if not rows:
        return ""
    caption = "Reached: at least once in every drawn motion; followed by the hand's closest distance."
    columns = ["goal", *(arm.arm_label for arm in arms)]
    return tabulated("Where the hand reached", caption, columns, rows)


def _speed(arms: Sequence[Measures]) -> str:
    return _by_movement(
        arms,
        "hand_peak_speed_m_s",
        "How fast the hand was",
        "The hand's highest speed in each movement, m/s, in the order of time.",
    )


def _smoothness(arms: Sequence[Measures]) -> str:
    return _by_movement(
        arms,
        "sparc",
        "How smoothly the hand moved",
        "SPARC of each movement, in the order of time: nearer to zero is smoother. A long movement with many"
        " turns is less smooth than a short one, whoever performs it.",
    )


def _by_movement(arms: Sequence[Measures], key: str, heading: str, caption: str) -> str:
    """Figures 4 and 5: a measure over the movements of each arm."""
    boxes, most = "", 0
    for arm in arms:
        rows = [arm.of("movement", number).get(key) for number in range(len(arm.movements))]
        known = [row for row in rows if row is not None]
        if not any(row.is_known for row in known):
            continue
        marks = [mark_of(row, str(1 + (row.movement or 0))) for row in known[:MOST_MOVEMENTS]]
        session = arm.by_key.get(key)
        words = f"{session.name}, session: {with_interval(session)}" if session else ""
        most = max(most, len(known))
        title = f"<h3>{escape(capitalised(arm.arm_label))}</h3>" if len(arms) > 1 else ""
        boxes += f"<div>{title}{sessions(marks, reference=False, words=words)}</div>"
    if most > MOST_MOVEMENTS:
        caption += f" The first {MOST_MOVEMENTS} of {most} movements are drawn."
    return charted(heading, caption, f'<div class="charts">{boxes}</div>') if boxes else ""


def _table(arms: Sequence[Measures], pairs: Sequence[BothArms]) -> str:
    """The main measures; of two arms also whether one clearly has more, and by how much."""
    known = [row.key for arm in arms for row in arm.session if row.is_known and row.key not in REACHED]
    keys = first_of(list(dict.fromkeys(known)), MOST_ROWS)
    both = both_arms(arms)
    # two arms to compare are one person's
    indices = pairs[0].by_key if both is not None and len(pairs) == 1 else {}
    rows = []
    for key in keys:
        cells: list[object] = [next(row.name for arm in arms if (row := arm.by_key.get(key)) is not None)]
        for arm in arms:
            row = arm.by_key.get(key)
            cells.append("–" if row is None else with_interval(row))
        cells.append("\u00a0/\u00a0".join(share(arm.by_key.get(key)) for arm in arms))
        if both is not None:
            cells.append(Html(badge(compared(*both, key)) + symmetry(indices.get(f"{key}_symmetry_percent"))))
        rows.append(cells)
    if not rows:
        return ""
    columns = ["measure", *(f"95 % interval{of_arm(arm, arms)}" for arm in arms), "recovered"]
    columns += ["right against left"] if both is not None else []
    return tabulated(
        "The main measures",
        "Over the whole recording: the value, and its 95 % interval in brackets.",
        columns,
        rows,
    )


def _limits(arms: Sequence[Measures]) -> str:
    """What limits the numbers: what is not known and why, what comes from recovered samples."""
    sentences: list[str] = []
    for arm in arms:
        mark = of_arm(arm, arms)
        doubtful = [row for row in arm.session if is_main(row.key) and row.is_known and row.note]
        if doubtful:
            most = max(row.untrusted_share for row in doubtful)
            names = [row.name for row in doubtful]
            words = f"up to {100 * most:.0f} %" if len(names) > 1 else f"{100 * most:.0f} %"
            sentences.append(f"{listed(names)}{mark}: {words} of it comes from gaps that are not trusted")
        why: dict[str, list[str]] = {}
        for row in arm.session:
            if not row.is_known and row.note and is_main(row.key):
                why.setdefault(row.note, []).append(row.name)
        for note, names in why.items():
            sentences.append(f"{listed(names)}{mark} cannot be assessed: {note}")
        weak = [
            row.name
            for row in arm.session
            if is_main(row.key) and row.is_known and row.recovered_share > MOSTLY_RECOVERED
        ]
        if weak:
            sentences.append(f"More than half of {listed(weak)}{mark} comes from recovered time")
        sentences += arm.notes
    sentences = list(dict.fromkeys(sentences))
    if len(sentences) > MOST_LIMITS:
        more = len(sentences) - MOST_LIMITS
        sentences = [*sentences[:MOST_LIMITS], f"{more} sentences more are in --json"]
    return headed("What limits this") + (bullets(sentences) or "<p>Nothing to note.</p>")
