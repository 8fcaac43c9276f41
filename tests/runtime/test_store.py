"""Arrays in files: what they hold, what they cost, and what happens where there is no space."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from private_memory import program_output

from smoother.errors import UnoccludeError
from smoother.runtime import store
from smoother.runtime.store import GatheredRows, large_array

LARGE = (300_000, 3)


@pytest.mark.parametrize("shape", [(5, 3), LARGE, (0, 3), ()])
@pytest.mark.parametrize(
    ("fill", "dtype"), [(np.nan, np.float64), (0, np.int64), (7, np.int8), (-0.0, np.float64), (1, bool)]
)
def test_arrays_are_those_in_memory(shape: tuple[int, ...], fill: float, dtype: type):
    array, plain = large_array(shape, fill, dtype), np.full(shape, fill, dtype)
    assert type(array) is np.ndarray and array.flags.writeable
    assert (array.dtype, array.shape) == (plain.dtype, plain.shape)
    assert array.tobytes() == plain.tobytes()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_stays_flat():
    program = """
import numpy as np
from private_memory import PrivatePeak
from smoother.runtime.store import GatheredRows, large_array
peak = PrivatePeak()
begin = peak.mb()
arrays, gathered = [large_array((1_000_000, 4)), large_array((1_000_000, 4), 0.0)], GatheredRows((4,))
for start in range(0, 1_000_000, 50_000):
    for array in arrays:
        array[start:start + 50_000] = start
    gathered.append(arrays[0][start:start + 50_000])
arrays[1] = gathered.done()
total = 0.0
for start in range(0, 1_000_000, 50_000):
    total += arrays[0][start:start + 50_000].sum() - arrays[1][start:start + 50_000].sum()
assert total == 0.0
print(peak.mb() - begin)
"""
    assert float(program_output(program)) < 12  # MB, of 96 MB in arrays


def test_full_disk_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(store, "_allocate", full)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(UnoccludeError, match=rf"no space left .* in {re.escape(str(tmp_path))};.*TMPDIR"):
        large_array(LARGE)


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="no posix_fallocate")
def test_space_is_reserved_or_refused_before_it_is_mapped():
    limited = """
import resource, signal
import numpy as np
from smoother.errors import UnoccludeError
from smoother.runtime.store import GatheredRows, large_array
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 22, 1 << 22))
for make in (
    lambda: large_array((1_000_000,), 0.0),
    lambda: large_array((1_000_000,)),
    lambda: GatheredRows().append(np.zeros(1_000_000)),
):
    try:
        make()
        print("made")
    except UnoccludeError as error:
        print(error)
"""
    run = subprocess.run([sys.executable, "-c", limited], check=True, capture_output=True, text=True)
    assert [line[:30] for line in run.stdout.splitlines()] == ["No temporary files can be made"] * 3


def test_without_fallocate_files_are_written(monkeypatch: pytest.MonkeyPatch):
    def unsupported(*_: object) -> None:
        raise OSError(errno.EOPNOTSUPP, "not supported")

    monkeypatch.setattr(os, "posix_fallocate", unsupported, raising=False)
    assert not large_array(LARGE, 0.0).any()


def test_folder_that_cannot_be_used_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    for make in (lambda: large_array(LARGE), lambda: GatheredRows((3,)).append(np.zeros(LARGE))):
        with pytest.raises(UnoccludeError, match=r"No temporary files can be made in .*missing"):
            make()
