"""Files that the cases read and no command writes: exports of devices, plain files, damaged files."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tools.faults.__main__ import key_of
from tools.faults.cases import Case, Workshop, all_cases, plain_folder
from tools.reference.renderings import PROJECT
from tools.reference.running import Step

#: Writes a file.
Write = Callable[[Path], None]
#: Damaged files are run in this many groups, about this many cases in all, drawn by the case's name.
PARTS, DAMAGED = 2, 64


#: How an IMU's file is named where `forearm_right=file` does not do.
_NAMED = {"apdm": "'forearm_right=file#Right Wrist'", "metamotion": "forearm_right=file,turning"}


def sessions_folder(folder: Path) -> None:
    """The folder of a study's recordings, of one person."""
    (folder / "sessions" / "p1").mkdir(parents=True)


def devices(folder: Path) -> Iterator[Step]:
    """Every example of a device: described, imported with a partner of the other kind, and listed."""
    import device_files
    import library_files

    written: dict[str, Write] = {
        "rosbag1": library_files.write_bag,
        "apdm-hdf5": library_files.write_opal,
    }
    for key, write in {**device_files.EXAMPLES, **written}.items():
        place = folder / key
        place.mkdir()
        partner = "--imu forearm_right=partner" if key in device_files.SKELETONS else "--skeleton partner"
        other = device_files.IMUS["shimmer"] if key in device_files.SKELETONS else _skeleton
        what = (
            "--skeleton file"
            if key in device_files.SKELETONS
            else f"--imu {_NAMED.get(key, 'forearm_right=file')}"
        )
        if key in device_files.RECORDINGS or key in written:
            what, partner = "file", "--skeleton partner" if key != "rosbag1" else ""

        def prepare(key: str = key, place: Path = place, write: Write = write, other: Write = other) -> None:
            write(place / "file")
            other(place / "partner")
            if key == "metamotion":  # it writes the gyroscope to a file of its own
                device_files.metamotion(place / "turning", device_files.DEG, "deg/s")

        for number, line in enumerate(
            (f"import files {what} {partner} -o new.mcap --json new.json", "info new.mcap --json info.json")
        ):
            words = tuple(shlex.split(line))
            yield Step(words, place, f"{key}: {line}", None if number else prepare)
        if key in device_files.IMUS:
            line = "import describe file --json described.json"
            yield Step(tuple(shlex.split(line)), place, f"{key}: {line}")


def _skeleton(path: Path) -> None:
    import device_files

    device_files.SKELETONS["kinect-v2"](path)


def plain_files(folder: Path) -> None:
    """The demo as plain files, and two small Matlab files as UTD-MHAD has them."""
    from scipy.io import savemat

    (folder / "session").mkdir()
    for name, text in plain_folder(PROJECT / "data" / "demo.mcap").items():
        (folder / "session" / name).write_text(text, encoding="utf-8")
    rng = np.random.default_rng(0)
    savemat(folder / "inertial.mat", {"d_iner": rng.normal(size=(150, 6))})
    savemat(folder / "skeleton.mat", {"d_skel": rng.normal(size=(20, 3, 90))})


def damaged(folder: Path, part: int) -> Iterator[Step]:
    """Some of the cases of `tools.faults`: the same ones however many there are."""
    (folder / "sound").mkdir()
    shop = Workshop(folder / "sound", seed=1)
    for case in chosen(all_cases(shop)):
        key = key_of(case)
        if _number(f"part of {key}") % PARTS != part:
            continue
        place = folder / f"{_number(key):x}"
        place.mkdir()
        words = (*case.arguments(Path()), "--json", "figures.json", "--force")
        yield Step(words, place, key, partial(case.make, shop, place))


def chosen(cases: list[Case]) -> list[Case]:
    """About `DAMAGED` of them, each family among them; a case stays chosen when others are added.

    Parameters
    ----------
    cases : list of Case
        All; those that take long or run by themselves are left out.
    """
    short = [case for case in cases if case.runs is None and not case.cpu_s]
    by_family: dict[str, list[Case]] = {}
    for case in short:
        by_family.setdefault(case.family, []).append(case)
    found = []
    for family in by_family.values():
        family.sort(key=lambda case: _number(key_of(case)))
        found += family[: max(2, round(DAMAGED * len(family) / len(short)))]
    return found


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
