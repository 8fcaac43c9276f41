"""Pages of tables: of a calibration, of measures and their progress, of hidden gaps, of a study."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
import plotly.graph_objects as go

from ..evaluation.gaps import GapTable
from ..evaluation.progress import (
    SESSIONS_VARY,
    PersonProgress,
    Series,
    SessionValue,
)
from ..evaluation.summary import worst_of
from ..evaluation.words import (
    first_of,
    interval,
    is_main,
    measure_table,
    measure_words,
    not_measured,
    quantity,
    scaled,
    shown_unit,
)
from ..measures import BothArms, Measures
from ..table import Table, centimetres, tabulated
from .sheet import (
    ALARM,
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
    notes,
    rendered,
    trust_badge,
)
from .traces import (
    BAND,
    dress,
    interval_bars,
    values_with_intervals,
)

if TYPE_CHECKING:
    import pyarrow as pa


#: Measures of the main table, and sentences of the limits.
MOST_MAIN, MOST_LIMITS = 10, 6
#: What the hand may reach.
REACHED = {
    "hand_to_mouth_reached": "hand to mouth",
    "hand_to_head_reached": "hand to head",
    "hand_behind_back_reached": "hand behind the back",
}


def measures_page(measures_by_arm: Sequence[Measures], pairs: Sequence[BothArms] = ()) -> Page:
    """The page of a recording's measures."""
    arms = list(measures_by_arm)
    names = ", ".join(dict.fromkeys(arm.name for arm in arms))
    length_s = max((arm.end_s - arm.start_s for arm in arms), default=math.nan)
    labels = " and ".join(arm.arm_label for arm in arms) or "no arm"
    return Page(
        f"Measures of {names or 'a recording'}",
        f"{capitalised(labels)}, {length_s:.0f} s" if math.isfinite(length_s) else labels,
        _measures_verdict(arms),
        _measures_sections(arms, pairs),
    )


def _measures_verdict(arms: Sequence[Measures]) -> Iterator[str]:
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


def _measures_sections(arms: Sequence[Measures], pairs: Sequence[BothArms]) -> Iterator[PageSection]:
    trusted = all(arm.trusted is not False for arm in arms)
    symmetry = pairs[0].rows if len(arms) == 2 and len(pairs) == 1 and trusted else ()
    yield _reach(arms)
    known = [row.key for arm in arms for row in arm.session if row.is_known and row.key not in REACHED]
    for arm in arms:
        main = filter(None, map(arm.by_key.get, first_of(list(dict.fromkeys(known)), MOST_MAIN)))
        table = measure_table(f"The main measures{_of(arm, arms)}", "measure", main)
        yield rendered(table, caption("The main measures"))
    alike = measure_table(
        "Right against left, in percent", "0 = alike, above it the right has more", symmetry
    )
    yield rendered(alike)
    several = len(arms) > 1
    unknown = (f"{arm.arm_label}, {each}" if several else each for arm in arms for each in not_measured(arm))
    yield limits([*unknown, *(note for arm in arms for note in arm.notes)], MOST_LIMITS)
    keys = [row.key for arm in arms for row in arm.session if row.is_known and is_main(row.key)]
    words = ["interval", "recovered", *(["symmetry"] if symmetry else [])]
    yield explained([*words, *(["unknown"] if REACHED.keys() & set(keys) else [])], keys)


def _of(arm: Measures, arms: Sequence[Measures]) -> str:
    """Which arm, where there are several."""
    return f", {arm.arm_label.replace(' arm', '')}" if len(arms) > 1 else ""


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


#: Figures of the page of progress, and rows of its table.
MOST_FIGURES, MOST_CHANGES = 5, 16


def progress_page(progress: PersonProgress) -> Page:
    """The page of a person's sessions."""
    sides = list(dict.fromkeys(each.side for each in progress.series if each.side))
    arms = f"{' and '.join(sides).capitalize()} arm{'s' if len(sides) > 1 else ''}, " if sides else ""
    count = len(progress.sessions)
    names = [
        f"{_short(name)} (day {day:.0f})" if math.isfinite(day) else _short(name)
        for name, day in zip(progress.sessions, progress.days, strict=True)
    ]
    named = ", ".join(names if count <= 8 else [*names[:3], "…", *names[-3:]])
    return Page(
        f"Progress of {progress.person}",
        f"{arms}{count} session{'s' if count != 1 else ''}: {named}",
        [*progress.sentences(), NO_DIAGNOSIS, SESSIONS_VARY],
        _progress_sections(progress),
    )


