"""A study's folder, and the columns of its results.

::

    DIR/results/*.parquet     a file with one row per recording
    DIR/day1/a.mcap           outputs, named as the recordings
    DIR/.unocclude/study      a word by which a worker checks that it sees this very folder
"""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import re
import secrets
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UnoccludeError
from ..io.mcap.messages import damage
from ..measures import Measures
from ..result import Recovery
from ..runtime.outputs import remove_stale_tempfiles, writing
from ..runtime.printable import plain

if TYPE_CHECKING:
    import pyarrow as pa

    from ..recording import Recording


def text_hash(*texts: str) -> str:
    """SHA-256 of texts, told apart."""
    return hashlib.sha256("\0".join(texts).encode("utf-8", "surrogateescape")).hexdigest()


Row = dict[str, Any]

DONE, FAILED = "done", "failed"
#: Name, Arrow type, unit and meaning of a column.
Column = tuple[str, str, str, str]


def _columns(of: str) -> tuple[Column, ...]:
    """The columns of a recording's row, or of what `measures` holds of each measure, of `columns.csv`."""
    text = resources.files(__package__).joinpath("columns.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(text.splitlines())
    return tuple((row["name"], row["type"], row["unit"], row["meaning"]) for row in rows if row["of"] == of)


COLUMNS, MEASURE_FIELDS = _columns("recording"), _columns("measure")


def schema() -> pa.Schema:
    """The columns as Arrow has them, unit and meaning in each one's metadata."""
    import pyarrow as pa

    kinds = {
        "string": pa.string(),
        "bool": pa.bool_(),
        "int64": pa.int64(),
        "double": pa.float64(),
        "list": pa.list_(pa.string()),
        "timestamp": pa.timestamp("us"),
    }

    def named(columns: Iterable[Column]) -> list[pa.Field]:
        return [
            pa.field(name, kinds[kind], metadata={"unit": unit, "description": meaning})
            for name, kind, unit, meaning in columns
        ]

    kinds["measures"] = pa.list_(pa.struct(named(MEASURE_FIELDS)))
    return pa.schema(named(COLUMNS))


def figures_of(recording: Recording, recovery: Recovery) -> Row:
    """The columns on a recovery."""
    from ..evaluation.summary import recovery_figures

    figures: dict[str, Any] = recovery_figures(recovery)
    gaps, sigma = figures["gaps"], figures["sigma_m"]
    notes = list(dict.fromkeys([*recording.notes, *recovery.notes]))
    taken = ("method", "side", "duration_s", "rate_hz", "samples", "answered", "occluded_s")
    own: Row = {name: figures[name] for name in taken} | {
        "gaps": len(gaps),
        "gap_longest_s": max((gap["length_s"] for gap in gaps), default=0.0),
        "sigma_max_m": sigma["occluded"]["max"],
        "sigma_median_m": sigma["occluded"]["median"],
        "sigma_visible_m": sigma["visible"]["median"],
        "sigma_max_deg": max((v for gap in gaps if (v := gap["sigma_max_deg"]) is not None), default=None),
        "clock_offset_s": recovery.clock_offset_s,
        "clock_offset_sigma_s": recovery.clock_offset_sigma_s,
        "trusted": recovery.estimates.trusted,
        "verdict": recovery.estimates.verdict,
        "self_check": "" if (check := recovery.estimates.self_check) is None else check.sentence,
        "self_check_95_m": None if check is None else check.error_95_m,
        "self_check_stated_95_m": None if check is None else check.stated_95_m,
        "error_95_m": figures["error_95_m"]["occluded"]["all"],
        "gaps_untrusted": sum(gap["trusted"] is False for gap in gaps),
        "notes": len(notes),
        "note_texts": notes,
        "damage": damage(notes),
    }
    return {name: plain(value) for name, value in own.items()}


#: How the figures of several arms become those of their recording; others are the largest.
_SUMMED = ("samples", "answered", "gaps", "gaps_untrusted", "occluded_s")


def figures_of_arms(results: Sequence[tuple[Recording, Recovery]]) -> Row:
    """The columns on a recording's arms: of several the worst, or their sum, and each by itself."""
    arms = [figures_of(recording, recovery) for recording, recovery in results]
    together = arms[0] | {"arms": len(arms)}
    for name in ("note_texts", "damage"):
        together[name] = list(dict.fromkeys(text for arm in arms for text in arm[name]))
    together["notes"] = len(together["note_texts"])
    if len(arms) == 1:
        return together
    labels = [recovery.arm_label for _, recovery in results]
    for name, value in arms[0].items():
        values = [arm[name] for arm in arms if arm[name] is not None]
        if name in _SUMMED:
            together[name] = sum(values)
        elif name == "trusted":
            together[name] = all(values) if values else None
        elif name in ("verdict", "self_check"):
            said = zip(labels, arms, strict=True)
            together[name] = " ".join(
                f"{label.capitalize()}: {arm[name]}" for label, arm in said if arm[name]
            )
        elif name != "notes" and (isinstance(value, int | float) or value is None):
            together[name] = max(values, default=None)
    # a clock belongs to one arm's IMU: those of several are with the arms
    together |= {"clock_offset_s": None, "clock_offset_sigma_s": None}
    together["side"] = ", ".join(label.replace(" arm", "") for label in labels)
    each = [{"body": recovery.body, **arm} for (_, recovery), arm in zip(results, arms, strict=True)]
    return together | {"arm_figures": json.dumps(each)}


def measure_rows(measured: Sequence[Measures]) -> list[dict[str, Any]]:
    """The measures of sessions, as the column `measures` holds them."""
    arm_fields = ("side", "body", "trusted")
    own = [name for name, *_ in MEASURE_FIELDS if name not in arm_fields]
    return [
        {name: getattr(arm, name) for name in arm_fields}
        | {name: plain(getattr(measure, name)) for name in own}
        for arm in measured
        for measure in arm.session
    ]


@dataclass(frozen=True)
class StudyFolder:
    """Names in a study's folder; `path` is absolute."""

    path: Path

    @property
    def results(self) -> Path:
        """Where the rows are stored."""
        return self.path / "results"

    @property
    def mark(self) -> Path:
        """The file with the study's word."""
        return self.path / ".unocclude" / "study"

    def output(self, name: str) -> Path:
        """Where the result of a recording is stored."""
        return self.path / name

    def open(self, force: bool = False) -> str:
        """Make the folder or take up one that contains a study; the study's word."""
        if self.path.exists() and not self.path.is_dir():
            raise UnoccludeError(f"{self.path} is a file; name a folder for the results")
        if not force and not self.mark.exists() and self._holds_others():
            raise UnoccludeError(
                f"{self.path} contains files that are not of a study; name a new folder, or --force"
            )
        for folder in (self.results, self.mark.parent):
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise UnoccludeError(f"{folder} cannot be made: {error.strerror or error}.") from error
        with self.alone():  # two that begin at once would each give it a word
            if re.fullmatch("[0-9a-f]{32}", self.word()) is None:
                with writing(self.mark, force=True) as temporary:
                    temporary.write_text(secrets.token_hex(16), encoding="ascii")
            return self.word()

    def _holds_others(self) -> bool:
        """Whether there is more than what a study has before its mark, which may be just beginning."""
        own = {self.results, self.mark.parent}
        inside = (*self.path.glob("*"), *self.results.glob("*"))
        return self.results.is_file() or any(path not in own for path in inside)

    def word(self) -> str:
        """The study's word; "" where it cannot be read."""
        try:
            return self.mark.read_text(encoding="ascii")
        except (OSError, UnicodeDecodeError):
            return ""

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep a second command from doing the same work; the system releases it with this process."""
        from filelock import FileLock, Timeout

        try:
            lock = FileLock(self.path / ".unocclude" / "lock").acquire(blocking=False)
        except Timeout as error:
            raise UnoccludeError(
                f"another command works on {self.path}; wait for it, or give another folder"
            ) from error
        except (NotImplementedError, OSError):
            # a file system without locks: two commands would do work twice, but spoil nothing
            yield
            return
        with lock:
            yield

    def write_row(self, row: Row) -> None:
        """Write a recording's row in place of its earlier one."""
        import pyarrow as pa
        from pyarrow import parquet

        table = pa.Table.from_pylist([{name: _as_text(row.get(name)) for name, *_ in COLUMNS}], schema())
        self.results.mkdir(parents=True, exist_ok=True)  # somebody may have removed it
        with writing(self._row_file(row["recording"]), force=True) as temporary:
            parquet.write_table(table, temporary, compression="zstd")

    def row(self, name: str) -> Row | None:
        """The row of a recording; None without one that can be read."""
        import pyarrow as pa

        try:
            rows: list[Row] = _read_rows(self._row_file(name), schema()).to_pylist()
        except (pa.ArrowException, OSError):
            return None
        return rows[-1] if rows else None

    def _row_file(self, name: str) -> Path:
        return self.results / f"{text_hash(name)[:24]}.parquet"

    def rows(self, columns: Iterable[str] | None = None, damaged: list[str] | None = None) -> pa.Table:
        """The latest row of each recording, by name; files that cannot be read are named as `damaged`.

        Without a list for them they are refused. The same study writes them anew.
        """
        import pyarrow as pa

        wanted = schema() if columns is None else pa.schema([schema().field(name) for name in columns])
        tables = [wanted.empty_table()]
        for file in sorted(self.results.glob("*.parquet")):
            try:
                tables.append(_read_rows(file, wanted))
            except (pa.ArrowException, OSError) as error:
                if damaged is None:
                    raise UnoccludeError(
                        f"{file} cannot be read; the same `unocclude batch` writes it anew"
                    ) from error
                file.unlink(missing_ok=True)
                damaged.append(f"{file.name} among the results was damaged; its recording is computed again.")
        table = pa.concat_tables(tables).sort_by("finished")
        latest = {name: place for place, name in enumerate(table["recording"].to_pylist())}
        return table.take(np.array([latest[name] for name in sorted(latest)], np.int64))

    def sweep(self, names: Iterable[str]) -> None:
        """Remove what processes that were killed left half written."""
        for folder in {self.results, *(self.output(name).parent for name in names)}:
            remove_stale_tempfiles(folder, again=True)


def _read_rows(file: Path, wanted: pa.Schema) -> pa.Table:
    """The rows of a file; a column that it lacks is null."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with open(file, "rb") as stream:
            table = parquet.read_table(stream, use_threads=False, pre_buffer=False)
    except OSError as error:
        if error.errno == errno.ENOMEM:
            raise MemoryError(str(error)) from error
        raise
    found = [
        table[field.name].cast(field.type)
        if field.name in table.column_names
        else pa.nulls(table.num_rows, field.type)
        for field in wanted
    ]
    return pa.table(found, schema=wanted)


def _as_text(value: Any) -> Any:
    """A value as Parquet holds it: bytes of a file's name that are not UTF-8 are written out."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode("utf-8")
    return [_as_text(each) for each in value] if isinstance(value, list) else value
