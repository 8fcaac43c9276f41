"""How methods look when they are drawn over each other: a colour each, the graph bold."""

from __future__ import annotations

#: Colour and plotly dash of each method; strong methods in strong colours.
STYLES: dict[str, tuple[str, str]] = {
    "graph": ("#D55E00", "solid"),
    "rts": ("#0072B2", "solid"),
    "gaussian-process": ("#009E73", "solid"),
    "linear-drift": ("#CC79A7", "solid"),
    "ukf": ("#56B4E9", "dash"),
    "multirate-kalman": ("#B8860B", "dash"),
    "kalman": ("#7F5AA8", "dash"),
    "pchip": ("#777777", "dot"),
    "camera-only": ("#444444", "dot"),
    "hold": ("#B0B0B0", "dot"),
}
#: For a method without a style of its own.
PLAIN = ("#777777", "solid")


def line_of(method: str) -> dict[str, object]:
    """Plotly's line for a method."""
    colour, dash = STYLES.get(method, PLAIN)
    return {"color": colour, "dash": dash, "width": 3.2 if method == "graph" else 1.5}


def faint(colour: str, opacity: float) -> str:
    """A colour #rrggbb as rgba."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity:g})"
