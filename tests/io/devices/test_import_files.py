"""`unocclude import files` as a person uses it: files, folders, names, and the wrong ways."""

from __future__ import annotations

import json
import re
from pathlib import Path

import device_files as made
import numpy as np
import pytest
from commands import done

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import open_recording
from smoother.io.files import ImuFiles, import_files, sort_files
from smoother.io.registry import FileReader


@pytest.fixture
def files(tmp_path: Path) -> Path:
    made.EXAMPLES["azure-kinect"](tmp_path / "body.csv")
    made.xsens_dot(tmp_path / "dot.csv")
    made.apdm(tmp_path / "opal.csv")
    made.metamotion(tmp_path / "a.csv")
    made.metamotion(tmp_path / "g.csv", made.DEG, "deg/s")
    return tmp_path


def test_a_line_a_file_and_the_recording(files: Path, capsys: pytest.CaptureFixture[str]):
    out, figures = files / "rec.mcap", files / "rec.json"
    named = f"forearm_right={files / 'dot.csv'}"
    done("import", "files", "--skeleton", files / "body.csv", "--imu", named, "-o", out, "--json", figures)
    printed = capsys.readouterr().out
    assert "dot.csv: Xsens DOT export, 100.0 Hz, 80 samples, m/s^2, deg/s" in printed
    assert "body.csv: Azure Kinect" in printed and "12 frames, 1 body, mm" in printed
    assert "is unrelated to" in printed  # 4 s against 0.2 s
    file = open_recording(out)
    assert [imu.topic for imu in file.imus] == ["/imu/forearm_right"] and str(file.camera_frame) == "optical"
    assert np.allclose(file.imus[0].gyro, made.GYRO, atol=1e-6) and file.imus[0].stamp_ns[0] == 0
    reports = json.loads(figures.read_text())["files"]
    assert [report["format"] for report in reports] == ["azure-kinect", "xsens-dot"]
    assert reports[1]["topics"] == ["/imu/forearm_right"] and reports[1]["count"] == 80
    assert file.clocks_unrelated
    imu = ImuFiles((files / "dot.csv",), "forearm_right")
    stated, _ = import_files([files / "body.csv"], [imu], imu_starts_at_s=0.1)
    assert not stated.clocks_unrelated  # the user said how they relate


def test_two_files_of_one_sensor_and_one_of_several(files: Path):
    out, pair = files / "rec.mcap", f"wrist_left={files / 'a.csv'},{files / 'g.csv'}"
    done("import", "files", "--imu", pair, "--imu", f"base={files / 'opal.csv'}#Sternum", "-o", out)
    base, wrist = open_recording(out).imus
    assert [base.topic, wrist.topic] == ["/imu/base", "/imu/wrist_left"]
    assert np.allclose(wrist.acc, made.ACC, atol=1e-4)


def test_a_folder(files: Path, capsys: pytest.CaptureFixture[str]):
    (files / "notes.md").write_text("# Session of Monday\nleft arm\n")
    made.bare_kinect(files / "empty.csv")
    (files / "empty.csv").write_text("")
    out = files / "rec.mcap"
    done("import", "files", files, "-o", out)
    printed = capsys.readouterr().out
    assert "notes.md has an unknown format and was skipped" in printed
    # a.csv and g.csv are the two files of one sensor
    assert {i.topic for i in open_recording(out).imus} == {
        *("/imu/Right_Wrist", "/imu/Sternum", "/imu/dot", "/imu/g")
    }
    assert run(["import", "files", str(files), "-o", str(out)]) == 1  # it is there already


def test_file_names_decide_nothing(tmp_path: Path):
    made.xsens_dot(tmp_path / "azure_left_hand.trc")
    file, reports = import_files([], [ImuFiles((tmp_path / "azure_left_hand.trc",))])
    assert reports[0].format == "xsens-dot" and file.imus[0].topic == "/imu/sensor"


