"""A page: one file that needs no network, made of sections with plots, tables and sentences."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from importlib import resources
from typing import Any

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup

from ..evaluation.summary import trust_word
from ..evaluation.words import texts
from ..runtime.outputs import writing
from ..table import Table, cell_text

#: A longer table is cut, with a note.
MOST_ROWS = 500
#: A page with fewer headings needs no list of contents.
FEWEST_CONTENTS = 4
#: Tones of a page's first sentences: what it is about is not to be trusted, or not everywhere.
ALARM, CARE, GOOD = "alarm", "care", "good"
_SIGNS = {GOOD: "✓ ", CARE: "! ", ALARM: "✕ "}
#: The page's programs, in the order in which they run; Plotly's only where a figure needs it.
_PROGRAMS = ("page.js", "view3d.js", "player.js")
#: Plotly's basic bundle: lines, dots and bars, a quarter of the whole program.
PLOTLY = "plotly-basic.min.js"
#: Text that is HTML already; everything else is escaped.
Html = Markup


@dataclass
class PageSection:
    """A heading with a plot, tables, sentences; left out where it has none of them."""

    heading: str = ""
    caption: str | None = None  # None: that of the heading in `words.toml`
    plot: go.Figure | None = None
    panels: Sequence[tuple[Html, go.Figure]] = ()  # Small plots beside each other, each under a title
    tables: Sequence[Table] = ()
    sentences: Iterable[str] = ()
    below: str = ""  # A paragraph at the end
    terms: Sequence[tuple[str, str]] = ()
    player: Mapping[str, Any] | None = None  # What the player in space is given; see `player`
    anchor: str = ""  # For the list of contents; the page gives each heading its own

    def __post_init__(self) -> None:
        if self.caption is None:
            self.caption = caption(self.heading)
        self.tables = [each for each in self.tables if each.rows]
        self.sentences = list(dict.fromkeys(self.sentences))

    def __bool__(self) -> bool:
        """Whether there is anything to show."""
        shown = (self.plot, self.panels, self.tables, self.sentences, self.below, self.terms, self.player)
        return any(shown)


@dataclass
class Fold:
    """Sections that a reader opens; paper has them all."""

    sections: Iterable[PageSection]
    words: str = "Details"
    anchor: str = ""
    has_contents: bool = False  # The list of contents stands here


@dataclass(frozen=True)
class Page:
    """An HTML page that needs no network and no other file."""

    title: str  # Heading, and the line under it
    subtitle: str
    verdict: Iterable[str]  # Sentences at the top
    sections: Iterable[PageSection | Fold]
    tone: str = ""  # `ALARM` or `CARE`: the first sentences are in red or amber
    # Tone, large word and sentences of each verdict of the first screen; `verdict` is below it then
    boxes: Sequence[tuple[str, str, list[str]]] = ()
    beside: PageSection | None = None  # Beside the boxes

    def write(self, path: str | os.PathLike[str], force: bool = False) -> None:
        """Write it to a file."""
        from jinja2 import Environment

        from .. import __version__

        sections: list[PageSection | Fold] = []
        every = [self.beside] if self.beside else []
        for each in self.sections:
            if isinstance(each, Fold):
                each = replace(each, sections=list(filter(None, each.sections)))
            if each:
                sections.append(each)
                every += each.sections if isinstance(each, Fold) else [each]
        headings: dict[str, str] = {}
        for section in every:
            stem = name = re.sub("[^a-z0-9]+", "-", section.heading.lower()).strip("-") or "section"
            while name in headings:
                name = f"{stem}-{len(headings)}"
            section.anchor = name
            headings |= {name: section.heading} if section.heading else {}
        environment = Environment(autoescape=True)
        environment.filters |= {"cell": _cell, "sentence": _sentence, "plotted": _plotted}
        programs = [PLOTLY] if any(section.plot or section.panels for section in every) else []
        parts = environment.from_string(web_file("page.html")).generate(
            page=vars(self) | {"sections": sections, "headings": list(headings.items())},
            version=__version__,
            style=Html(web_file("style.css")),
            scripts=[Html(web_file(name)) for name in (*programs, *_PROGRAMS)],
            most_rows=MOST_ROWS,
            fewest_contents=FEWEST_CONTENTS,
            signs=_SIGNS,
        )
        with (
            writing(path, force) as temporary,
            open(temporary, "w", encoding="utf-8", errors="backslashreplace") as file,
        ):
            file.writelines(parts)


def web_file(name: str) -> str:
    """A file of the pages."""
    return resources.files(__package__).joinpath("web", name).read_text(encoding="utf-8")


@cache
def words() -> dict[str, Any]:
    """What the pages say, of `words.toml`."""
    return texts(web_file("words.toml"))


def caption(heading: str, **given: object) -> Html:
    """The caption of a heading with what is filled in; empty where there is none."""
    filled = {name: each or "" for name, each in given.items()}
    return Html(words()["captions"].get(heading, "")).format(**filled)


def phrase(name: str, **given: object) -> Html:
    """A part of a caption, with what is filled in."""
    return Html(words()["phrases"][name]).format(**given)


def _plotted(plot: go.Figure) -> dict[str, Any]:
    """A plot for the page; its data in single precision: half the size, and still finer than any screen."""
    for trace in plot.data:
        for axis in ("x", "y"):
            if axis in trace and isinstance(trace[axis], np.ndarray) and trace[axis].dtype == np.float64:
                trace[axis] = trace[axis].astype(np.float32)
    wide = any(axis.domain and axis.domain[0] > 0.2 for axis in plot.select_xaxes())
    data = data_block(plot.to_json(engine="json"))
    return {"wide": wide, "height": int(plot.layout.height or 450), "data": data}


def data_block(values: str | dict[str, Any]) -> Html:
    """JSON for the page's programs; nothing in it can end the block."""
    text = values if isinstance(values, str) else json.dumps(values, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Html(f'<script type="application/json">{text}</script>')


def label(text: object) -> str:
    """Text of a file for a name, a tick or a label of a plot, where Plotly would obey some HTML."""
    return escape(str(text), quote=False)


def rendered(each: Table, caption: str | None = None, nothing: str = "") -> PageSection:
    """A table under its title and a caption; without a row `nothing` is said."""
    return PageSection(each.title, caption, tables=[each], below="" if each.rows else nothing)


def notes(sentences: Iterable[str]) -> PageSection:
    """The notes at the end of a page."""
    found = list(sentences)
    return PageSection("Notes", sentences=found, below="" if found else "There is nothing to note.")


def limits(sentences: Iterable[str], most: int) -> PageSection:
    """What limits the numbers of a page, at most `most` sentences."""
    every = list(dict.fromkeys(sentences))
    if len(every) > most:
        every = [*every[:most], f"{len(every) - most} sentences more are in --json"]
    return PageSection("What limits this", sentences=every or ["Nothing to note"])


def _cell(value: object) -> str:
    if isinstance(value, str) and value in _BADGES:
        return badge(value)
    return value if isinstance(value, Html) else cell_text(value, "–")


#: The word for what is not to be trusted.
NOT_TRUSTED = "not to be trusted"
_BADGES = {
    NOT_TRUSTED: ("✕ ", "wrong"),
    "clearly more": ("▲ ", "more"),
    "clearly less": ("▼ ", "less"),
    "no clear change": ("● ", "same"),
    "reached": ("✓ ", "same"),
    "not reached": ("– ", "open"),
    "cannot be assessed": ("? ", "open"),
}


def badge(word: str) -> Html:
    """A word in the colour of its meaning, with a sign for those who do not see colours."""
    sign, kind = _BADGES.get(word, ("! ", "care"))
    return Html('<span class="word {}">{}{}</span>').format(kind, sign, word)


def trust_badge(trusted: bool | None, gaps: int | None, untrusted: int | None) -> str:
    """Whether a result is to be trusted, as a word in its colour; a dash where not judged."""
    word = trust_word(trusted, gaps, untrusted)
    return badge(NOT_TRUSTED) if trusted is False else badge(word) if untrusted else word or "–"


def capitalised(text: str) -> str:
    """With a capital at the start."""
    return text[:1].upper() + text[1:]


def _sentence(text: str) -> str:
    text = capitalised(text)
    return text if text.endswith((".", "!", "?", ":")) else f"{text}."


#: General notes on both pages.
NO_DIAGNOSIS = (
    "This page measures motion. It is not a diagnosis and does not explain a motion; conclusions are left to"
    " the treating clinician."
)


def explained(names: Iterable[str], keys: Sequence[str]) -> PageSection:
    """A section that explains terms, and those that the keys of some measures need."""
    terms = words()["terms"]
    own = [name for name, each in terms.items() if any(key.startswith(each.get("of", " ")) for key in keys)]
    chosen = [(terms[name]["term"], Html(terms[name]["words"])) for name in (*names, *own)]
    return PageSection("The words on this page", terms=chosen)
