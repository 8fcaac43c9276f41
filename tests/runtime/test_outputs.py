"""Outputs appear whole or not at all: over devices, pipes and links, modes, killed programs."""

from __future__ import annotations

import errno
import importlib
import os
import pkgutil
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from made_recordings import make

from smoother.cli.output import check_outputs
from smoother.errors import UnoccludeError
from smoother.io import write_recording
from smoother.runtime import outputs as outputs_module
from smoother.runtime.outputs import check_output, umask, writing


def test_an_output_appears_whole(tmp_path: Path) -> None:
    with writing(tmp_path / "out") as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path
        assert not (tmp_path / "out").exists()
    assert (tmp_path / "out").read_text() == "new"
    assert os.listdir(tmp_path) == ["out"]


def test_an_older_output_needs_force(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("old")
    with pytest.raises(UnoccludeError, match="force=True"), writing(tmp_path / "out"):
        raise AssertionError("not reached")
    with writing(tmp_path / "out", force=True) as temporary:
        temporary.write_text("new")
    assert (tmp_path / "out").read_text() == "new"


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt()])
def test_a_failure_leaves_the_older_output(tmp_path: Path, error: BaseException) -> None:
    (tmp_path / "out").write_text("old")
    with pytest.raises(type(error)), writing(tmp_path / "out", force=True) as temporary:
        temporary.write_text("half")
        raise error
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out").read_text() == "old"


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


def test_places_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(UnoccludeError, match="is a folder"), writing(tmp_path):
        pass
    with pytest.raises(UnoccludeError, match="does not exist"), writing(tmp_path / "no" / "out"):
        pass


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_of_somebody_else(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(UnoccludeError, match="folder of your own"), writing(tmp_path / "out") as temporary:
        temporary.write_text("x")
    tmp_path.chmod(0o700)


@pytest.mark.skipif(os.name != "posix", reason="links")
def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    with writing(tmp_path / "link", force=True) as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


@pytest.mark.parametrize("package", ["smoother", "smoother.io"])
def test_no_lazy_name_is_a_module(package: str) -> None:
    """Python binds a submodule over a name that is looked up late, so the two must differ."""
    module = importlib.import_module(package)
    modules = {found.name for found in pkgutil.iter_modules(module.__path__)}
    assert not modules & set(module.__all__)


posix = pytest.mark.skipif(os.name != "posix", reason="devices, modes and links of POSIX")
root = pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="makes a device")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@root
def test_a_device_is_never_replaced(tmp_path: Path):
    """As root, `-o /dev/null --force` made a file of the device: everybody's null device was gone."""
    null = tmp_path / "null"
    about = os.stat(os.devnull)
    os.mknod(null, stat.S_IFCHR | 0o666, about.st_rdev)
    full = tmp_path / "full"
    os.mknod(full, stat.S_IFCHR | 0o666, os.stat("/dev/full").st_rdev)
    for device in (null, full):
        with suppress(UnoccludeError), writing(device, force=True) as temporary:
            temporary.write_text("x")
        assert stat.S_ISCHR(os.lstat(device).st_mode)
    with pytest.raises(UnoccludeError, match="is a device"):
        check_output(full, force=True)
    assert sorted(os.listdir(tmp_path)) == ["full", "null"]


@posix
def test_the_null_device_takes_everything():
    with writing("/dev/null") as temporary:
        temporary.write_text("x" * 100_000)
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    assert not temporary.exists()