@pytest.mark.parametrize(
    "arguments, said",
    [
        ("--imu {0}/nothing.csv", "does not exist"),
        ("--imu {0}", "is a folder"),
        ("--imu {0}/body.csv", "name it with --skeleton"),
        ("--skeleton {0}/dot.csv", "name it with --imu"),
        ("--imu forearm={0}/opal.csv", r"2 sensors \(Right Wrist, Sternum\).*opal.csv#Right Wrist"),
        ("--imu x={0}/opal.csv#Pelvis", "has no sensor Pelvis; it has Right Wrist, Sternum"),
        ("--imu {0}/a.csv", "has no gyroscope"),
        ("--imu {0}/dot.csv --imu-format dot", "dot is not a format; formats are xdf"),
        ("--imu {0}/dot.csv --imu-format shimmer", "is not of Shimmer"),
        ("--imu ={0}/dot.csv", "give NAME=FILE"),
        ("", "nothing to import"),
        ("--imu {0}/dot.csv --truth {0}/truth.csv", "do not overlap"),
    ],
)
def test_wrong_ways(files: Path, arguments: str, said: str, capsys: pytest.CaptureFixture[str]):
    (files / "truth.csv").write_text("t_s,x,y,z\n90,0,0,0\n91,0,0,0\n")
    out = files / "out.mcap"
    assert run(["import", "files", *(a.format(files) for a in arguments.split()), "-o", str(out)]) == 1
    assert re.search(said, " ".join(capsys.readouterr().err.split())) and not out.exists()


def test_an_unknown_file_is_shown_shortly(tmp_path: Path):
    path = tmp_path / "x.bin"
    for content in (b"\x1b[31m" + bytes(range(256)) * 400, b"hello " * 90_000, "pulse;Ä\n".encode() * 9):
        path.write_bytes(content)
        with pytest.raises(RecordingError) as error:
            import_files([], [ImuFiles((path,))])
        text = str(error.value)
        assert "import describe" in text and "Known are" in text and text.isprintable()
        assert len(text.split("it begins with: ")[1].split(" Known are")[0]) <= 202


def test_imu_starts_at(files: Path):
    file, _ = import_files([files / "body.csv"], [ImuFiles((files / "dot.csv",))], imu_starts_at_s=-3.0)
    assert file.imus[0].stamp_ns[0] == file.arms[0].stamp_ns[0] - 3_000_000_000
    assert "3 s before the camera's first frame" in " ".join(file.notes)


def test_truth(files: Path, capsys: pytest.CaptureFixture[str]):
    (files / "truth.csv").write_text("t_s,x,y,z\n4.1,0,0,1\n4.2,0,0,2\n")
    made.trc(files / "mocap.trc")
    for number, name in enumerate(("truth.csv", "mocap.trc")):
        out = files / f"{number}.mcap"
        done("import", "files", "--imu", files / "dot.csv", "--truth", files / name, "-o", out)
    printed = capsys.readouterr().out
    assert "poses of the truth, 2 rows" in printed and "unocclude validate RESULT.mcap --truth" in printed
    assert len(open_recording(files / "0.mcap").poses) == 1


@pytest.mark.slow
@pytest.mark.real
def test_every_real_file_that_holds_raw_data(datasets: Path):
    """No option but file names; what cannot be used is refused with what to record."""
    refused = {"xsens_dot_fusion_only.csv": "Custom mode 5", "keraal_blazepose.json": "pose_world_landmarks"}
    for path in sorted((datasets / "devices").iterdir()):
        if path.name == "README.md":
            continue
        if path.name in refused:
            with pytest.raises(RecordingError, match=refused[path.name]):
                sort_files([path], FileReader())
            continue
        skeletons, imus, _ = sort_files([path], FileReader())
        file, reports = import_files(skeletons, imus)
        assert file.imus or (file.arms and reports[0].rate_hz > 10)
        for imu in file.imus:
            assert 0.8 < np.median(np.linalg.norm(imu.acc, axis=1)) / 9.81 < 1.2
            assert np.median(np.linalg.norm(imu.gyro, axis=1)) < 8.0  # rad/s
        for arm in file.arms:
            assert 0.15 < np.nanmedian(np.linalg.norm(arm.position[:, 1] - arm.position[:, 2], axis=1)) < 0.4
