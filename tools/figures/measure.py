"""Run the jobs, keep what is done, and sum it up."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from smoother.evaluation.gap_table import spread_of

from .jobs import TITLES, Job, run_job

Rows = list[dict[str, Any]]


def measure(todo: Iterable[Job], kept: Path, processes: int, until_s: float = float("inf")) -> None:
    """Run what `kept` does not hold yet, and add each job to it as it ends.

    Parameters
    ----------
    kept : Path
        JSON lines, {"job", "data", "rows"} each; an interrupted run goes on from it.
    until_s : float, s
        No job is begun after so many seconds.
    """
    done = {entry["job"] for entry in read_rows(kept)}
    left = [job for job in todo if job.name not in done]
    began = time.perf_counter()
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool, open(kept, "a") as file:
        running = {}
        while left or running:
            while left and len(running) < processes and time.perf_counter() - began < until_s:
                job = left.pop(0)
                running[pool.submit(run_job, job)] = job
            if not running:
                break
            ended = next(as_completed(running))
            job = running.pop(ended)
            file.write(json.dumps({"job": job.name, "data": job.data, "rows": ended.result()}) + "\n")
            file.flush()
            print(f"{time.perf_counter() - began:6.0f} s  {job.name}, {len(left)} left", flush=True)


def read_rows(kept: Path) -> list[dict[str, Any]]:
    """The jobs that are done."""
    if not kept.exists():
        return []
    return [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()]


def summed_up(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures by data set, gap length and method; the graph beside its ingredients is on the same gaps."""
    found: dict[str, Any] = {}
    for data, title in TITLES.items():
        rows = [row for entry in entries if entry["data"] == data for row in entry["rows"]]
        if data == "ingredients":
            rows = _graph_beside(rows, entries) + rows
        scored = [row for row in rows if "skipped" not in row]
        if scored:
            found[data] = {"title": title, "lengths": _lengths(scored)}
    return found


def _graph_beside(rows: Rows, entries: list[dict[str, Any]]) -> Rows:
    """The whole graph's rows in the gaps of these rows."""
    gaps = {(row["recording"], row["length_s"], row["start_s"]) for row in rows}
    return [
        row
        for entry in entries
        if entry["data"] == "realistic"
        for row in entry["rows"]
        if row["method"] == "graph" and (row["recording"], row["length_s"], row["start_s"]) in gaps
    ]


def _lengths(rows: Rows) -> list[dict[str, Any]]:
    found = []
    for length in sorted({row["length_s"] for row in rows}):
        here = [row for row in rows if row["length_s"] == length]
        methods = {}
        for name in dict.fromkeys(row["method"] for row in here):
            mine = [row for row in here if row["method"] == name]
            spread = spread_of([None if row["failure"] else row["rms_m"] for row in mine])
            samples = [(row["rms_m"] ** 2 * row["samples"], row["samples"]) for row in mine if row["samples"]]
            count = sum(n for _, n in samples)
            pooled = (sum(total for total, _ in samples) / count) ** 0.5 if count else None
            methods[name] = {
                **{key: _rounded(value) for key, value in spread.to_dict().items()},
                "samples_rms_m": _rounded(pooled),
                "nees": _rounded(_mean_nees(mine)),
            }
        found.append({"length_s": length, "methods": methods})
    return found


def _mean_nees(rows: Rows) -> float | None:
    known = [(row["nees"] * row["samples"], row["samples"]) for row in rows if row["nees"] is not None]
    count = sum(n for _, n in known)
    return sum(total for total, _ in known) / count if count else None


def _rounded(value: float | int | None) -> float | int | None:
    return round(value, 5) if isinstance(value, float) else value