@posix
def test_a_pipe_is_written_to(tmp_path: Path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    received: list[bytes] = []
    reader = threading.Thread(target=lambda: received.append(pipe.read_bytes()), daemon=True)
    reader.start()
    with writing(pipe) as temporary:
        temporary.write_bytes(b"y" * 300_000)
    reader.join(10)
    assert received == [b"y" * 300_000]
    assert stat.S_ISFIFO(os.lstat(pipe).st_mode)


@posix
def test_a_pipe_that_nobody_reads_does_not_hang(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("smoother.runtime.outputs.READER_S", 0.2)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UnoccludeError, match="without a reader"), writing(tmp_path / "pipe") as temporary:
        temporary.write_text("x")


@posix
def test_a_reader_that_goes_away(tmp_path: Path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)

    def read_a_little() -> None:
        with open(pipe, "rb") as stream:
            stream.read(1)

    reader = threading.Thread(target=read_a_little, daemon=True)
    reader.start()
    with pytest.raises(UnoccludeError, match="reader went away"), writing(pipe) as temporary:
        temporary.write_bytes(b"y" * 3_000_000)
    reader.join(10)


@posix
def test_standard_output_gets_the_output(tmp_path: Path):
    code = (
        "from smoother.runtime.outputs import writing\nprint('before')\n"
        "with writing('/dev/stdout') as t: t.write_text('the output\\n')\nprint('after')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.split("\n")[:3] == ["before", "the output", "after"], done.stderr
    with open(tmp_path / "file", "w") as file:
        subprocess.run([sys.executable, "-c", code], stdout=file, check=True, timeout=60)
    assert (tmp_path / "file").read_text().split("\n")[:3] == ["before", "the output", "after"]


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
def test_a_calibration_keeps_its_mode_and_follows_no_link(tmp_path: Path):
    """Its temporary file is made anew under a name that cannot be foreseen."""
    from calib.file import CalibrationFile, write_calibration

    target, victim = tmp_path / "arm.toml", tmp_path / "victim"
    victim.write_text("mine")
    write_calibration(target, CalibrationFile({}, {"a": {"b": 1}}))
    target.chmod(0o600)
    write_calibration(target, CalibrationFile({}, {"a": {"b": 2}}))
    assert mode(target) == 0o600 and victim.read_text() == "mine"
    names = {outputs_module.temporary_name(target).name for _ in range(100)}
    assert len(names) == 100 and all(len(name) < 200 for name in names)
    taken = outputs_module.temporary_name(target)
    taken.symlink_to(victim)
    with pytest.raises(FileExistsError), outputs_module.locked(taken):
        pass
    assert victim.read_text() == "mine"


@posix
def test_a_very_long_name(tmp_path: Path):
    with writing(tmp_path / ("ö" * 120)) as temporary:
        temporary.write_text("x")
    assert os.listdir(tmp_path) == ["ö" * 120]


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


@posix
def test_inputs_are_files(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(UnoccludeError, match="is a pipe, a socket or a device"):
            check_outputs(False, [], [path])


@posix
def test_what_a_killed_program_left_is_swept(tmp_path: Path):
    """`kill -9` in the middle of an output; one that still runs keeps its own."""
    code = (
        "import sys, time\nfrom smoother.runtime.outputs import writing\n"
        "with writing(sys.argv[1]) as t: t.write_text('half'); print('begun', flush=True); time.sleep(300)"
    )
    programs = [
        subprocess.Popen([sys.executable, "-c", code, tmp_path / name], stdout=subprocess.PIPE)
        for name in ("a", "b")
    ]
    try:
        for program in programs:
            assert program.stdout is not None and program.stdout.readline() == b"begun\n"
        assert len(os.listdir(tmp_path)) == 2
        programs[0].kill()
        programs[0].wait()
        (tmp_path / ".mine.tmp").touch()
        outputs_module.remove_stale_tempfiles(tmp_path, again=True)
        hidden = sorted(name.split(".")[1] for name in os.listdir(tmp_path))
        assert hidden == ["b", "mine"], "that of the living, and what is not ours"
    finally:
        for program in programs:
            program.kill()
            program.wait()
    outputs_module._swept.discard(tmp_path)
    with writing(tmp_path / "b") as temporary:
        temporary.write_text("whole")
    assert sorted(os.listdir(tmp_path)) == [".mine.tmp", "b"]


@posix
def test_a_folder_that_was_being_written_is_swept(tmp_path: Path):
    left = outputs_module.temporary_name(tmp_path / "session")
    left.mkdir()
    (left / "x").touch()
    working = outputs_module.temporary_name(tmp_path / "session")
    with outputs_module.locked(working, folder=True):
        assert mode(working) == 0o700
        outputs_module.remove_stale_tempfiles(tmp_path, again=True)
        assert working.exists() and not left.exists()


def test_full_disks_are_one_sentence(tmp_path: Path):
    for error in (errno.ENOSPC, errno.EDQUOT):
        with (
            pytest.raises(UnoccludeError, match=r"out could not be written: no space left on the disk"),
            writing(tmp_path / "out") as temporary,
        ):
            temporary.write_text("half")
            raise OSError(error, os.strerror(error))
    assert os.listdir(tmp_path) == []


@root
@pytest.mark.skipif(shutil.which("mount") is None, reason="mounts a small disk")
@pytest.mark.parametrize("options", ["size=64k", "ro"])
def test_a_disk_that_is_full_or_read_only(tmp_path: Path, options: str):
    """A real one, where this machine lets one be mounted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", disk], capture_output=True, timeout=20
    )
    if mounted.returncode:
        pytest.skip("no disk can be mounted here")
    try:
        with pytest.raises(UnoccludeError, match=r"no space left|Read-only"), writing(disk / "o") as t:
            t.write_bytes(b"x" * 1_000_000)
        assert os.listdir(disk) == []
    finally:
        subprocess.run(["umount", disk], check=True, timeout=20)


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


def test_many_threads_on_one_new_name(tmp_path: Path) -> None:
    """Whoever is first, exactly one is told that it was."""
    ready, told = threading.Barrier(8), []

    def write(number: int) -> None:
        try:
            with writing(tmp_path / "out") as temporary:
                temporary.write_text(str(number))
                ready.wait(20)
            told.append(number)
        except UnoccludeError:
            pass

    threads = [threading.Thread(target=write, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert [(tmp_path / "out").read_text()] == [str(number) for number in told]


@posix
def test_sigterm_removes_what_is_half_written(tmp_path: Path):
    """The command's handler lets outputs be removed at once, not only by the next command."""
    code = (
        "import signal, sys, time\n"
        # who runs the tests may ignore them, as nohup does, which a program then keeps to
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGTERM, signal.SIG_DFL)\nsignal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        "import smoother.cli.demo as d\nfrom smoother.runtime.outputs import writing\n"
        "def wait(*_):\n"
        "  with writing(sys.argv[1]) as t:\n"
        "    t.write_text('half'); print('begun', flush=True)\n"
        # in short sleeps: a signal that comes just before one is noticed after it
        "    for _ in range(2400): time.sleep(0.1)\n"
        "d.memory = wait\nfrom smoother.cli import main\nsys.argv = ['x', sys.argv[1]]\n"
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