def _progress_sections(progress: PersonProgress) -> Iterator[PageSection]:
    main = [each for each in progress.main if any(math.isfinite(value.value) for value in each.values)]
    keys = first_of(list(dict.fromkeys(each.key for each in main)), MOST_FIGURES)
    shown = [each for key in keys for each in main if each.key == key][:MOST_FIGURES]
    if shown:
        about = caption("Several sessions" if len(progress.sessions) > 1 else "One session")
        yield PageSection("The main measures", about, panels=[_panel(each, progress) for each in shown])
    more = len(progress.changed) - MOST_CHANGES
    left = f" {more} measures more are in the tables (--csv)." if more > 0 else ""
    yield rendered(progress.table("All changes", MOST_CHANGES), caption("All changes", more=left))
    yield limits([*progress.left_out, *progress.notes, *progress.limits], MOST_LIMITS)
    terms = ["interval", "recovered", *(["clear", "unclear", "unknown"] if progress.changed else [])]
    if any(math.isfinite(change.mdc95) for _, change in progress.changed):
        terms.append("mdc")
    yield explained(terms, [each.key for each in (*shown, *progress.main)])


def _panel(series: Series, progress: PersonProgress) -> tuple[Html, go.Figure]:
    """A measure over the sessions with its intervals, under its name, and whether it changed."""
    unit, change = shown_unit(series.unit), series.change
    title = Html("<h3>{}{}</h3>").format(progress.label(series), f" ({unit})" if unit else "")
    if change is not None:
        found = quantity(change.difference, series.unit, signed=True)
        between = interval(change.low, change.high, series.unit, signed=True)
        said = f"{found} ({between})" if between else found if math.isfinite(change.difference) else ""
        title += Html("<p>{} {}</p>").format(badge(change.word), said)
    by_name = {value.session: value for value in series.values}
    values = [by_name.get(name, SessionValue("", math.nan, math.nan)) for name in progress.sessions]
    numbers = [
        [scaled(getattr(each, part), series.unit) for each in values] for part in ("value", "low", "high")
    ]
    low, high = numbers[1][0], numbers[2][0]
    figure = go.Figure(values_with_intervals(range(len(values)), *numbers).update(marker_size=8))
    if len(values) > 1 and math.isfinite(low):
        figure.add_hrect(low, high, fillcolor=BAND, line_width=0, layer="below")
    every = range(0, len(values), max(1, math.ceil(len(values) / 12)))
    names = [label(_short(progress.sessions[place], 9)) for place in every]
    figure.update_xaxes(tickvals=list(every), ticktext=names)
    return title, dress(figure, 150, head=8, showlegend=False)


def _short(text: str, most: int = 24) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


#: Of the methods in turn (Okabe and Ito 2008), then grey; further ones have them again, dotted.
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#B8860B", "#7F5AA8", "#777777", "#B0B0B0")
#: By length of gap (s), rising, and method: `GapGroup.spread`.
Spreads = dict[float, dict[str, dict[str, Any]]]


def gap_curves_page(table: GapTable, name: str, verdict: Iterable[str], remarks: Iterable[str]) -> Page:
    """The errors in hidden gaps on one page."""
    spreads = {
        length: {method: group.spread for method, group in table.lengths[length].items()}
        for length in sorted(table.lengths)
    }
    gaps = sum(len(next(iter(methods.values())).rows) for methods in table.lengths.values())
    against = table.reference
    reference = (
        "the truth" if against == "truth" else f"what the camera saw of the {against}, its noise included"
    )
    return Page(
        f"Error against gap length: {name}",
        f"{gaps} gaps were made where the camera saw the arm, and recovered; compared with {reference}.",
        verdict,
        [
            PageSection("Error against gap length", plot=curves(spreads)),
            rendered(table.table()),
            notes(dict.fromkeys(remarks)),
        ],
    )


def curves(spreads: Spreads) -> go.Figure:
    """Median of the gaps' rms against their length, with the quartiles as bars."""
    plot = go.Figure()
    names = list(dict.fromkeys(name for methods in spreads.values() for name in methods))
    for place, name in enumerate(reversed(names)):  # the first on top of the others
        known = {
            length: spread
            for length, methods in spreads.items()
            if (spread := methods.get(name)) is not None and spread["median_m"] is not None
        }
        if not known:
            continue
        median, low, high = (
            [100 * (spread[part] or np.nan) for spread in known.values()]
            for part in ("median_m", "low_m", "high_m")
        )
        shift = 1.0 if name == "graph" else 1.012 ** (place - len(names) / 2)  # bars beside each other
        again, colour = divmod(len(names) - 1 - place, len(COLOURS))
        line = {"color": COLOURS[colour], "width": 3.2 if name == "graph" else 1.5}
        line["dash"] = "dot" if again else "solid"
        bars = interval_bars(median, low, high) | {"color": COLOURS[colour], "thickness": 1}
        trace = go.Scatter(x=[length * shift for length in known], y=median, name=label(name), line=line)
        plot.add_trace(trace.update(mode="lines+markers", error_y=bars))
    ticks = [f"{length:g}" for length in spreads]
    plot.update_xaxes(type="log", title_text="gap, s", tickvals=list(spreads), ticktext=ticks)
    plot.update_yaxes(type="log", title_text="error in a gap, rms, cm", exponentformat="none")
    dress(plot, 620, head=70)
    return plot.update_layout(legend={"traceorder": "reversed"}, showlegend=True)


