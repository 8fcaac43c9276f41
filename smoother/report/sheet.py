"""A page about one step of the calibration: verdict first, then pictures, residuals, what to record next."""

from __future__ import annotations

import os
from collections.abc import Iterable
from html import escape
from importlib import resources
from string import Template

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ..runtime.atomic import writing
from .tables import table


def write_sheet(
    path: str | os.PathLike[str],
    title: str,
    made: str,
    verdict: Iterable[str],
    sections: Iterable[str],
    *,
    force: bool = False,
) -> None:
    """Write one HTML page that needs nothing else, the network included.

    Parameters
    ----------
    path : the page to write.
    title, made : heading, and the line under it.
    verdict : sentences that stand first.
    sections : HTML, made by `figure`, `listing` and `tabulated`.
    force : overwrite a page that exists.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    from .. import __version__

    words = "".join(f"<p>{escape(_sentence(text))}</p>" for text in verdict)
    here = resources.files(__package__)
    page = Template(here.joinpath("page.html").read_text(encoding="utf-8")).substitute(
        title=escape(title),
        made=escape(made),
        style=here.joinpath("style.css").read_text(encoding="utf-8"),
        plotly=get_plotlyjs(),
        content="\n".join([f'<div class="summary">{words}</div>', *sections]),
        version=escape(__version__),
    )
    with writing(path, force) as temporary:
        temporary.write_text(page, encoding="utf-8")


def figure(heading: str, caption: str, drawn: go.Figure) -> str:
    """A heading, a caption in plain text and a plot."""
    name = "figure-" + "".join(letter if letter.isalnum() else "-" for letter in heading.lower())
    html = drawn.to_html(
        full_html=False,
        include_plotlyjs=False,
        config={"displaylogo": False, "responsive": True, "plotlyServerURL": ""},
        div_id=name,
    )
    return f'{_head(heading, caption)}<div class="figure">{html}</div>'


def picture(heading: str, caption: str, png: bytes) -> str:
    """A heading, a caption and an image."""
    from base64 import b64encode

    data = b64encode(png).decode("ascii")
    return (
        f'{_head(heading, caption)}<p><img alt="{escape(heading)}" style="max-width:100%"'
        f' src="data:image/png;base64,{data}"></p>'
    )


def listing(heading: str, items: Iterable[str], nothing: str = "Nothing.") -> str:
    """A heading over a list of sentences."""
    rows = "".join(f"<li>{escape(_sentence(text))}</li>" for text in items)
    return f"<h2>{escape(heading)}</h2>" + (f"<ul>{rows}</ul>" if rows else f"<p>{escape(nothing)}</p>")


def tabulated(
    heading: str, caption: str, columns: tuple[str, ...], rows: Iterable[tuple[object, ...]]
) -> str:
    """A heading, a caption and a table."""
    return _head(heading, caption) + table(columns, rows)


def _head(heading: str, caption: str) -> str:
    return f'<h2>{escape(heading)}</h2><p class="caption">{escape(caption)}</p>'


def _sentence(text: str) -> str:
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?", ":")) else f"{text}."
