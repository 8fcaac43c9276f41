"""A study as one page: its recordings, the worst of them first, and its persons together."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from ..evaluation.progress import group_measures
from ..evaluation.summary import worst_of
from ..evaluation.words import first_of
from ..runtime.csv_rows import write_rows
from ..runtime.outputs import writing
from ..table import Table, tabulated
from .sheet import ALARM, Html, Page, PageSection, caption, rendered, trust_badge

if TYPE_CHECKING:
    import pyarrow as pa


#: Rows of the table of recordings, and of failures; measures in it; notes of the results.
MOST_ROWS, MOST_SHOWN, MOST_NOTES = 200, 4, 20


def write_study(
    rows: pa.Table,
    path: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    persons: Mapping[str, str] | None = None,
    long: Sequence[Mapping[str, Any]] = (),
    force: bool = False,
) -> None:
    """Write the page of a study."""
    import pyarrow.compute as pc

    recovered = rows.filter(pc.equal(rows["status"], "done"))
    failed = rows.filter(pc.equal(rows["status"], "failed"))
    failures = [(row["recording"], row["error"]) for row in failed.slice(0, MOST_ROWS).to_pylist()]
    sections = [rendered(Table("Failed", ("recording", "why"), failures))]
    if len(recovered):
        shown = worst_of(recovered, MOST_ROWS).to_pylist()
        sections.append(_recordings(shown, len(recovered), persons or {}, Path(path), Path(folder)))
        if long:
            file = Path(path).with_name(f"{Path(path).stem}_measures.csv")
            with (
                writing(file, force=True) as temporary,
                open(temporary, "w", newline="", encoding="utf-8") as to,
            ):
                write_rows(to, [list(long[0]), *(row.values() for row in long)])
            sections.append(_group(group_measures(long), file.name))
        texts = pc.list_flatten(recovered["note_texts"].combine_chunks()).value_counts().to_pylist()
        counted = sorted(texts, key=lambda note: (-note["counts"], note["values"]))
        sentences = [f"{note['counts']} x: {note['values']}" for note in counted[:MOST_NOTES]]
        sections.append(PageSection("Notes in the results", sentences=sentences))
    distrusted = recovered.filter(pc.equal(recovered["trusted"], False))
    Page(
        "Study",
        f"{len(rows)} recordings",
        _verdict(len(rows), recovered, len(failed), len(distrusted)),
        sections,
        tone=ALARM if len(distrusted) else "",
    ).write(path, force)


def _verdict(count: int, recovered: pa.Table, failed: int, distrusted: int) -> Iterator[str]:
    import pyarrow.compute as pc

    yield f"{len(recovered)} of {count} recordings were recovered, {failed} failed"
    if not len(recovered):
        return
    if distrusted:
        yield f"Not to be trusted: {distrusted} of them; do not use these figures. The table begins with them"
    sound = recovered.filter(pc.fill_null(recovered["trusted"], True))
    partly = pc.and_(pc.is_valid(sound["trusted"]), pc.greater(sound["gaps_untrusted"], 0))
    if several := pc.sum(partly).as_py():
        yield f"Gaps that are not to be trusted: in {several} of the others"
    recorded, occluded, spent = (
        pc.sum(recovered[name]).as_py() or 0.0 for name in ("duration_s", "occluded_s", "seconds")
    )
    yield (
        f"{_duration(recorded)} of recordings, {100 * occluded / max(recorded, 1e-9):.1f} % of it occluded;"
        f" one process needed {_duration(spent)}, {recorded / max(spent, 1e-9):.3g} times real time"
    )
    error = 100 * sound["error_95_m"].drop_null().to_numpy()
    if len(error):
        half, most = np.percentile(error, [50, 95])
        yield (
            f"in the gaps of a recording the sensor is within {half:.1f} cm in 95 of 100 cases (median of the"
            f" recordings; {most:.1f} cm at their 95th percentile, {error.max():.1f} cm in the worst one)"
        )


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _recordings(
    rows: Sequence[dict[str, Any]], count: int, persons: Mapping[str, str], path: Path, folder: Path
) -> PageSection:
    """The recordings, each with a link to its report, or to its result where it has none."""
    measured = [each for row in rows for each in row["measures"] or ()]
    shown = {each["key"]: each for each in measured}
    columns: dict[str, Callable[[dict[str, Any]], object]] = {
        "recording": lambda row: _named(row, path, folder),
        "person": lambda row: persons.get(row["recording"]),
        "verdict": _trust,
        "self-check: recovered to within": _self_check,
        "within, cm (95 %)": lambda row: None if row["trusted"] is False else _scaled(row["error_95_m"], 100),
        "longest gap, s": lambda row: _scaled(row["gap_longest_s"]),
        "gaps": lambda row: row["gaps"],
        "occluded, s": lambda row: _scaled(row["occluded_s"]),
        "length, s": lambda row: _scaled(row["duration_s"]),
    }
    for key in first_of([each["key"] for each in measured], MOST_SHOWN):
        columns[_with_unit(shown[key])] = partial(_measured, key)
    rest = count - len(rows)
    others = f" The other {rest} are among the results." if rest else ""
    return rendered(tabulated("Recordings", rows, columns), caption("Recordings", rest=others))


def _with_unit(measure: Mapping[str, Any]) -> str:
    return f"{measure['name']}, {measure['unit']}".removesuffix(", ")


def _named(row: dict[str, Any], path: Path, folder: Path) -> Html:
    """A recording's name, which leads to its report where there is one."""
    page = report_of(row["output"])
    target = os.path.abspath(folder / (page if (folder / page).is_file() else str(row["output"])))
    try:
        link = quote(Path(os.path.relpath(target, os.path.abspath(path.parent))).as_posix())
    except ValueError:  # another drive
        link = Path(target).as_uri()
    return Html('<a href="{}">{}</a>').format(link, row["recording"])


