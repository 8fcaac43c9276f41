"""Outputs appear whole or not at all; columns in files: what they hold and cost, and a full disk."""

from __future__ import annotations

import errno
import os
import re
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from made_recordings import make
from private_memory import program_output

from smoother.cli.output import Out, check_outputs
from smoother.errors import UnoccludeError
from smoother.io import write_recording
from smoother.runtime import outputs as outputs_module
from smoother.runtime import store
from smoother.runtime.outputs import umask, writing
from smoother.runtime.store import GatheredRows, large_array


def test_an_older_output_needs_force(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("old")
    with pytest.raises(UnoccludeError, match="force=True"), writing(tmp_path / "out"):
        raise AssertionError("not reached")
    with writing(tmp_path / "out", force=True) as temporary:
        temporary.write_text("new")
    assert (tmp_path / "out").read_text() == "new"


@pytest.mark.parametrize(
    ("place", "number", "words"),
    [
        ("os.fsync", errno.ENOSPC, r"out\.mcap could not be written: no space left on the disk"),
        ("smoother.io.mcap.merge.Output._write", errno.EIO, "Input/output error"),
    ],
)
def test_a_failure_in_the_middle_of_writing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, number: int, words: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(place, fail)
    with pytest.raises(UnoccludeError, match=words):
        write_recording(make(), tmp_path / "out.mcap")
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.name != "posix", reason="devices")
def test_places_that_cannot_be(tmp_path: Path) -> None:
    """Nothing but a file, or nothing at all, is ever replaced: not the device of everybody's zeros either."""
    places = {tmp_path: "is a folder", tmp_path / "no" / "out": "does not exist", "/dev/zero": "or a device"}
    for place, said in places.items():
        with pytest.raises(UnoccludeError, match=said), writing(place, force=True):
            pass


@pytest.mark.skipif(os.name != "posix", reason="links")
def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    with writing(tmp_path / "link", force=True) as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


posix = pytest.mark.skipif(os.name != "posix", reason="devices, modes and links of POSIX")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@posix
def test_a_pipe_and_the_null_device_are_written_to(tmp_path: Path):
    pipe, received = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: received.append(pipe.read_text()), daemon=True)
    reader.start()
    for path in (pipe, Path("/dev/null")):
        with writing(path) as temporary:
            temporary.write_text("whole")
    reader.join(10.0)
    assert received == ["whole"] and stat.S_ISFIFO(os.lstat(pipe).st_mode)
    with pytest.raises(UnoccludeError, match="is a socket or a device"), writing("/dev/zero", True):
        pass


@posix
def test_standard_output_comes_after_what_was_printed(tmp_path: Path):
    code = (
        "from smoother.runtime.outputs import writing\nprint('before')\n"
        "with writing('/dev/stdout') as t: t.write_text('the output\\n')\nprint('after')"
    )
    with open(tmp_path / "file", "w+") as file:
        subprocess.run([sys.executable, "-c", code], stdout=file, check=True, timeout=60)
        file.seek(0)
        assert file.read().split() == ["before", "the", "output", "after"]


@posix
@pytest.mark.parametrize("old", [0o600, 0o640, 0o664, 0o444])
def test_the_old_files_mode_is_kept(tmp_path: Path, old: int):
    (tmp_path / "out").write_text("old")
    (tmp_path / "out").chmod(old)
    with writing(tmp_path / "out", force=True) as temporary:
        temporary.write_text("new")
        assert mode(temporary) == 0o600
    assert mode(tmp_path / "out") == old


@posix
@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_a_new_file_has_the_umasks_mode(tmp_path: Path, umask: int):
    before = os.umask(umask)
    try:
        with writing(tmp_path / "out") as temporary:
            temporary.write_text("new")
            assert mode(temporary) == 0o600
        assert os.umask(umask) == umask, "asking for it must not change it"
    finally:
        os.umask(before)
    assert mode(tmp_path / "out") == 0o666 & ~umask


@posix
@pytest.mark.parametrize("how", ["name", "symlink", "hard link", "through a folder"])
def test_an_output_is_never_an_input(tmp_path: Path, how: str):
    source, other = tmp_path / "rec.mcap", tmp_path / "other.mcap"
    source.write_bytes(b"recording")
    if how == "name":
        other = source
    elif how == "symlink":
        other.symlink_to(source)
    elif how == "hard link":
        os.link(source, other)
    else:
        (tmp_path / "folder").symlink_to(tmp_path)
        other = tmp_path / "folder" / "rec.mcap"
    with pytest.raises(UnoccludeError, match="is read by this command"):
        check_outputs(True, [other], [source])
    with pytest.raises(UnoccludeError, match="two outputs"):
        check_outputs(True, [other, source])


