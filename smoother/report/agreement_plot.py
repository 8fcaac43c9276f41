"""Bland-Altman plots and curves over a repetition as SVG for papers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..evaluation.agreement import limits_of_agreement
from ..evaluation.progress import scaled, shown_unit
from ..runtime.outputs import writing
from .publication import CM_PER_INCH, COLOURS, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..evaluation.waveform_change import WaveformChange

#: A column of most journals, cm.
COLUMN_CM, HEIGHT_CM = 8.5, 6.5


@contextmanager
def _drawing(path: Path, force: bool) -> Iterator[Axes]:
    """Axes in the style of papers, written as SVG: the same data give the same bytes."""
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UnoccludeError("--plots needs matplotlib; install it by `pip install matplotlib`") from error

    with rc_context(STYLE | {"svg.hashsalt": "unocclude"}):
        figure = Figure(figsize=(COLUMN_CM / CM_PER_INCH, HEIGHT_CM / CM_PER_INCH), layout="constrained")
        axes = figure.subplots()
        axes.spines[["top", "right"]].set_visible(False)
        yield axes
        with writing(path, force) as temporary:
            figure.savefig(temporary, format="svg", metadata={"Date": None})


def write_bland_altman(
    first: FloatArray,
    second: FloatArray,
    name: str,
    unit: str,
    path: Path,
    words: tuple[str, str] = ("first", "second"),
    force: bool = False,
) -> None:
    """Draw differences over means, with bias, limits of agreement and their 95 % intervals.

    Parameters
    ----------
    first, second : ndarray, shape (n,)
        Pairs, three or more, in the measure's own unit.
    name, unit : str
        Of the measure.
    path : Path
        The SVG file.
    words : (str, str)
        What the two are; the difference is the second minus the first.
    force : bool
        Overwrite a file that exists.
    """
    factor, shown = scaled(1.0, unit), shown_unit(unit)
    first, second = factor * first, factor * second
    limits = limits_of_agreement(second - first)
    with _drawing(path, force) as axes:
        lines = (
            (limits.bias, limits.bias_low, limits.bias_high, "mean", COLOURS[0]),
            (limits.low, limits.low_from, limits.low_to, "- 1.96 SD", COLOURS[1]),
            (limits.high, limits.high_from, limits.high_to, "+ 1.96 SD", COLOURS[1]),
        )
        for value, low, high, text, colour in lines:
            axes.axhspan(low, high, color=colour, alpha=0.15, linewidth=0)
            axes.axhline(value, color=colour, linestyle="-" if text == "mean" else "--")
            axes.annotate(
                f"{text} {value:+.3g} ({low:+.3g} to {high:+.3g})",
                (1.0, value),
                xycoords=("axes fraction", "data"),
                xytext=(0, 2),
                textcoords="offset points",
                ha="right",
                va="bottom",
                fontsize=6,
            )
        axes.plot(0.5 * (first + second), second - first, "o", color="0.15", markersize=3)
        in_unit = f", {shown}" if shown else ""
        axes.set_xlabel(f"mean of {words[0]} and {words[1]}{in_unit}")
        axes.set_ylabel(f"{words[1]} - {words[0]}{in_unit}")
        axes.set_title(f"{name} (n = {len(first)}; bands: 95 % intervals)", fontsize=7, loc="left")


def write_waveform_change(change: WaveformChange, title: str, path: Path, force: bool = False) -> None:
    """Draw the mean curves of two sessions with bands of one standard deviation, and where they differ.

    Parameters
    ----------
    change : WaveformChange
    title : str
    path : Path
        The SVG file.
    force : bool
        Overwrite a file that exists.
    """
    with _drawing(path, force) as axes:
        share = np.linspace(0.0, 100.0, len(change.first.mean))
        for start, end in ((each.start_percent, each.end_percent) for each in change.test.stretches):
            axes.axvspan(start, end, color="0.88", linewidth=0)
        for session, each, colour in zip(
            (change.from_session, change.to_session), (change.first, change.last), COLOURS, strict=False
        ):
            axes.plot(share, each.mean, color=colour, label=f"{session} (n = {len(each.curves)})")
            axes.fill_between(
                share, each.mean - each.sd, each.mean + each.sd, color=colour, alpha=0.2, linewidth=0
            )
        axes.legend(frameon=False, fontsize=6)
        axes.set_xlim(0.0, 100.0)
        axes.set_xlabel("repetition, %")
        axes.set_ylabel("degrees")
        axes.set_title(f"{title}; grey: differs, p < 0.05", fontsize=7, loc="left")


def file_name(*parts: str) -> str:
    """A name of an SVG file of letters, digits and underscores."""
    return re.sub(r"[^0-9A-Za-z]+", "_", "_".join(filter(None, parts))).strip("_") + ".svg"


def prepared_folder(folder: Path, names: Sequence[str], force: bool) -> Path:
    """The folder, made where it is missing.

    Raises
    ------
    UnoccludeError
        It cannot be made, or holds one of the files and `force` is not given.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnoccludeError(f"{folder}: {error.strerror or error}; give another folder") from error
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        raise UnoccludeError(f"{folder / there[0]} exists; give another folder, or --force")
    return folder
