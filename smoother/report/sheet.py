"""The pages' common parts: one file that needs no network, headings, figures, lists, tables, and terms."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from string import Template
from typing import Any

import plotly.graph_objects as go

from ..runtime.outputs import writing
from ..table import Table, cell_text

#: A longer table is cut, with a note.
MOST_ROWS = 500
#: A page with fewer headings needs no list of contents.
FEWEST_CONTENTS = 4
#: Tones of a page's first sentences: what it is about is not to be trusted, or not everywhere.
ALARM, CARE, GOOD = "alarm", "care", "good"
#: Stands for the sections while the page around them is put together.
_HERE = "<!-- sections -->"
#: Stands for the list of contents where it is not to follow the first sentences.
CONTENTS = "<!-- contents -->"
#: The page's programs, in the order in which they run; Plotly's only where a figure needs it.
_PROGRAMS = ("page.js", "view3d.js", "player.js")
#: Plotly's basic bundle: lines, dots and bars, a quarter of the whole program.
PLOTLY = "plotly-basic.min.js"


class Html(str):
    """Text that is HTML already, and is not escaped."""


@dataclass(frozen=True)
class Page:
    """An HTML page that needs no network and no other file."""

    title: str  # Heading, and the line under it
    subtitle: str  # Heading, and the line under it
    verdict: Iterable[str]  # Sentences at the top
    sections: Iterable[str]  # HTML, made by `figure`, `space`, `picture`, `listing` and `tabulated`
    two_pages: bool = False  # Print it in small type: what is short fits on two pages
    tone: str = ""  # `ALARM` or `CARE`: the first sentences are in red or amber
    # Tone, large word and sentences of each verdict of the first screen; `verdict` is below it then
    boxes: Sequence[tuple[str, str, list[str]]] = ()
    beside: str = ""  # HTML beside the boxes

    def write(self, path: str | os.PathLike[str], force: bool = False) -> None:
        """Write it to a file."""
        from .. import __version__

        below = _paragraphs(self.verdict)
        with (
            writing(path, force) as temporary,
            open(temporary, "w", encoding="utf-8", errors="backslashreplace") as file,
        ):
            (beside, *body), contents = _with_anchors([self.beside, *self.sections])
            page = Template(_web("page.html")).substitute(
                title=escape(self.title),
                made=escape(self.subtitle),
                style=_web("style.css"),
                scripts=_programs([beside, *body]),
                content=_HERE,
                kind=' class="two-pages"' if self.two_pages else "",
                version=escape(__version__),
            )
            before, after = page.split(_HERE)
            file.write(before)
            if self.boxes:
                said = "".join(
                    _box(tone, _paragraphs(sentences), word) for tone, word, sentences in self.boxes
                )
                beside = f'<div class="beside">{beside}</div>' if beside else ""
                file.write(f'<div class="screen"><div class="said">{said}</div>{beside}</div>{below}')
            else:
                file.write(_box(self.tone, below))
            if not any(CONTENTS in section for section in body):
                file.write(contents)
            for section in body:
                file.write(f"\n{section.replace(CONTENTS, contents)}")
            file.write(after)


def _paragraphs(texts: Iterable[str]) -> str:
    return "".join(f"<p>{escape(_sentence(text))}</p>" for text in texts)


_TONE_SIGNS = {GOOD: "✓ ", CARE: "! ", ALARM: "✕ "}


def _box(tone: str, paragraphs: str, word: str = "") -> str:
    large = f'<p class="large">{_TONE_SIGNS.get(tone, "")}{escape(word)}</p>' if word else ""
    return f'<div class="summary{f" {tone}" if tone else ""}">{large}{paragraphs}</div>'


def _web(name: str) -> str:
    return resources.files(__package__).joinpath("web", name).read_text(encoding="utf-8")


def _programs(body: Sequence[str]) -> str:
    """The page's own programs; Plotly's where something is plotted."""
    names = [PLOTLY] if any('class="plot"' in section for section in body) else []
    return "".join(f"<script>{_web(name)}</script>\n" for name in (*names, *_PROGRAMS))


def _with_anchors(sections: Sequence[str]) -> tuple[list[str], str]:
    """Sections whose headings have names of their own, and the list of contents that leads to them."""
    names: dict[str, str] = {}

    def anchored(match: re.Match[str]) -> str:
        heading = match.group(1)
        stem = name = _slug(heading)
        while name in names:
            name = f"{stem}-{len(names)}"
        names[name] = heading
        return f'<h2 id="{name}">{heading}</h2>'

    body = [re.sub("<h2>(.*?)</h2>", anchored, section, flags=re.DOTALL) for section in sections]
    items = "".join(f'<li><a href="#{name}">{heading}</a></li>' for name, heading in names.items())
    contents = f'<details class="contents"><summary>Contents</summary><ol>{items}</ol></details>'
    return body, contents if len(names) >= FEWEST_CONTENTS else ""


def _slug(heading: str) -> str:
    return re.sub("[^a-z0-9]+", "-", heading.lower()).strip("-") or "section"


def figure(heading: str, caption: str, plot: go.Figure) -> str:
    """A heading, a caption and a plot; the page draws it, and lets a phone move a wide one sideways."""
    wide = bool((plot.layout.meta or {}).get("wide"))
    wide |= any(axis.domain and axis.domain[0] > 0.2 for axis in plot.select_xaxes())
    height = int(plot.layout.height or 450)
    return (
        f'<div class="together">{headed(heading, caption)}<div class="figure{" wide" if wide else ""}">'
        f'<div class="plot" id="figure-{_slug(heading)}" style="height:{height}px"></div>'
        f"{data_block(plot.to_json(engine='json'))}</div></div>"
    )


def data_block(values: str | dict[str, Any]) -> str:
    """JSON for the page's programs; nothing in it can end the block."""
    text = values if isinstance(values, str) else json.dumps(values, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return f'<script type="application/json">{text}</script>'


def label(text: object) -> str:
    """Text of a file for a name, a tick or a label of a plot, where Plotly would obey some HTML."""
    return escape(str(text), quote=False)


def qualified(section: str, mark: str) -> str:
    """A section whose figures' ids end in a mark: the same section may stand on the page for several arms."""
    return re.sub(r'(?<=["#])figure-[a-z0-9-]+', lambda match: f"{match[0]}-{mark}", section)


def folded(sections: Iterable[str], words: str = "Details", below: str = "") -> Iterator[str]:
    """Sections that a reader opens; paper has them all."""
    yield f'<details class="more"><summary>{escape(words)}</summary>{below}'
    yield from sections
    yield "</details>"


def picture(heading: str, caption: str, png: bytes) -> str:
    """A heading, a caption and an image."""
    from base64 import b64encode

    data = b64encode(png).decode("ascii")
    return (
        f'{headed(heading, caption)}<p><img alt="{escape(heading)}" src="data:image/png;base64,{data}"></p>'
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
    """A table; a dash marks None and nan."""
    rows = list(rows)
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>" for row in rows[:MOST_ROWS]
    )
    more = f"<p>{len(rows) - MOST_ROWS} rows more are left out.</p>" if len(rows) > MOST_ROWS else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def rendered(each: Table, caption: str = "") -> str:
    """A table under its title and a caption; "" without rows."""
    return tabulated(each.title, caption or each.caption, each.columns, each.rows) if each.rows else ""


def headed(heading: str, caption: str = "") -> str:
    """A heading and a caption (`Html`, or plain text) below it."""
    below = f'<p class="caption">{_escaped(caption)}</p>' if caption else ""
    return f"<h2>{escape(heading)}</h2>{below}"


def _cell(value: object) -> str:
    return value if isinstance(value, Html) else escape(cell_text(value, "–"))


def _escaped(value: object) -> str:
    return value if isinstance(value, Html) else escape(str(value))


def capitalised(text: str) -> str:
    """With a capital at the start."""
    return text[:1].upper() + text[1:]


def listed(words: Sequence[str]) -> str:
    """Words with commas between them, and `and` before the last."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _sentence(text: str) -> str:
    text = capitalised(text)
    return text if text.endswith((".", "!", "?", ":")) else f"{text}."


#: General notes on both pages.
NO_DIAGNOSIS = (
    "This page measures motion. It is not a diagnosis and does not explain a motion; conclusions are left to"
    " the treating clinician."
)
TERMS = {
    "interval": (
        "95 % interval",
        "if the stated uncertainty is right, the true value is between these two numbers in 95 of 100"
        " recordings. A wide interval means a poorly known value. The thin dark lines show it.",
    ),
    "recovered": (
        "recovered",
        "how much of a value comes from time in which the camera did not see the arm, calculated from the"
        " sensor on the wrist.",
    ),
    "clear": (
        "clearly more, clearly less",
        "the difference is larger than the errors of both recordings explain (95 %), and larger than the"
        " minimal detectable change where one is known. More is not always better.",
    ),
    "unclear": (
        "no clear change, no clear difference",
        "the recordings do not show a difference. There may be one that is smaller than the interval.",
    ),
    "unknown": (
        "cannot be assessed",
        "there is no value, no interval, or the interval is too wide.",
    ),
    "symmetry": (
        "right against left, in percent",
        "how much more the right arm has than the left one, as a part of their mean: 0 is alike, below 0 the"
        " left one has more.",
    ),
    "mdc": (
        "minimal detectable change",
        "measured against motion capture or given by you: two sessions without any change differ by less in"
        " 95 of 100 cases.",
    ),
    "flexion": ("elbow flexion", "bend of the elbow: 0° is a straight arm."),
    "elevation": (
        "shoulder elevation",
        "how far the upper arm is raised: 0° hangs down, 90° is level.",
    ),
    "pronation": ("forearm pronation", "turn of the forearm: 0° is the palm forward with the arm hanging."),
    "reach": ("reach volume", "the volume that the hand reached, in litres."),
    "sparc": (
        "SPARC",
        "smoothness of the hand's speed: nearer to zero is smoother; a simple reach has about −1.4.",
    ),
    "ratio": ("path ratio", "length of the hand's path divided by the straight line: 1 is straight."),
}


def explained(heading: str, names: Iterable[str]) -> str:
    """A section that explains terms."""
    lines = "".join(
        f"<p><b>{escape(term)}</b>: {escape(words)}</p>" for term, words in (TERMS[name] for name in names)
    )
    return f'{headed(heading)}<div class="terms">{lines}</div>'


def terms_of(keys: Iterable[str]) -> list[str]:
    """The terms that the names of some measures need."""
    needs = {
        "flexion": "elbow_flexion",
        "elevation": "shoulder_elevation",
        "pronation": "pronation",
        "reach": "hand_reach",
        "sparc": "sparc",
        "ratio": "hand_path_ratio",
    }
    shown = list(keys)
    return [term for term, start in needs.items() if any(key.startswith(start) for key in shown)]