#: Rows of the table of recordings, and of failures; notes of the results.
MOST_RECORDINGS, MOST_NOTES = 200, 20


def write_study(
    rows: pa.Table, path: str | os.PathLike[str], folder: str | os.PathLike[str], force: bool = False
) -> None:
    """Write the page of a study; `folder` is that of its results."""
    import pyarrow.compute as pc

    recovered = rows.filter(pc.equal(rows["status"], "done"))
    failed = rows.filter(pc.equal(rows["status"], "failed"))
    failures = failed.select(["recording", "error"]).slice(0, MOST_RECORDINGS).to_pylist()
    sections = [rendered(tabulated("Failed", failures, "recording error=why"))]
    if len(recovered):
        shown = worst_of(recovered, MOST_RECORDINGS).to_pylist()
        sections.append(_recordings(shown, len(recovered), Path(path), Path(folder)))
        texts = pc.list_flatten(recovered["note_texts"].combine_chunks()).value_counts().to_pylist()
        counted = sorted(texts, key=lambda note: (-note["counts"], note["values"]))
        sentences = [f"{note['counts']} x: {note['values']}" for note in counted[:MOST_NOTES]]
        sections.append(PageSection("Notes in the results", sentences=sentences))
    distrusted = recovered.filter(pc.equal(recovered["trusted"], False))
    Page(
        "Study",
        f"{len(rows)} recordings",
        _study_verdict(len(rows), recovered, len(failed), len(distrusted)),
        sections,
        tone=ALARM if len(distrusted) else "",
    ).write(path, force)


def _study_verdict(count: int, recovered: pa.Table, failed: int, distrusted: int) -> Iterator[str]:
    import pyarrow.compute as pc

    yield f"{len(recovered)} of {count} recordings were recovered, {failed} failed"
    if distrusted:
        yield f"Not to be trusted: {distrusted} of them; do not use these figures. The table begins with them"
    sound = recovered.filter(pc.fill_null(recovered["trusted"], True))
    partly = pc.and_(pc.is_valid(sound["trusted"]), pc.greater(sound["gaps_untrusted"], 0))
    if several := pc.sum(partly).as_py():
        yield f"Gaps that are not to be trusted: in {several} of the others"
    error = 100 * sound["error_95_m"].drop_null().to_numpy()
    if len(error):
        half, most = np.percentile(error, [50, 95])
        yield (
            f"in the gaps of a recording the sensor is within {half:.1f} cm in 95 of 100 cases (median of the"
            f" recordings; {most:.1f} cm at their 95th percentile, {error.max():.1f} cm in the worst one)"
        )


def _recordings(rows: Sequence[dict[str, Any]], count: int, path: Path, folder: Path) -> PageSection:
    """The recordings, each with a link to its result."""

    def named(row: dict[str, Any]) -> Html:
        target = os.path.abspath(folder / row["output"])
        try:
            link = quote(Path(os.path.relpath(target, os.path.abspath(path.parent))).as_posix())
        except ValueError:  # another drive
            link = Path(target).as_uri()
        return Html('<a href="{}">{}</a>').format(link, row["recording"])

    def verdict(row: dict[str, Any]) -> str:
        word = trust_badge(row["trusted"], row["gaps"], row["gaps_untrusted"])
        if row["trusted"] is False:
            return word + f" {str(row['verdict'] or '').removeprefix('Not to be trusted: ')}"
        return word if row["gaps_untrusted"] else row["verdict"] or word

    columns: dict[str, str | Callable[[Any], object]] = {
        "recording": named,
        "verdict": verdict,
        "self-check: recovered to within, cm": "self_check_95_m",
        "stated, cm": "self_check_stated_95_m",
        "within, cm (95 %)": lambda row: centimetres(
            row["error_95_m"] if row["trusted"] is not False else None
        ),
        "longest gap, s": "gap_longest_s",
        "gaps": "gaps",
        "occluded, s": "occluded_s",
        "length, s": "duration_s",
    }
    rest = count - len(rows)
    others = f" The other {rest} are among the results." if rest else ""
    return rendered(tabulated("Recordings", rows, columns), caption("Recordings", rest=others))
