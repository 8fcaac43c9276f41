"""`unocclude benchmark`: public data sets, frozen gaps, every method, one table."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from ..errors import UnoccludeError
from ..evaluation.methods import METHODS
from . import options as o
from .methods import choose
from .output import (
    check_outputs,
    print_notes,
    progress_bar,
    say,
    say_more,
    say_written,
    show,
    write_csv,
    write_json,
    write_text,
)

#: Where the data sets lie, unless `--data` says.
VARIABLE = "UNOCCLUDE_DATASETS"
_FILES = ("benchmark.json", "benchmark.md", "gaps.csv")
#: Notes on the terminal; all are in the JSON.
_MOST_NOTES = 6


def benchmark(
    output: Annotated[Path, o.value("FOLDER", "Where results go.", "-o", "--output")],
    data: Annotated[o.File, o.value("FOLDER", f"One folder per data set.  [default: ${VARIABLE}]")] = None,
    method: Annotated[str, o.value("M,M,..", f"Methods, or all: {', '.join(METHODS)}.")] = "all",
    datasets: Annotated[str, o.value("D,D,..", "Data sets by folder, or all.")] = "all",
    split: Annotated[Literal["development", "test", "all"], o.option("Which trials.")] = "all",
    trials: Annotated[o.Count, o.option("At most this many trials per data set.", min=1)] = None,
    seed: Annotated[int, o.option("Seed of the gaps; 0 is the published benchmark.", min=0)] = 0,
    processes: o.Processes = None,
    json_file: o.Json = None,
    force: o.Force = False,
) -> None:
    """Score all methods on public data sets with hidden gaps.

    The folder of --data contains broad/, utd_mhad/ and smartfallmm/ as published; missing ones are
    named and left out. Splits and gaps are frozen: they depend only on a trial's name and the seed. Writes
    benchmark.json, benchmark.md (the table) and gaps.csv (one row per gap).

    Example: unocclude benchmark --data datasets -o benchmark
    """
    from .. import __version__
    from ..evaluation.benchmark import digest, find_trials, gap_rows, plain, run_benchmark, summary
    from ..evaluation.datasets import DATASETS, SPLITS

    folder = data or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if folder is None:
        raise typer.BadParameter(f"name the folder of the data sets with --data, or in {VARIABLE}")
    if not folder.is_dir():
        raise UnoccludeError(f"{folder} is not a folder; name the folder that contains the data sets")
    keys = list(dict.fromkeys(part.strip() for part in datasets.split(",") if part.strip()))
    keys = list(DATASETS) if keys == ["all"] else keys
    if not keys or set(keys) - set(DATASETS):
        raise typer.BadParameter(f"--datasets takes {', '.join(DATASETS)} or all, not '{datasets}'")
    splits = list(SPLITS) if split == "all" else [split]
    names = tuple(choose(method))
    files = [output / name for name in _FILES]
    if output.is_dir() or json_file is not None:
        check_outputs(force, [*(files if output.is_dir() else []), json_file])
    found, missing = find_trials(folder, keys, splits, trials)
    output.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    with progress_bar("benchmark") as progress:
        run = run_benchmark(folder, found, names, progress, seed, processes or 0)
    figures = plain(run, seed, __version__, digest(found))
    tables = [summary(each) for each in figures["datasets"]]
    for path in (files[0], json_file):
        write_json(path, figures, force)
    write_text(files[1], "\n".join(f"### {each.title}\n\n{each.markdown()}" for each in tables), force)
    write_csv(files[2], gap_rows(run), force)
    for table in tables:
        show(replace(table, title=f"{table.title}; median / rms in gaps, cm"))
    notes = [*missing, *figures["notes"]]
    print_notes(notes[:_MOST_NOTES])
    say_more(len(notes), _MOST_NOTES, f"notes more in {files[0]}")
    say(f"{len(found)} trials in {(time.perf_counter() - began) / 60:.1f} minutes")
    say_written(*files, json_file)