def test_a_calibration_that_is_used_may_be_added_to_and_is_not_replaced(tmp_path: Path):
    """As `gaps --calibration arm.toml --keep-in arm.toml`."""
    arm = tmp_path / "arm.toml"
    arm.write_text("mine")
    Out(force=True).check_files([], [arm], [], [arm])
    for written, read in (([arm], []), ([], [arm])):
        with pytest.raises(UnoccludeError, match="is read by this command"):
            Out(force=True).check_files(written, [arm], read, [arm])


@posix
def test_what_a_killed_program_left_is_swept(tmp_path: Path):
    """`kill -9` in the middle of an output; one that still runs keeps its own, as do other computers."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = outputs_module.temporary_name(tmp_path / "a", gone.pid)
    folder = outputs_module.temporary_name(tmp_path / "session", gone.pid)
    folder.mkdir()
    (folder / "x").touch()
    others = tmp_path / outputs_module.temporary_name(tmp_path / "b").name.replace(
        outputs_module._HOST, "0" * 8
    )
    for path in (left, others, tmp_path / ".mine.tmp"):
        path.touch()
    with writing(tmp_path / "c") as working:
        outputs_module.remove_stale_tempfiles(tmp_path, again=True)
        assert {path.name for path in tmp_path.iterdir()} == {working.name, others.name, ".mine.tmp"}
        os.utime(others, (0, 0))
        outputs_module.remove_stale_tempfiles(tmp_path, again=True)
        assert not others.exists()
        working.write_text("whole")
    assert sorted(os.listdir(tmp_path)) == [".mine.tmp", "c"]


@pytest.mark.parametrize("has_links", [True, False])
def test_of_two_on_one_new_name_one_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_links: bool
) -> None:
    """Both said "written", and one of the results was lost."""
    if not has_links:

        def refused(*_: object) -> None:
            raise OSError(errno.EPERM, "Operation not permitted")

        monkeypatch.setattr("smoother.runtime.outputs.os.link", refused)
    out = tmp_path / "out"
    said = r"out was written by another command meanwhile; .*force=True"
    with pytest.raises(UnoccludeError, match=said), writing(out) as slow:
        slow.write_text("slow")
        with writing(out) as quick:
            quick.write_text("quick")
    assert out.read_text() == "quick" and os.listdir(tmp_path) == ["out"]
    with writing(out, force=True) as slow:
        slow.write_text("slow")
        with writing(out, force=True) as quick:
            quick.write_text("quick again")
        assert out.read_text() == "quick again"
    assert out.read_text() == "slow" and os.listdir(tmp_path) == ["out"]
    if os.name == "posix":
        assert mode(out) == 0o666 & ~umask() and out.stat().st_nlink == 1


@pytest.mark.slow
@posix
def test_sigterm_removes_what_is_half_written(tmp_path: Path):
    """The command's handler lets outputs be removed at once, not only by the next command."""
    code = (
        "import signal, sys, time\n"
        # who runs the tests may ignore them, as nohup does, which a program then keeps to
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGTERM, signal.SIG_DFL)\nsignal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        "import smoother.cli.config as d\nfrom smoother.runtime.outputs import writing\n"
        "def wait(*_):\n"
        "  with writing(sys.argv[1]) as t:\n"
        "    t.write_text('half'); print('begun', flush=True)\n"
        # in short sleeps: a signal that comes just before one is noticed after it
        "    for _ in range(2400): time.sleep(0.1)\n"
        "d.use_open3d = wait\nfrom smoother.cli import main\nsys.argv = ['x', sys.argv[1]]\n"
        "import smoother.cli.run as r\nsys.exit(r.run(['doctor']))"
    )
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        program = subprocess.Popen(
            [sys.executable, "-c", code, tmp_path / "out"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert program.stdout is not None and program.stdout.readline() == "begun\n"
        began = time.monotonic()
        program.send_signal(number)
        _, said = program.communicate(timeout=120)
        assert program.returncode == 1 and time.monotonic() - began < 120
        assert said.count("\n") == 1 and said.startswith("unocclude: "), said
        assert os.listdir(tmp_path) == []


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
    for column in (lambda: large_array(LARGE), lambda: GatheredRows((3,)).append(np.zeros(LARGE))):
        with pytest.raises(UnoccludeError, match=r"No temporary files can be made in .*missing"):
            column()
