"""A study's results: Parquet files that are written once, so that others can read them at any time."""

from __future__ import annotations

import json
import os
import secrets
import time
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime.outputs import writing
from .folder import COLUMNS, DONE, FAILED, Row, StudyFolder, rows_table, schema
from .inputs import file_hash, place_of, state_of
from .job import Known

if TYPE_CHECKING:
    import pyarrow as pa

#: A file of results has no more rows than this.
MOST_ROWS = 1000
#: Rows wait at most this share of the time that the run has taken, and at most this long, s.
_SHARE, _SOONEST_S, _LATEST_S = 0.05, 0.5, 30.0
_LOOKED_UP = (
    *("id", "recording", "status", "retry", "input", "input_place", "input_bytes"),
    *(
        "input_mtime_ns",
        "input_state",
        "config_hash",
        "calibration_hash",
        "version",
        "output_hash",
        "output_bytes",
        "output_mtime_ns",
    ),
    "finished",
)


@dataclass(frozen=True, slots=True)
class _Past:
    """What is kept in memory of a row."""

    row_id: str
    settings: tuple[str, str, str]
    done: bool
    retry: bool
    input: str
    input_place: str
    input_state: str
    output_hash: str
    output_bytes: int | None
    output_mtime_ns: int | None


class Ledger:
    """The rows of a study, those of earlier runs included."""

    def __init__(self, folder: StudyFolder) -> None:
        self._folder = folder
        self._word = folder.mark.read_text(encoding="ascii")
        self.damaged: list[str] = []
        self._waiting: list[Row] = []
        self._began = self._flushed = time.monotonic()
        self._past: dict[str, tuple[_Past, ...]] = {}
        self._settings: dict[tuple[str, str, str], tuple[str, str, str]] = {}
        finished: dict[str, datetime] = {}
        waiting = {path.stem for path in folder.rows.glob("*.json")}
        for batch in self._read(_LOOKED_UP).sort_by("finished").to_batches(max_chunksize=10_000):
            for row in batch.to_pylist():
                self._remember(row)
                if row["id"] in waiting:
                    finished[row["id"]] = row["finished"]
        self._adopt(finished)

    def find(
        self, name: str, source: str, settings: tuple[str, str, str], retry_failed: bool = False
    ) -> tuple[str, tuple[Known, ...]]:
        """What is known of a recording under these settings."""
        past = [
            each
            for each in self._past.get(name, ())
            if each.settings == settings and (each.done or not (each.retry or retry_failed))
        ]
        known = tuple(Known(each.row_id, each.output_hash) for each in past)
        try:
            about = os.stat(source)
        except OSError:
            return "", known
        place = place_of(self._word, source)
        for each in reversed(past):
            here = source == each.input or place == each.input_place
            if here and each.input_state == state_of(self._word, about.st_size, about.st_mtime_ns):
                if not each.done or self._untouched(name, each):
                    return each.row_id, known
                break
        return "", known

    def _untouched(self, name: str, past: _Past) -> bool:
        try:
            about = os.stat(self._folder.output(name))
        except OSError:
            return False
        return (about.st_size, about.st_mtime_ns) == (past.output_bytes, past.output_mtime_ns)

    def add(self, row: Row) -> None:
        """Take a row; it is among the results at a `tick` soon after, or at `flush`."""
        self._waiting.append(row)
        self.tick()

    def tick(self) -> None:
        """Write the rows that wait if they have waited long enough."""
        now = time.monotonic()
        wait = min(max(_SHARE * (now - self._began), _SOONEST_S), _LATEST_S)
        if len(self._waiting) >= MOST_ROWS or now - self._flushed >= wait:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait as one more file of results."""
        import pyarrow as pa
        from pyarrow import parquet

        if not self._waiting:
            return
        columns = [name for name, *_ in COLUMNS]
        rows = [{name: _value(name, row.get(name)) for name in columns} for row in self._waiting]
        self._folder.results.mkdir(parents=True, exist_ok=True)  # somebody may have removed it
        table = pa.Table.from_pylist(rows, schema=schema())
        path = self._folder.results / f"rows-{time.time_ns()}-{secrets.token_hex(4)}.parquet"
        with writing(path) as temporary:
            parquet.write_table(table, temporary, compression="zstd")
        for row in self._waiting:
            (self._folder.rows / f"{row['id']}.json").unlink(missing_ok=True)
            self._remember(row)
        self._waiting, self._flushed = [], time.monotonic()

    def rows(self, ids: Iterable[str]) -> pa.Table:
        """The latest row of each of these ids, in order of the recordings' names."""
        table = self._read().sort_by("finished")
        latest = {row: place for place, row in enumerate(table["id"].to_pylist())}
        chosen = [latest[row] for row in dict.fromkeys(ids) if row in latest]
        return table.take(np.array(chosen, np.int64)).sort_by("recording")

    def _read(self, columns: Iterable[str] | None = None) -> pa.Table:
        import pyarrow as pa

        files = sorted(str(path) for path in self._folder.results.glob("*.parquet"))
        if not files:
            return schema().empty_table()
        try:
            return rows_table(files, columns)
        except MemoryError:  # the files may be intact
            raise
        except (pa.ArrowException, OSError):
            sound = [file for file in files if self._is_sound(file)]
            return rows_table(sound, columns) if sound else schema().empty_table()

    def _is_sound(self, file: str) -> bool:
        """Whether a file of results can be read; else it is put aside, and its recordings are redone."""
        import pyarrow as pa

        try:
            rows_table([file])
        except MemoryError:
            raise
        except (pa.ArrowException, OSError):
            aside = self._folder.mark.parent / "damaged"
            aside.mkdir(exist_ok=True)
            os.replace(file, aside / Path(file).name)
            self.damaged.append(
                f"{Path(file).name} among the results was damaged and is in .unocclude/damaged now; its"
                " recordings are computed again."
            )
            return False
        return True

    def _remember(self, row: Row) -> None:
        settings = (row["config_hash"], row["calibration_hash"], row["version"])
        past = _Past(
            row_id=row["id"],
            settings=self._settings.setdefault(settings, settings),  # one for all: there may be a million
            done=row["status"] == DONE,
            retry=bool(row.get("retry")),
            input=row["input"] or "",
            input_place=row.get("input_place") or "",
            input_state=self._input_state(row),
            output_hash=row.get("output_hash") or "",
            output_bytes=row.get("output_bytes"),
            output_mtime_ns=row.get("output_mtime_ns"),
        )
        name = row["recording"]
        others = [each for each in self._past.get(name, ()) if each.row_id != past.row_id]
        self._past[name] = (*others, past)

    def _input_state(self, row: Row) -> str:
        """Of the recording when it was read; rows of earlier versions contain its time of change instead."""
        if state := row.get("input_state"):
            return str(state)
        size, mtime_ns = row.get("input_bytes"), row.get("input_mtime_ns")
        return "" if size is None or mtime_ns is None else state_of(self._word, size, mtime_ns)

    def _adopt(self, finished: dict[str, datetime]) -> None:
        """Take the rows that workers left when a run was cut off before it wrote them."""
        for path in sorted(self._folder.rows.glob("*.json")):
            row = _left(path)
            if row is None:
                continue
            known = finished.get(row["id"])
            if known is not None and known >= _value("finished", row["finished"]):
                path.unlink(missing_ok=True)
            elif row["status"] != DONE or self._is_output(row):
                self._waiting.append(row)
        self.flush()

    def _is_output(self, row: Row) -> bool:
        """Whether the output of a row is in its place; a worker may have died before it moved it there."""
        output = self._folder.output(row["recording"])
        if not output.is_file() or output.stat().st_size != row["output_bytes"]:
            return False
        return file_hash(output) == row["output_hash"]


