"""Skeleton files as devices wrote them, against an independent reading."""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from smoother.errors import RecordingError
from smoother.io.devices.registry import recognise
from smoother.io.tables.joint_columns import AZURE, KINECT_V2
from smoother.io.tables.protocol import SkeletonTable, read_head
from smoother.recording import CameraFrame

DATASETS = os.environ.get("UNOCCLUDE_DATASETS")
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(DATASETS is None, reason="UNOCCLUDE_DATASETS is not set"),
]


def device(name: str) -> Path:
    path = Path(DATASETS or "") / "devices" / name
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    return path


def read(path: Path, key: str) -> SkeletonTable:
    importer = recognise(read_head(path))
    assert importer is not None
    assert importer.key == key
    (table,) = importer.read(path)
    assert isinstance(table, SkeletonTable)
    return table


def azure_rows() -> tuple[list[str], np.ndarray]:
    with open(device("azure_kinect_mkv_walking.csv"), newline="") as file:
        header, *rows = csv.reader(file, delimiter=";")
    return header, np.array(rows, dtype=float)


def test_azure_kinect() -> None:
    table = read(device("azure_kinect_mkv_walking.csv"), "azure-kinect")
    header, rows = azure_rows()
    assert (table.frame, table.units) == (CameraFrame.OPTICAL, "mm")
    assert_array_equal(table.t_s, rows[:, 0] * 1e-6)
    for joint, position in table.position.items():
        columns = [header.index(f"{joint.upper()} ({axis})") for axis in "xyz"]
        assert_array_equal(position, rows[:, columns] * 0.001)
        confidence = rows[:, header.index(f"{joint.upper()} (c)")]
        wanted = np.full(len(rows), 1) if joint.startswith("hand") else confidence
        assert_array_equal(table.state[joint], wanted)


def test_azure_kinect_without_header(tmp_path: Path) -> None:
    header, _ = azure_rows()
    with open(device("azure_kinect_mkv_walking.csv"), newline="") as file:
        cells = list(csv.reader(file, delimiter=";"))[1:]
    keep = [at for at, name in enumerate(header) if name.endswith(("(x)", "(y)", "(z)"))]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(",".join(row[at] for at in keep) for row in cells))
    table = read(path, "kinect-numbers")
    at = 3 * AZURE.index("ELBOW_LEFT")
    wanted = np.array([[float(row[keep[at + k]]) for k in range(3)] for row in cells])
    assert_array_equal(table.position["elbow_left"], wanted * 0.001)


def test_kinect_v2_without_header() -> None:
    path = device("keraal_kinect_v2.txt")
    table = read(path, "kinect-numbers")
    rows = np.loadtxt(path).reshape(-1, 25, 7)
    assert (table.frame, table.units, table.rate_hz, table.t_s) == (CameraFrame.KINECT, "m", 30.0, None)
    for joint, position in table.position.items():
        name, _, side = joint.partition("_")
        at = KINECT_V2.index(f"{name.capitalize()}{side.capitalize()}")
        assert_array_equal(position, rows[:, at, :3])


def test_landmarks_in_the_image_are_refused() -> None:
    path = device("keraal_blazepose.json")
    importer = recognise(read_head(path))
    assert importer is not None
    with pytest.raises(RecordingError, match=r"keraal_blazepose\.json.*export pose_world_landmarks"):
        importer.read(path)


@pytest.mark.parametrize(
    ("name", "metres", "markers"),
    [
        ("pose2sim_markers.trc", 1.0, {"wrist_left": ["LWrist"], "shoulder_right": ["RShoulder"]}),
        (
            "opencap_markers.trc",
            0.001,
            {"elbow_right": ["R_elbow_med", "R_elbow_lat"], "wrist_left": ["L_wrist_radius", "L_wrist_ulna"]},
        ),
    ],
)
def test_markers(name: str, metres: float, markers: dict[str, list[str]]) -> None:
    path = device(name)
    table = read(path, "trc")
    lines = path.read_text().splitlines()
    names = [cell for cell in lines[3].split("\t")[2:] if cell]
    rows = np.array([[float(c) for c in line.split("\t") if c] for line in lines[5:] if line.strip()])
    for joint, taken in markers.items():
        wanted = np.mean([rows[:, 2 + 3 * names.index(one) :][:, :3] for one in taken], axis=0)
        np.testing.assert_allclose(table.position[joint], wanted * metres, rtol=0, atol=1e-12)
    assert_array_equal(table.gravity_hint, [0, -1, 0])


def test_fifty_thousand_rows_take_seconds(tmp_path: Path) -> None:
    header, *rows = device("azure_kinect_mkv_walking.csv").read_text().splitlines()
    path = tmp_path / "long.csv"
    path.write_text("\n".join([header, *rows * 73]))
    importer = recognise(read_head(path))
    assert importer is not None
    start = time.process_time()
    (table,) = importer.read(path)
    # 60 MB: 1.4 s of one processor; five times as much on a machine that is busy
    assert time.process_time() - start < 7.0
    assert isinstance(table, SkeletonTable)
    assert table.t_s is not None
    assert len(table.t_s) == 73 * len(rows)
