"""Files that the cases read and no command writes: exports of devices and plain files."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from smoother.recording import JOINTS, JointState
from tools.reference.renderings import PROJECT
from tools.reference.running import Step

#: Writes a file.
Write = Callable[[Path], None]

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


def plain_folder(path: Path) -> dict[str, str]:
    """A recording as plain files."""
    from smoother.io import read_recording

    recording = read_recording(path)
    imu = ["t_s,ax,ay,az,gx,gy,gz"]
    for t, *values in np.column_stack([recording.imu.t_s, recording.imu.acc, recording.imu.gyro]).tolist():
        imu.append(",".join([f"{t:.6f}", *(f"{value:.6f}" for value in values)]))
    rows = ["t_s,joint,x,y,z,state"]
    for frame, t in enumerate(recording.arm.t_s.tolist()):
        for column, joint in enumerate(JOINTS):
            state = JointState(int(recording.arm.state[frame, column])).name.lower()
            place = ["", "", ""]
            if state != "not_tracked":
                place = [f"{value:.5f}" for value in recording.arm.position[frame, column].tolist()]
            rows.append(",".join([f"{t:.6f}", f"{joint}_right", *place, state]))
    about = '[camera]\nframe = "kinect"\nskeleton = "skeleton.csv"\n[imu.forearm_right]\nfile = "imu.csv"\n'
    return {"imu.csv": "\n".join(imu) + "\n", "skeleton.csv": "\n".join(rows) + "\n", "recording.toml": about}


def plain_files(folder: Path) -> None:
    """The demo as plain files, and two small Matlab files as UTD-MHAD has them."""
    from scipy.io import savemat

    (folder / "session").mkdir()
    for name, text in plain_folder(PROJECT / "data" / "demo.mcap").items():
        (folder / "session" / name).write_text(text, encoding="utf-8")
    rng = np.random.default_rng(0)
    savemat(folder / "inertial.mat", {"d_iner": rng.normal(size=(150, 6))})
    savemat(folder / "skeleton.mat", {"d_skel": rng.normal(size=(20, 3, 90))})
