"""Arrays on maps of files: what leaves the memory comes back, private maps and plain arrays stay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from smoother.runtime.disk_store import DiskRoom
from smoother.runtime.pages import gathered, let_go


def resident_kb() -> int:
    """Pages of files in this process's memory."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssFile"):
            return int(line.split()[1])
    raise AssertionError("no RssFile")


needs_proc = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells of its pages")


@needs_proc
def test_memory_is_let_go_and_contents_stay(tmp_path: Path) -> None:
    with DiskRoom(tmp_path) as room:
        values = room.array((1_000_000, 3), 0.0)
        values[:] = np.arange(1_000_000)[:, None]
        full = resident_kb()
        let_go(values[5:7, 1], np.zeros(3))  # a part of it will do
        assert full - resident_kb() > 20_000
        np.testing.assert_array_equal(values[::99_999, 2], np.arange(1_000_000)[::99_999])


@needs_proc
def test_rows_are_gathered_without_the_rest(tmp_path: Path) -> None:
    with DiskRoom(tmp_path) as room:
        values = room.array((1_000_000, 3), 0.0)
        values[:] = np.arange(1_000_000)[:, None]
        let_go(values)
        before = resident_kb()
        index = np.linspace(0, 999_999, 5000).astype(np.int64)
        for column in (values, values[:, 1], values[:, None, :]):
            np.testing.assert_array_equal(gathered(column, index), column[index])
            let_go(values)
            gathered(column, index)
            assert resident_kb() - before < 4_000


def test_what_was_written_to_a_private_map_stays(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(8 * 4096))
    private = np.memmap(tmp_path / "a", np.float64, "c")
    private[:] = 3.0
    let_go(private, private[3:])
    assert (private == 3.0).all()


def test_arrays_in_memory() -> None:
    values = np.random.default_rng(0).normal(size=(100, 2))
    kept = values.copy()
    let_go(values)
    np.testing.assert_array_equal(gathered(values, np.array([3, 3, 99])), kept[[3, 3, 99]])
