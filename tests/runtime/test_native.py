"""Libraries that crash, hang or take all memory on a damaged file."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest

from smoother.errors import RecordingError
from smoother.io import import_utd_mhad
from smoother.runtime import inputs

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="nothing is tried in a child there")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "file"
    path.write_bytes(b"abc")
    return path


def refuse(path: Path) -> None:
    raise ValueError("a refusal is not a crash")


class WithoutMemory(Exception):
    """What a library throws where memory does not even suffice to say so."""

    def __str__(self) -> str:
        raise MemoryError


def refuse_without_memory(path: Path) -> None:
    raise WithoutMemory


def hang(path: Path) -> None:
    while True:
        pass


def test_a_file_that_is_read_or_refused(file: Path):
    assert not inputs.crashes_in_subprocess(file, Path.read_bytes)
    assert not inputs.crashes_in_subprocess(file, refuse)


def test_the_child_never_goes_on_as_a_copy_of_the_program(file: Path):
    mine = os.getpid()
    try:
        ends = inputs.crashes_in_subprocess(file, refuse_without_memory)
    finally:
        if os.getpid() != mine:  # the copy: it must not run the tests that follow
            os._exit(0)
    assert ends


@pytest.mark.slow
def test_a_hang_ends_also_where_the_program_has_handlers_of_its_own(
    file: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(inputs, "_LONGEST_S", 1)
    before = {number: signal.signal(number, lambda *_: None) for number in (signal.SIGALRM, signal.SIGXCPU)}
    try:
        assert inputs.crashes_in_subprocess(file, hang)
        monkeypatch.setattr(inputs, "_WAITING", 1)
        assert inputs.crashes_in_subprocess(file, lambda path: signal.sigwait([signal.SIGUSR1]))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_matlab_file_with_a_type_that_there_is_not(tmp_path: Path):
    """It ends the process that reads it, by scipy 1.17, or not, by what is in its memory."""
    import numpy as np
    from scipy.io import savemat

    path = tmp_path / "a.mat"
    savemat(path, {"d_iner": np.ones((6, 6)), "d_skel": np.ones((20, 3, 4))})
    assert len(import_utd_mhad(path, path).imu.t_s) == 6
    data = bytearray(path.read_bytes())
    data[data.index(b"d_iner") + 8] = 0x72
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"a\.mat (is a damaged|cannot be read as a) Matlab file"):
        import_utd_mhad(path, path)