def _left(path: Path) -> dict[str, Any] | None:
    """A row that a worker left; None where it was taken by another run, is damaged, or is not ours."""
    import pyarrow as pa

    try:
        row = json.loads(path.read_text(encoding="utf-8"))
        if not (isinstance(row, dict) and row.keys() >= {"id", "status", "finished", "recording"}):
            return None
        values = {name: _value(name, row.get(name)) for name, *_ in COLUMNS}
        pa.Table.from_pylist([values], schema=schema())
        whole = row["config_hash"], row["calibration_hash"], row["version"], row["id"], row["recording"]
        is_ours = all(isinstance(text, str) for text in whole) and row["status"] in (DONE, FAILED)
        is_whole = row["status"] != DONE or {"output_bytes", "output_hash"} <= row.keys()
    except (OSError, ValueError, KeyError, TypeError, RecursionError, pa.ArrowException):
        return None
    return row if is_ours and is_whole else None


def _value(name: str, value: Any) -> Any:
    """A value as the results have it: times are UTC, as the column's description states, not in its type."""
    if isinstance(value, str) and name != "finished":
        return _text(value)
    if isinstance(value, list):
        return [_text(item) if isinstance(item, str) else item for item in value]
    if name != "finished":
        return value
    return datetime.fromisoformat(value).astimezone(UTC).replace(tzinfo=None)


def _text(value: str) -> str:
    """Text as Parquet holds it: bytes of a file's name that are not UTF-8 are written out."""
    return value.encode("utf-8", "backslashreplace").decode("utf-8")
