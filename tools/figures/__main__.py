"""The figures of README and documents, from the repository's root.

`python -m tools.figures picture` draws docs/picture.svg; `python -m tools.figures docs` makes the tutorial's
pictures, docs/pictures; `python -m tools.figures curves` measures error against gap length with every method
and draws docs/curves.svg (UNOCCLUDE_DATASETS names the folder of BROAD and UTD-MHAD). What was measured is
kept in `--rows`: an interrupted run goes on from it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

HERE = Path(__file__).parents[2]


def main() -> None:
    """Read the options and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("picture", help="one occlusion of data/demo.mcap before and after")
    one.add_argument("-o", "--output", type=Path, default=HERE / "docs" / "picture.svg")
    one.add_argument("--gap", type=int, default=0, help="which gap, from 0")
    two = commands.add_parser("curves", help="error against gap length")
    two.add_argument("-o", "--output", type=Path, default=HERE / "docs" / "curves.svg")
    two.add_argument(
        "--rows", type=Path, default=HERE / "out" / "curves.jsonl", help="every gap, kept as it is done"
    )
    two.add_argument(
        "--data", nargs="*", default=["realistic", "broad", "utd", "clean", "ingredients"], help="data sets"
    )
    two.add_argument("--seeds", type=int, default=3, help="simulated recordings")
    two.add_argument("--processes", type=int, default=2)
    two.add_argument("--minutes", type=float, default=float("inf"), help="begin no job after this time")
    three = commands.add_parser("tables", help="the figures of docs/curves.json as tables in Markdown")
    three.add_argument("file", type=Path, nargs="?", default=HERE / "docs" / "curves.json")
    four = commands.add_parser("docs", help="the tutorial's pictures")
    four.add_argument("-o", "--output", type=Path, default=HERE / "docs" / "pictures", help="folder")
    options = parser.parse_args()
    if options.command == "docs":
        from .pictures import draw_tutorial

        draw_tutorial(options.output)
    elif options.command == "picture":
        from .pictures import draw

        draw(options.output, options.gap)
    elif options.command == "tables":
        from tools.figures.curves import tables

        print("\n".join(tables(json.loads(options.file.read_text(encoding="utf-8")))))
    else:
        curves(options)


def curves(options: argparse.Namespace) -> None:
    """Measure what is not measured yet, and draw."""
    from tools.figures.curves import jobs

    from .curves import draw, measure, read_rows, summed_up

    options.rows.parent.mkdir(parents=True, exist_ok=True)
    measure(jobs(options.data, options.seeds), options.rows, options.processes, 60 * options.minutes)
    found = summed_up(read_rows(options.rows))
    figures = options.output.with_suffix(".json")
    figures.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    draw(found, options.output)
    print(f"written: {options.output}, {figures}")


if __name__ == "__main__":
    main()
