"""Arrays in files: what they hold, what they cost, and what happens where there is no space."""

from __future__ import annotations

import errno
import gc
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from private_memory import program_output

from smoother.errors import UnoccludeError
from smoother.runtime import disk_store
from smoother.runtime.disk_store import DiskStore
from smoother.runtime.store import Store

LARGE = (300_000, 3)


@pytest.mark.parametrize("shape", [(5, 3), LARGE, (0, 3), ()])
@pytest.mark.parametrize(
    ("fill", "dtype"), [(np.nan, np.float64), (0, np.int64), (7, np.int8), (-0.0, np.float64), (1, bool)]
)
def test_arrays_are_those_of_a_store_in_memory(shape: tuple[int, ...], fill: float, dtype: type):
    with DiskStore() as store:
        array, plain = store.array(shape, fill, dtype), Store().array(shape, fill, dtype)
        assert type(array) is np.ndarray
        assert array.dtype == plain.dtype
        assert array.shape == plain.shape
        assert array.tobytes() == plain.tobytes()
        assert array.flags.writeable


def test_what_is_written_outlives_the_store():
    values = np.random.default_rng(0).normal(size=LARGE)
    with DiskStore() as store:
        arrays = [store.array(LARGE), store.array(LARGE, 0.0)]
        for array in arrays:
            array[:] = values
            np.testing.assert_array_equal(array, values)
        part = arrays.pop()[1000:2000]
        array = None
        gc.collect()
        np.testing.assert_array_equal(part, values[1000:2000])
    np.testing.assert_array_equal(arrays[0], values)


def test_no_file_is_left_or_seen(tmp_path: Path):
    with DiskStore(tmp_path) as store:
        array = store.array(LARGE)
        store.put(array)
        assert list(tmp_path.iterdir()) == []
    assert list(tmp_path.iterdir()) == []


def test_values_put_aside_come_back_once(tmp_path: Path):
    with DiskStore(tmp_path) as store:
        values = [{"a": np.arange(n), "text": "x" * n} for n in (0, 10, 200_000)]
        kept = [store.put(value) for value in values]
        for which in (1, 0, 2):
            taken = store.pop(kept[which])
            assert taken["text"] == values[which]["text"]
            np.testing.assert_array_equal(taken["a"], values[which]["a"])
        with pytest.raises(KeyError):
            store.pop(kept[0])
        again = store.put("again")
        assert again == (0, again[1])  # type: ignore[index]  # all were taken: the space is used again
        assert store.pop(again) == "again"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_stays_flat():
    program = """
import numpy as np
from private_memory import PrivatePeak
from smoother.runtime.disk_store import DiskStore
peak = PrivatePeak()
with DiskStore() as store:
    begin = peak.mb()
    arrays = [store.array((1_000_000, 4)), store.array((1_000_000, 4), 0.0)]
    for array in arrays:
        for start in range(0, len(array), 50_000):
            array[start:start + 50_000] = start
    total = 0.0
    for start in range(0, 1_000_000, 50_000):
        total += arrays[0][start:start + 50_000].sum() - arrays[1][start:start + 50_000].sum()
    assert total == 0.0
    print(peak.mb() - begin)
"""
    assert float(program_output(program)) < 12  # MB, of 64 MB in arrays


def test_full_disk_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(disk_store, "_allocate", full)
    sentence = rf"no space left .* in {re.escape(str(tmp_path))};.*TMPDIR"
    with pytest.raises(UnoccludeError, match=sentence):
        DiskStore(tmp_path).array(LARGE)
    monkeypatch.setattr(disk_store.pickle, "dump", full)
    with pytest.raises(UnoccludeError, match=sentence):
        DiskStore(tmp_path).put(1)


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="no posix_fallocate")
def test_space_is_reserved_or_refused_before_it_is_mapped():
    limited = """
import resource, signal
import numpy as np
from smoother.errors import UnoccludeError
from smoother.runtime.disk_store import DiskStore
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 22, 1 << 22))
for fill in (0.0, np.nan):
    try:
        DiskStore().array((1_000_000,), fill)
        print("made")
    except UnoccludeError as error:
        print(error)
"""
    run = subprocess.run([sys.executable, "-c", limited], check=True, capture_output=True, text=True)
    assert [line[:30] for line in run.stdout.splitlines()] == ["No temporary files can be made"] * 2


def test_without_fallocate_files_are_written(monkeypatch: pytest.MonkeyPatch):
    def unsupported(*_: object) -> None:
        raise OSError(errno.EOPNOTSUPP, "not supported")

    monkeypatch.setattr(os, "posix_fallocate", unsupported, raising=False)
    assert not DiskStore().array(LARGE, 0.0).any()


def test_folder_that_cannot_be_used_is_said(tmp_path: Path):
    with pytest.raises(UnoccludeError, match=r"No temporary files can be made in .*missing"):
        DiskStore(tmp_path / "missing").array(LARGE)
