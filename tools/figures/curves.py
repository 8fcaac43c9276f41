"""Error against gap length, drawn: a panel a data set, every method a line, quartiles as its spread."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from smoother.report.method_comparison import PLAIN, STYLES

_DASHES = {"solid": "-", "dash": "--", "dot": ":"}
_MARKERS = dict(zip(STYLES, "osD^vPX<>.", strict=True))
_INGREDIENTS = ("#D55E00", "#444444", "#777777", "#A3A3A3", "#CCCCCC")
#: Panels in this order; the last is of the graph's own ingredients.
_PANELS = ("realistic", "broad", "utd", "clean", "ingredients")


def draw(found: dict[str, Any], output: Path) -> None:
    """Draw what `measure.summed_up` gives, as the kind of picture that the name ends in."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"svg.hashsalt": "unocclude", "svg.fonttype": "none", "font.size": 9})
    plt.rcParams.update({"font.family": "sans-serif", "font.sans-serif": ["Arial", "DejaVu Sans"]})
    figure, axes = plt.subplots(2, 3, figsize=(12.0, 7.6), layout="constrained")
    places = axes.ravel()
    for axis, name in zip(places, _PANELS, strict=False):
        if name not in found:
            axis.axis("off")
        elif name == "ingredients":
            _ingredients(axis, found[name])
        else:
            _curves(axis, found[name])
    _legend(places[-1], found)
    figure.suptitle(
        "Error inside a gap against its length: median over gaps, bars and band from 25 % to 75 %",
        fontsize=11,
    )
    figure.savefig(output, metadata={"Date": None} if output.suffix == ".svg" else None, dpi=110)
    plt.close(figure)


def _curves(axis: Any, panel: dict[str, Any]) -> None:
    """One data set: lines of medians, a band of quartiles for the graph and bars for the others."""
    methods = list(dict.fromkeys(name for entry in panel["lengths"] for name in entry["methods"]))
    for place, name in enumerate(reversed(methods)):
        x, low, median, high = _points(panel, name)
        if not len(x):
            continue
        colour, dash = STYLES.get(name, PLAIN)
        bold = name == "graph"
        at = x if bold else x * 1.012 ** (place - len(methods) / 2)  # bars beside each other
        look: dict[str, Any] = {"color": colour, "ls": _DASHES[dash], "marker": _MARKERS.get(name, "o")}
        look |= {"lw": 3.0 if bold else 1.2, "ms": 6 if bold else 3.5, "zorder": 10 if bold else 3}
        axis.plot(at, median, label=name, **look)
        if bold:
            axis.fill_between(x, low, high, color=colour, alpha=0.22, lw=0, zorder=2)
        else:
            axis.errorbar(
                at, median, [median - low, high - median], fmt="none", ecolor=colour, lw=0.7, alpha=0.7
            )
    _dress(axis, panel, logarithmic=True)


def _ingredients(axis: Any, panel: dict[str, Any]) -> None:
    """Bars: the whole graph and what it loses without each ingredient."""
    names = list(panel["lengths"][0]["methods"])
    width = 0.8 / len(names)
    for place, name in enumerate(names):
        for number, entry in enumerate(panel["lengths"]):
            each = entry["methods"].get(name)
            if each is None or each["median_m"] is None:
                continue
            low, median, high = (100 * each[key] for key in ("low_m", "median_m", "high_m"))
            at = number + (place - (len(names) - 1) / 2) * width
            axis.bar(
                at,
                median,
                0.9 * width,
                color=_INGREDIENTS[place % len(_INGREDIENTS)],
                label=("the whole graph" if name == "graph" else name) if number == 0 else None,
            )
            axis.errorbar(at, median, [[median - low], [high - median]], fmt="none", ecolor="#333333", lw=0.9)
    axis.set_xticks(range(len(panel["lengths"])), [f"{entry['length_s']:g} s" for entry in panel["lengths"]])
    axis.set_ylabel("error in a gap, rms, cm")
    axis.set_title("What each ingredient brings\n(simulated arm, realistic errors)", fontsize=10)
    axis.set_ylim(0, 1.4 * axis.get_ylim()[1])  # room for the names
    axis.legend(fontsize=8, frameon=False, loc="upper left", ncols=2)
    axis.grid(axis="y", alpha=0.3)


def _points(panel: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lengths, s, and the quartiles at them, cm."""
    rows = [
        (entry["length_s"], *(100 * entry["methods"][name][key] for key in ("low_m", "median_m", "high_m")))
        for entry in panel["lengths"]
        if name in entry["methods"] and entry["methods"][name]["median_m"] is not None
    ]
    x, low, median, high = np.array(rows).reshape(-1, 4).T
    return x, low, median, high


def _dress(axis: Any, panel: dict[str, Any], logarithmic: bool) -> None:
    lengths = [entry["length_s"] for entry in panel["lengths"]]
    counts = [next(iter(entry["methods"].values()))["gaps"] for entry in panel["lengths"]]
    if logarithmic:
        axis.set_xscale("log")
        axis.set_yscale("log")
    axis.set_xticks(lengths, [f"{length:g}" for length in lengths])
    axis.minorticks_off()
    low, high = axis.get_ylim()
    ticks = [
        tick
        for tick in (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
        if low <= tick <= high
    ]
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_xlabel("gap, s")
    axis.set_ylabel("error in a gap, rms, cm")
    gaps = f"{min(counts)} to {max(counts)}" if min(counts) < max(counts) else f"{max(counts)}"
    axis.set_title(f"{panel['title']}\n({gaps} gaps a length)", fontsize=10)
    axis.grid(alpha=0.3)


def _legend(axis: Any, found: dict[str, Any]) -> None:
    """The methods once for all panels, in the sixth place."""
    from matplotlib.lines import Line2D

    axis.axis("off")
    names = [name for name in STYLES if any(_has(found[panel], name) for panel in found)]
    lines = [
        Line2D(
            [],
            [],
            color=STYLES[name][0],
            ls=_DASHES[STYLES[name][1]],
            marker=_MARKERS[name],
            lw=3.0 if name == "graph" else 1.4,
            ms=6 if name == "graph" else 4,
        )
        for name in names
    ]
    labels = [f"{name} (unocclude)" if name == "graph" else name for name in names]
    axis.legend(lines, labels, loc="center", frameon=False, fontsize=10, handlelength=3.5, labelspacing=0.8)


def _has(panel: dict[str, Any], name: str) -> bool:
    return any(name in entry["methods"] for entry in panel["lengths"])
