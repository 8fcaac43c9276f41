"""`unocclude benchmark`: public data sets, frozen gaps, every method, one table."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UnoccludeError
from ..evaluation.methods import METHODS
from .methods import choose
from .options import Force, Json, Processes
from .output import check_outputs, print_notes, progress_bar, say, say_written, show, write_json

if TYPE_CHECKING:
    from ..evaluation.benchmark import BenchmarkRun

#: Where the data sets lie, unless `--data` says.
VARIABLE = "UNOCCLUDE_DATASETS"
_FILES = ("benchmark.json", "benchmark.md", "gaps.csv")
#: Notes on the terminal; all are in the JSON.
_MOST_NOTES = 6


def benchmark(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FOLDER", help="Where results go.")],
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            metavar="FOLDER",
            help=f"Folder with one folder per data set.  [default: ${VARIABLE}]",
            show_default=False,
        ),
    ] = None,
    method: Annotated[
        str, typer.Option("--method", metavar="M,M,..", help=f"Methods, or all: {', '.join(METHODS)}.")
    ] = "all",
    datasets: Annotated[
        str, typer.Option("--datasets", metavar="D,D,..", help="Data sets by their folders' names, or all.")
    ] = "all",
    split: Annotated[
        str, typer.Option("--split", metavar="development|test|all", help="Which trials.")
    ] = "all",
    trials: Annotated[
        int | None,
        typer.Option(
            "--trials",
            min=1,
            help="Use at most this many trials per data set, to try the command.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Seed of the gaps; 0 is the published benchmark.")
    ] = 0,
    processes: Processes = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Score all methods on public data sets with hidden gaps.

    The folder of --data contains broad/, utd_mhad/, smartfallmm/ and sevivi/ as published; missing ones are
    named and left out. Splits and gaps are frozen: they depend only on a trial's name and the seed. Writes
    benchmark.json, benchmark.md (the table) and gaps.csv (one row per gap).
    """
    from .. import __version__
    from ..evaluation.benchmark import all_notes, find_trials, plain, run_benchmark, summary
    from ..evaluation.datasets import DATASETS, SPLITS

    folder = data or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if folder is None:
        raise typer.BadParameter(f"name the folder of the data sets with --data, or in {VARIABLE}")
    if not folder.is_dir():
        raise UnoccludeError(f"{folder} is not a folder; name the folder that contains the data sets")
    keys = _chosen("--datasets", datasets, tuple(DATASETS))
    splits = _chosen("--split", split, SPLITS)
    names = tuple(choose(method))
    files = [output / name for name in _FILES]
    if output.is_dir() or json_file is not None:
        check_outputs(force, [*(files if output.is_dir() else []), json_file])
    found, missing = find_trials(folder, keys, splits, trials)
    output.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    with progress_bar("benchmark") as progress:
        run = run_benchmark(folder, found, names, progress, seed, processes or 0)
    figures = plain(run, seed, __version__)
    _write(run, output, figures, force)
    write_json(json_file, figures, force)
    for key in run.tables:
        table = summary(run, *key)
        show(replace(table, title=f"{table.title}; median / rms in gaps, cm"))
    notes = [*missing, *all_notes(run)]
    print_notes(notes[:_MOST_NOTES])
    if len(notes) > _MOST_NOTES:
        say(f"{len(notes) - _MOST_NOTES} notes more are in {output / 'benchmark.json'}")
    say(f"{len(found)} trials in {(time.perf_counter() - began) / 60:.1f} minutes")
    say_written(*files, json_file)


def _chosen(option: str, text: str, known: tuple[str, ...]) -> list[str]:
    """Names of a comma-separated list; "all" is every one."""
    wanted = [part.strip() for part in text.split(",") if part.strip()]
    if wanted == ["all"]:
        return list(known)
    unknown = [name for name in wanted if name not in known]
    if unknown or not wanted:
        raise typer.BadParameter(f"{option} takes {', '.join(known)} or all, not '{', '.join(unknown)}'")
    return list(dict.fromkeys(wanted))


def _write(run: BenchmarkRun, output: Path, figures: dict[str, object], force: bool) -> None:
    from ..evaluation.benchmark import gap_rows, markdown
    from ..runtime.csv_rows import write_rows
    from ..runtime.outputs import writing

    write_json(output / "benchmark.json", figures, force)
    with writing(output / "benchmark.md", force) as temporary:
        temporary.write_text(markdown(run), encoding="utf-8", newline="\n")
    with (
        writing(output / "gaps.csv", force) as temporary,
        open(temporary, "w", encoding="utf-8", newline="") as file,
    ):
        write_rows(file, gap_rows(run))
