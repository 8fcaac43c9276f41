"""`unocclude import strap` on a simulated arm with rendered images."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from mcap.reader import make_reader

from smoother.io import read_recording
from smoother.recording import JointState
from smoother.simulation import ArmSimulation, simulate_arm


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory):
    """A recording with images and what the command made of it; the arm, and where its strap is."""
    folder = tmp_path_factory.mktemp("strap")
    made = ("--set", "duration_s=10", "--seed", 6, "-o", folder / "rec.mcap")
    done("simulate", "strap", *made)
    truth = tomllib.loads((folder / "rec_truth.toml").read_text())["strap"]
    done(
        *("import", "strap", folder / "rec.mcap", "-o", folder / "out.mcap", "--processes", 1),
        *("--radius-m", truth["radius_m"], "--json", folder / "s.json"),
    )
    return folder, simulate_arm(ArmSimulation(protocol="random", duration_s=10.0), 6), truth


@pytest.mark.slow
def test_the_strap_is_where_the_sensor_is(session):
    folder, simulated, _ = session
    arm, truth = read_recording(folder / "out.mcap").arm, simulated.recording.truth
    rows = arm.tracked("strap")
    assert rows.sum() > 30
    true = np.stack(
        [np.interp(arm.t_s[rows], truth.t_s, truth.position[:, axis]) for axis in range(3)], axis=1
    )
    error = np.linalg.norm(arm.joint("strap")[rows] - true, axis=1)
    # 5 mm of the core's place, and what the lever arms' direction (found from motion) does over 3.5 cm
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert np.quantile(error, 0.95) < 0.02
    # nothing is found while the camera does not see the forearm
    hidden = simulated.occluded[np.searchsorted(simulated.recording.arm.t_s, arm.t_s - 1e-6)]
    assert not (rows & hidden).any()


def test_sigma_goes_with_the_strap(session):
    from smoother.io.wire.schemas import message_class

    folder, *_ = session
    seen = 0
    with open(folder / "out.mcap", "rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/skeleton"]):
            skeleton = message_class("unocclude.Skeleton").FromString(message.data)
            for joint in skeleton.joints:
                if joint.name.startswith("strap") and joint.state == JointState.TRACKED:
                    covariance = np.reshape(list(joint.position_covariance), (3, 3))
                    assert 0.001 < np.sqrt(np.linalg.eigvalsh(covariance)[-1]) < 0.05
                    seen += 1
    assert seen > 30


@pytest.mark.slow
def test_other_joints_stay_and_images_stay_out(session):
    folder, *_ = session
    before, after = read_recording(folder / "rec.mcap"), read_recording(folder / "out.mcap")
    for joint in ("shoulder", "elbow", "wrist", "hand"):
        assert np.array_equal(before.arm.joint(joint), after.arm.joint(joint), equal_nan=True)
    assert np.array_equal(before.imu.acc, after.imu.acc)
    assert before.camera_frame == after.camera_frame
    with open(folder / "out.mcap", "rb") as stream:
        topics = {channel.topic for channel in make_reader(stream).get_summary().channels.values()}
    assert "/skeleton" in topics and not topics & {"/colour/image", "/depth/image"}


def test_what_is_said(session):
    folder, _, truth = session
    figures = json.loads((folder / "s.json").read_text())
    # the ends of the skeleton's forearm are known to a centimetre of 25
    assert figures["along"] == pytest.approx(truth["along"], abs=0.04)
    assert figures["images"] > 50 and figures["found"] == figures["reasons"]["found"]
    assert figures["reasons"]["elbow or wrist is not tracked"] > 0
    assert any("were left out" in note for note in figures["notes"])
    assert figures["colour_topic"] == "/colour/image" and figures["depth_topic"] == "/depth/image"


def test_a_depth_topic_that_is_not_there(session, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder, *_ = session
    output = ("--depth-topic", "nothing", "-o", tmp_path / "o.mcap", "--processes", 1)
    assert "has no depth images" in refused(capsys, "import", "strap", folder / "rec.mcap", *output)
    assert not (tmp_path / "o.mcap").exists()
