"""Rows of a study read back: of earlier versions, and where memory is short."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import dataset, parquet

from smoother.study.folder import rows_table, schema

#: So many bytes beside what the child has when it begins: too few for a thread, for some, for all.
SPARE_MB = (0, 12, 64)
SHORT_OF_MEMORY = """
import resource, sys
from pathlib import Path
import pyarrow.parquet
from smoother.study.folder import rows_table
used = int(Path("/proc/self/status").read_text().split("VmData:")[1].split()[0]) << 10
resource.setrlimit(resource.RLIMIT_DATA, (used + (int(sys.argv[1]) << 20),) * 2)
try:
    print(rows_table(sys.argv[2:]).num_rows)
except MemoryError:
    print("memory")
"""


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Three files of two rows each; the second lacks a column, the third has one more."""
    rows = [[{"id": f"{file}{row}", "recording": "a"} for row in range(2)] for file in range(3)]
    tables = [pa.Table.from_pylist(each, schema=schema()) for each in rows]
    tables[1] = tables[1].drop_columns(["version"])
    tables[2] = tables[2].append_column("later", pa.array([1, 2]))
    places = [str(tmp_path / f"rows-{number}.parquet") for number in range(3)]
    for table, place in zip(tables, places, strict=True):
        parquet.write_table(table, place, compression="zstd")
    return places


@pytest.mark.parametrize("columns", [None, ("recording", "id"), ("version",)])
def test_as_a_data_set_reads_them(files: list[str], columns: tuple[str, ...] | None):
    wanted = None if columns is None else list(columns)
    expected = dataset.dataset(files, schema=schema(), format="parquet").to_table(columns=wanted)
    assert rows_table(files, columns).equals(expected)


def test_no_files_are_no_rows():
    assert rows_table([]).equals(schema().empty_table())


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is Linux's")
@pytest.mark.parametrize("spare_mb", SPARE_MB)
def test_it_ends_however_little_memory_there_is(files: list[str], spare_mb: int):
    command = [sys.executable, "-c", SHORT_OF_MEMORY, str(spare_mb), *files]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() in ("6", "memory") or "Memory" in done.stderr, (done.stdout, done.stderr)
    if spare_mb == SPARE_MB[-1]:
        assert done.stdout.strip() == "6"
