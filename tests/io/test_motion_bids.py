"""Motion-BIDS: its rules, and the official validator where it is installed."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from arms import make_recording
from commands import done
from results import made

from smoother.errors import UnoccludeError
from smoother.io import read_recovery, write_recording, write_recovery
from smoother.io.export.bids import BidsNames, recorded_systems, write_bids
from smoother.recording import JOINTS
from smoother.simulation import ArmSimulation, simulate_arm

VALIDATOR = shutil.which("bids-validator-deno")
#: Of a motion file's name, in this order.
NAME = re.compile(
    r"sub-[A-Za-z0-9]+(_ses-[A-Za-z0-9]+)?_task-[A-Za-z0-9]+_tracksys-[A-Za-z0-9]+_(motion|channels)\.(tsv|json)"
)
COMPONENTS = {"x", "y", "z", "quat_x", "quat_y", "quat_z", "quat_w", "n/a"}
TYPES = {"ACCEL", "ANGACCEL", "GYRO", "JNTANG", "LATENCY", "MAGN", "MISC", "ORNT", "POS", "VEL"}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    write_recording(make_recording(noise_m=0.004), folder / "rec.mcap")
    write_recovery(made(), folder / "out.mcap", source=folder / "rec.mcap")
    return folder / "out.mcap"


@pytest.fixture(scope="module")
def dataset(result: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bids") / "dataset"
    for subject, session in (("p1", "1"), ("p1", "2"), ("p2", "1")):
        done(
            *("export", result, "--format", "bids", "-o", folder, "--subject", subject),
            *("--recording", result.with_name("rec.mcap")),
            *("--session", session, "--task", "reach"),
        )
    return folder


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def test_the_rules_of_motion_bids(dataset: Path):
    for root in (dataset, dataset / "derivatives" / "unocclude"):
        about = json.loads((root / "dataset_description.json").read_text())
        assert {"Name", "BIDSVersion", "DatasetType"} <= set(about)
        assert [row["participant_id"] for row in table(root / "participants.tsv")] == ["sub-p1", "sub-p2"]
        files = [path for path in root.glob("sub-*/ses-*/motion/*") if path.is_file()]
        assert files and all(NAME.fullmatch(path.name) for path in files)
        motions = [path for path in files if path.name.endswith("_motion.tsv")]
        assert len(motions) == (6 if root == dataset else 3)
        for motion in motions:
            channels = table(Path(str(motion).replace("_motion.tsv", "_channels.tsv")))
            assert list(channels[0])[:5] == ["name", "component", "type", "tracked_point", "units"]
            assert {row["component"] for row in channels} <= COMPONENTS
            assert {row["type"] for row in channels} <= TYPES
            assert len({row["name"] for row in channels}) == len(channels)
            lines = motion.read_text().splitlines()
            assert all(line.count("\t") == len(channels) - 1 for line in lines)  # and no header
            assert all(cell == "n/a" or np.isfinite(float(cell)) for cell in lines[0].split("\t"))
            sidecar = json.loads(motion.with_suffix(".json").read_text())
            assert {"TaskName", "SamplingFrequency", "TrackingSystemName"} <= set(sidecar)
            assert sidecar["MotionChannelCount"] == len(channels) and sidecar["TaskName"] == "reach"
            for kind in TYPES & {key.removesuffix("ChannelCount") for key in sidecar}:
                count = sum(row["type"] == kind for row in channels)
                assert sidecar[f"{kind}ChannelCount"] == count
    for scans in dataset.glob("sub-*/ses-*/*_scans.tsv"):
        rows = table(scans)
        assert len(rows) == 2 and all((scans.parent / row["filename"]).exists() for row in rows)
        assert all(row["acq_time"].startswith("1900-01-01T") for row in rows)


@pytest.mark.skipif(VALIDATOR is None, reason="bids-validator-deno is not installed (a tool)")
def test_the_official_validator_finds_no_error(dataset: Path):
    for root in (dataset, dataset / "derivatives" / "unocclude"):
        command = [str(VALIDATOR), "--format", "json", str(root)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        issues = json.loads(done.stdout)["issues"]["issues"]
        assert [issue for issue in issues if issue["severity"] == "error"] == []


def test_the_answer_has_every_column_of_the_csv(result: Path, dataset: Path, tmp_path: Path):
    done("export", result, "--format", "csv", "-o", tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    motion = next((dataset / "derivatives" / "unocclude").glob("sub-p1/ses-1/motion/*_motion.tsv"))
    channels = table(Path(str(motion).replace("_motion.tsv", "_channels.tsv")))
    names = [channel["name"] for channel in channels]
    assert set(rows[0]) - {"t_s", "trusted"} <= set(names)
    values = np.genfromtxt(motion, delimiter="\t", missing_values="n/a")
    for name in ("wrist_x", "imu_qw", "elbow_flexion_deg", "sigma_y", "occluded", "usable"):
        ours = np.array([float(row[name]) if row[name] else np.nan for row in rows])
        np.testing.assert_allclose(values[:, names.index(name)], ours, atol=1e-8)
    kinds = {channel["name"]: (channel["type"], channel["component"]) for channel in channels}
    assert kinds["wrist_x"] == ("POS", "x") and kinds["imu_qw"] == ("ORNT", "quat_w")
    assert kinds["elbow_flexion_deg"] == ("JNTANG", "n/a") and kinds["sigma_y"] == ("MISC", "y")
    assert kinds["vx"] == ("VEL", "x")


def test_what_is_refused(dataset: Path, result: Path, tmp_path: Path):
    with pytest.raises(UnoccludeError, match="letters and digits alone, not 'p 1'"):
        BidsNames("p 1")
    recoveries = list(read_recovery(result))
    names = BidsNames("p1", "1", "reach")
    with pytest.raises(UnoccludeError, match="exists already"):
        write_bids(dataset, names, [make_recording()], recoveries, "1")
    (tmp_path / "letter.txt").write_text("mine")
    with pytest.raises(UnoccludeError, match="contains other files"):
        write_bids(tmp_path, names, [], recoveries, "1")
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


def test_a_camera_without_depth_has_image_coordinates_and_no_metres() -> None:
    settings = {"protocol": "random", "duration_s": 8.0, "rgb": "all"}
    recording = simulate_arm(ArmSimulation.preset("realistic", **settings), 1).recording
    (camera,) = [each for each in recorded_systems(recording) if each.label.startswith("camera")]
    assert camera.title == "camera without depth"
    assert not [each.name for each in camera.channels if each.units == "m" or each.row[2] == "POS"]
    (column,) = [each for each in camera.channels if each.name == "right_wrist_x_image"]
    seen = recording.arm.state[:, JOINTS.index("wrist")] > 0
    np.testing.assert_array_equal(column.values[seen], recording.arm.joint("wrist")[seen, 0])
