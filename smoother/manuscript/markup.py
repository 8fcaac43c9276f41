"""A methods section as text, Markdown or LaTeX."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence

from .document import CITATION, Document, MethodsSection
from .references import Reference

_WIDTH = 100
_TO_FILL_IN = "To be filled in by you (not in the result)"
_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "±": r"$\pm$",
    "<": r"$<$",
    ">": r"$>$",
    '"': r"\textquotedbl{}",
}


def rendered(document: Document, markup: str) -> str:
    r"""The section in one of `MARKUPS`.

    Parameters
    ----------
    document : Document
    markup : str
        "text", "markdown" or "latex". LaTeX is what a document's body may take in by `\input`; its
        references are a `thebibliography`.

    Returns
    -------
    text : str
        Ends with a line break.
    """
    return MARKUPS[markup](document).rstrip("\n") + "\n"


def _text(document: Document) -> str:
    number = _numbers(document)
    lines: list[str] = []
    for arm in document.arms:
        lines += [f"METHODS: {arm.heading}", "", *_filled(_cited(_paragraph(arm), number)), ""]
        width = max(len(label) for label, _ in arm.rows)
        for label, value in arm.rows:
            lead = f"  {label.ljust(width)}  "
            lines += textwrap.wrap(
                value, _WIDTH + width // 2, initial_indent=lead, subsequent_indent=" " * len(lead)
            )
        lines += ["", *_items("Notes of the program on this recording", arm.notes, "text")]
    lines += _items(f"{_TO_FILL_IN} {_cited('[@cereatti2024]', number)}", document.to_fill_in, "text")
    lines += ["References", ""]
    for reference in document.references:
        mark = f"[{number[reference.key]}] "
        lines += textwrap.wrap(
            mark + _reference(reference), _WIDTH, subsequent_indent=" " * len(mark), break_long_words=False
        )
    return "\n".join(lines)


def _markdown(document: Document) -> str:
    number = _numbers(document)
    lines: list[str] = []
    for arm in document.arms:
        lines += [f"## Methods: {_md(arm.heading)}", "", _cited(_md(_paragraph(arm)), number), ""]
        lines += ["| what | value |", "|---|---|"]
        lines += [f"| {_md(label)} | {_md(value)} |" for label, value in arm.rows]
        lines += ["", *_items("Notes of the program on this recording", arm.notes, "markdown")]
    lines += _items(f"{_TO_FILL_IN} {_cited('[@cereatti2024]', number)}", document.to_fill_in, "markdown")
    lines += ["### References", ""]
    lines += [f"{number[each.key]}. {_md(_reference(each))}" for each in document.references]
    return "\n".join(lines)


def _latex(document: Document) -> str:
    lines = ["% \\input this file in a document; it needs \\usepackage[utf8]{inputenc} and [T1]{fontenc}."]
    for arm in document.arms:
        lines += [rf"\subsection*{{Methods: {_tex(arm.heading)}}}", "", _tex(_paragraph(arm)), ""]
        lines += [r"\begin{center}", r"\begin{tabular}{p{0.36\linewidth}p{0.56\linewidth}}", r"\hline"]
        lines += [rf"{_tex(label)} & {_tex(value)} \\" for label, value in arm.rows]
        lines += [r"\hline", r"\end{tabular}", r"\end{center}", ""]
        lines += _items("Notes of the program on this recording", arm.notes, "latex")
    lines += _items(f"{_TO_FILL_IN} [@cereatti2024]", document.to_fill_in, "latex")
    lines.append(rf"\begin{{thebibliography}}{{{len(document.references)}}}")
    lines += [rf"\bibitem{{{each.key}}} {_tex(_reference(each))}" for each in document.references]
    return "\n".join([*lines, r"\end{thebibliography}"])


def _items(title: str, items: Sequence[str], markup: str) -> list[str]:
    """A list with its title; nothing where it is empty."""
    if not items:
        return []
    if markup == "latex":
        body = [rf"\item {_tex(item)}" for item in items]
        return [rf"\paragraph{{{_tex(title)}}}", r"\begin{itemize}", *body, r"\end{itemize}", ""]
    if markup == "markdown":
        return [f"### {title}", "", *[f"- {_md(item)}" for item in items], ""]
    lines = [title, ""]
    for item in items:
        lines += textwrap.wrap(item, _WIDTH, initial_indent="- ", subsequent_indent="  ")
    return [*lines, ""]


def _paragraph(arm: MethodsSection) -> str:
    return " ".join(arm.sentences)


def _filled(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, break_long_words=False, break_on_hyphens=False)


def _numbers(document: Document) -> dict[str, int]:
    return {reference.key: number for number, reference in enumerate(document.references, start=1)}


def _cited(text: str, number: dict[str, int]) -> str:
    return CITATION.sub(lambda match: f"[{number[match[1]]}]" if match[1] in number else match[0], text)


def _reference(reference: Reference) -> str:
    address = f"https://doi.org/{reference.doi}" if reference.doi else reference.url
    return f"{reference.text} {address}".strip()


def _md(text: str) -> str:
    """Text whose own marks are not markup; citations stay."""
    return re.sub(r"([\\`*_|<>])", r"\\\1", text)


def _tex(text: str) -> str:
    """Text with LaTeX's own characters written out, and citations as LaTeX has them."""
    parts = CITATION.split(text)  # text, key, text, ..
    plain = ["".join(_LATEX.get(letter, letter) for letter in part) for part in parts[::2]]
    cites = [rf"\cite{{{key}}}" for key in parts[1::2]]
    return "".join(word for pair in zip(plain, [*cites, ""], strict=True) for word in pair)


MARKUPS: dict[str, Callable[[Document], str]] = {"text": _text, "markdown": _markdown, "latex": _latex}
