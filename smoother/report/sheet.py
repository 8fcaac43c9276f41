"""The pages' common parts: one file that needs no network, headings, figures, lists and tables."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from string import Template

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ..runtime.atomic import writing

#: A longer table is cut, and says so.
MOST_ROWS = 500
#: Stands for the sections while the page around them is put together.
_HERE = "<!-- sections -->"


class Html(str):
    """Text that is HTML already, and is not escaped."""


def write_sheet(
    path: str | os.PathLike[str],
    title: str,
    subtitle: str,
    verdict: Iterable[str],
    sections: Iterable[str],
    *,
    force: bool = False,
) -> None:
    """Write one HTML page that needs no network and no other file; its sections are made one by one.

    Parameters
    ----------
    path : path-like
        The page to write.
    title, subtitle : str
        Heading, and the line under it.
    verdict : iterable of str
        Sentences that stand first.
    sections : iterable of str
        HTML, made by `figure`, `picture`, `listing` and `tabulated`.
    force : bool
        Overwrite a page that exists.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    from .. import __version__

    here = resources.files(__package__)
    page = Template(here.joinpath("page.html").read_text(encoding="utf-8")).substitute(
        title=escape(title),
        made=escape(subtitle),
        style=here.joinpath("style.css").read_text(encoding="utf-8"),
        plotly=get_plotlyjs(),
        content=_HERE,
        version=escape(__version__),
    )
    before, after = page.split(_HERE)
    paragraphs = "".join(f"<p>{escape(_sentence(text))}</p>" for text in verdict)
    with (
        writing(path, force) as temporary,
        open(temporary, "w", encoding="utf-8", errors="backslashreplace") as file,
    ):
        file.write(f'{before}<div class="summary">{paragraphs}</div>')
        for section in sections:
            file.write(f"\n{section}")
        file.write(after)


def figure(heading: str, caption: str, plot: go.Figure) -> str:
    """A heading, a caption and a plot."""
    html = plot.to_html(
        full_html=False,
        include_plotlyjs=False,
        config={"displaylogo": False, "responsive": True, "plotlyServerURL": ""},
        div_id="figure-" + re.sub("[^a-z0-9]+", "-", heading.lower()).strip("-"),
    )
    return f'{headed(heading, caption)}<div class="figure">{html}</div>'


def picture(heading: str, caption: str, png: bytes) -> str:
    """A heading, a caption and an image."""
    from base64 import b64encode

    data = b64encode(png).decode("ascii")
    return (
        f'{headed(heading, caption)}<p><img alt="{escape(heading)}" style="max-width:100%"'
        f' src="data:image/png;base64,{data}"></p>'
    )


def listing(heading: str, sentences: Iterable[str], nothing: str = "Nothing.") -> str:
    """A heading over a list of sentences."""
    return headed(heading) + (bullets(sentences) or f"<p>{escape(nothing)}</p>")


def bullets(sentences: Iterable[str]) -> str:
    """A list of sentences; "" without any."""
    items = "".join(f"<li>{escape(_sentence(text))}</li>" for text in sentences)
    return f"<ul>{items}</ul>" if items else ""


def tabulated(heading: str, caption: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A heading, a caption and a table."""
    return headed(heading, caption) + table(columns, rows)


def table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; a dash stands for None and nan."""
    rows = list(rows)
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>" for row in rows[:MOST_ROWS]
    )
    more = f"<p>{len(rows) - MOST_ROWS} rows more are left out.</p>" if len(rows) > MOST_ROWS else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def headed(heading: str, caption: str = "") -> str:
    """A heading and a caption (`Html`, or plain text) below it."""
    below = f'<p class="caption">{_escaped(caption)}</p>' if caption else ""
    return f"<h2>{escape(heading)}</h2>{below}"


def in_cm(value_m: float | None, decimals: int = 2) -> str | None:
    """Metres as centimetres in a table's cell; None stays None."""
    return None if value_m is None else f"{100 * value_m:.{decimals}f}"


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else _escaped(value)


def _escaped(value: object) -> str:
    return value if isinstance(value, Html) else escape(str(value))


def _sentence(text: str) -> str:
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?", ":")) else f"{text}."