def _self_check(row: dict[str, Any]) -> str | None:
    """What the self-check found and what was stated of it, and its sentence under the pointer."""
    found, stated = row["self_check_95_m"], row["self_check_stated_95_m"]
    if found is None or stated is None:
        return row["self_check"] or None
    words = f"{100 * found:.1f} cm (stated: {100 * stated:.1f})"
    return Html('<span title="{}">{}</span>').format(row["self_check"] or "", words)


def report_of(output: str) -> str:
    """The name of a recording's report, beside its result."""
    return Path(output).with_suffix(".html").as_posix()


def _measured(key: str, row: dict[str, Any]) -> str | None:
    """A measure of each arm, with its interval."""
    known = [
        each
        for each in row["measures"] or ()
        if each["key"] == key and each["value"] is not None and each["trusted"] is not False
    ]
    sides = ("" if (row["arms"] or 1) < 2 else f"{each['side']} " for each in known)
    values = (_between(each["value"], each["low"], each["high"]) for each in known)
    return "; ".join(f"{side}{value}" for side, value in zip(sides, values, strict=True)) or None


def _between(value: float | None, low: float | None, high: float | None, sign: str = "") -> str | None:
    """A value with its interval in brackets, as far as they are known."""
    if value is None or not math.isfinite(value):
        return None
    known = low is not None and high is not None and math.isfinite(low)
    return f"{value:{sign}.3g}" + (f" ({low:{sign}.3g} to {high:{sign}.3g})" if known else "")


def _trust(row: dict[str, Any]) -> str:
    """Whether a recording's result is to be trusted, as a word in its colour, and why it is not."""
    word = trust_badge(row["trusted"], row["gaps"], row["gaps_untrusted"])
    if row["trusted"] is False:
        return word + f" {str(row['verdict'] or '').removeprefix('Not to be trusted: ')}"
    return word if row["gaps_untrusted"] else row["verdict"] or word


def _scaled(value: float | None, factor: float = 1.0) -> str | None:
    return None if value is None or not np.isfinite(value) else f"{factor * value:.3g}"


def _group(measures: list[dict[str, Any]], file: str) -> PageSection:
    """Mean, spread and change of each measure over the persons."""

    def spread(which: str) -> Callable[[dict[str, Any]], object]:
        return lambda each: (
            f"{each[which][1]:.3g}" + (f" ({each[which][2]:.2g})" if math.isfinite(each[which][2]) else "")
            if each[which][0]
            else None
        )

    columns: dict[str, Callable[[dict[str, Any]], object]] = {
        "arm": lambda each: each["side"] or None,
        "task": lambda each: each["task"] or None,
        "measure": _with_unit,
        "persons": lambda each: each["first"][0],
        "mean (SD)": spread("first"),
        "last session, mean (SD)": spread("last"),
        "persons with both": lambda each: each["last"][0],
        "change (95 % interval)": lambda each: _between(each["change"], each["low"], each["high"], "+"),
    }
    about = caption("The group", link=quote(file), file=file)
    return rendered(tabulated("The group", measures, columns), about)
