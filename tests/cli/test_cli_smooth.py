"""`smooth`, `demo`: what is said of arm, sensor, clock and camera, and what is not to be trusted."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_recording, make_truth
from commands import done
from results import made
from scenes import point

import smoother.runtime.store
from calib.file import corrected, read_calibration
from smoother.cli.run import NOT_TRUSTED, run
from smoother.io import read_recording, read_recovery, write_recording, write_recovery
from smoother.recording import Recording
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval
from smoother.simulation import ArmSimulation, simulate_arm


def smoothed(recording: Path, folder: Path, *more: object) -> dict:
    done(
        *("smooth", recording, "-o", folder / "out.mcap", "--json", folder / "out.json"),
        *("--force", "--processes", 1, "--draws", 0, "--verbose", *more),
    )
    return json.loads((folder / "out.json").read_text())


def written(recording: Recording, path: Path) -> Path:
    write_recording(recording, path)
    return path


@pytest.fixture(scope="module")
def frozen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose camera freezes in every occlusion and says `tracked`."""
    settings = ArmSimulation(repetitions=1, frozen_gaps=1.0, joint_bias_m=0.025)
    return written(simulate_arm(settings, 5).recording, tmp_path_factory.mktemp("frozen") / "rec.mcap")


def test_without_a_calibration(frozen, tmp_path, capsys):
    figures = smoothed(frozen, tmp_path)
    out = capsys.readouterr().out
    assert "Lever arms" in out and "imu to forearm axis" in out and "Clock offsets" in out
    assert "not determined: the camera places joints some " in out
    assert "Rejected camera samples" in out and "the value repeats" in out
    found = figures["found"]
    assert set(found["lever_arms"]) == {"elbow", "wrist", "hand"} and found["given"] == []
    assert found["lengths"]["forearm"]["sigma_m"] > 0 and found["clock_offsets"][0]["sigma_s"] < 0.01
    assert figures["not_determined"] == found["not_determined"] != []
    rows = [row for row in figures["rejected"] if row["reason"] == "frozen" and row["joint"] == "wrist"]
    assert rows[0]["count"] > 50 and 0.05 < rows[0]["share"] < 0.5


@pytest.mark.slow
def test_what_is_given_is_not_called_found(frozen, tmp_path, capsys):
    done("calibrate", "motion", frozen, "-o", tmp_path / "c.toml", "--processes", "1")
    capsys.readouterr()
    figures = smoothed(frozen, tmp_path, "--calibration", tmp_path / "c.toml")
    out = capsys.readouterr().out
    assert "Lever arms" not in out and "the accuracy of lever arms and lengths" not in out
    assert {"elbow", "wrist", "hand", "upper_arm"} <= set(figures["found"]["given"])
    # the file remembers, so that a report made of it later says the same
    (kept,) = read_recovery(tmp_path / "out.mcap")
    assert set(kept.estimates.given) == set(figures["found"]["given"])


def test_a_strap_that_is_the_imu(tmp_path, capsys):
    recording = written(point(1, duration_s=20.0).recording, tmp_path / "rec.mcap")
    figures = smoothed(recording, tmp_path)
    assert figures["found"]["lever_arms"] == {} and figures["not_determined"] == []
    assert "Lever arms" not in capsys.readouterr().out
    figures = smoothed(recording, tmp_path, "--solve-lever-arms")
    assert "The tracked strap was found " in capsys.readouterr().out
    lever = figures["found"]["lever_arms"]["strap"]
    place, sigma = np.array(lever["position_m"]), np.array(lever["sigma_m"])
    assert (np.abs(place) < 4 * sigma).all() and (sigma < 0.02).all()


@pytest.mark.slow
def test_a_strap_beside_the_imu(tmp_path):
    """The camera sees a point 3 cm beside the IMU."""
    from scipy.spatial.transform import Rotation

    simulated = point(2)
    recording, true = simulated.recording, np.array([0.02, -0.02, 0.01])
    truth, arm = recording.truth, recording.arm
    nearest = np.clip(np.searchsorted(truth.t_s, arm.t_s), 0, len(truth) - 1)
    moved = arm.position.copy()
    moved[:, 4] += Rotation.from_quat(truth.quaternion[nearest], scalar_first=True).apply(true)
    path = written(replace(recording, arm=replace(arm, position=moved)), tmp_path / "rec.mcap")
    without, figures = smoothed(path, tmp_path), smoothed(path, tmp_path, "--solve-lever-arms")
    lever = figures["found"]["lever_arms"]["strap"]
    error = np.array(lever["position_m"]) - true
    assert np.linalg.norm(error) < 0.006 and (np.abs(error) < 4 * np.array(lever["sigma_m"])).all()
    noise = [each["found"]["camera_sigma_m"]["strap"] for each in (without, figures)]
    assert noise[1] <= noise[0]
    (kept,) = read_recovery(tmp_path / "out.mcap")
    error = kept.position - np.stack([np.interp(kept.t_s, truth.t_s, axis) for axis in truth.position.T], 1)
    assert np.sqrt(np.nanmean(np.sum(error[~kept.occluded] ** 2, axis=1))) < 0.01


DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"


@pytest.mark.slow
def test_where_the_columns_lie_does_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, limit in (("memory", 1 << 40), ("files", 1)):
        monkeypatch.setattr(smoother.runtime.store, "_SMALL_BYTES", limit)
        done(
            *("smooth", DEMO, "-o", tmp_path / f"{name}.mcap", "--json", tmp_path / f"{name}.json"),
            *("--report", tmp_path / f"{name}.html", "--processes", 1),
        )
    for ending in ("mcap", "json", "html"):
        memory, files = ((tmp_path / f"{name}.{ending}").read_bytes() for name in ("memory", "files"))
        assert memory == files


@pytest.mark.parametrize("samples", [1000, 70])
def test_an_imu_is_corrected_part_by_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, samples: int
) -> None:
    recording = read_recording(DEMO)
    (tmp_path / "cal.toml").write_text(
        f'[imu."{recording.imu.name.removeprefix("/imu/")}".accelerometer]\n'
        "offset = [0.1, -0.2, 0.3]\nmatrix = [[1.01, 0.0, 0.0], [0.0, 0.99, 0.0], [0.0, 0.02, 1.0]]\n"
        f'[imu."{recording.imu.name.removeprefix("/imu/")}".gyroscope]\noffset = [0.01, 0.02, -0.03]\n'
    )
    calibration = read_calibration(tmp_path / "cal.toml")
    monkeypatch.setattr("calib.file._SAMPLES", 10**9)
    whole = corrected(recording, calibration)
    assert not np.array_equal(whole.imu.acc, recording.imu.acc)
    monkeypatch.setattr("calib.file._SAMPLES", samples)
    parts = corrected(recording, calibration)
    for name in ("t_s", "acc", "gyro"):
        np.testing.assert_allclose(getattr(parts.imu, name), getattr(whole.imu, name), rtol=1e-14)


BODY = UntrustedInterval(9.0, 12.0, ("another person's joints",))
CHECK = SelfCheck(8, 0, 1.7, 0.011, 0.010, 0.96, 1.4)
SOUND = Estimates(trusted=True, self_check=CHECK, pairing=Pairing(True, 1e-4, 120.0))
PARTLY = replace(SOUND, cautions=("one gap",), untrusted=(BODY,))
WRONG = Estimates(
    trusted=False,
    reasons=("the skeleton seems mirrored (x): run again with --mirror x", "gravity is 80 degrees off"),
    cause="the skeleton seems mirrored (x): run again with --mirror x",
    remedies=("--mirror x",),
    pairing=Pairing(False, 0.2, 12.0),
)


@pytest.fixture
def smooth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `smooth` on a made recording whose recoveries have these estimates: code, figures, words."""
    write_recording(replace(make_recording(), name="rec"), tmp_path / "rec.mcap")

    def smoothed(estimates: Estimates, *options: str) -> tuple[int, dict, str]:
        def recovered(recordings, *rest: object) -> list[Recovery]:
            return [
                replace(made(one.side), arm=one.arm, side=one.side, body=one.body, estimates=estimates)
                for one in recordings
            ]

        monkeypatch.setattr("smoother.cli.smooth.recover_arms", recovered)
        capsys.readouterr()
        files = ("rec.mcap", "-o", "out.mcap", "--json", "j.json")
        words = (each if each[0] == "-" else str(tmp_path / each) for each in files)
        code = run(["smooth", *words, "--force", *options])
        return code, json.loads((tmp_path / "j.json").read_text()), capsys.readouterr().out

    return smoothed


def test_the_verdict_comes_first_and_untrusted_gaps_are_named(smooth) -> None:
    code, figures, said = smooth(PARTLY, "--strict")
    assert code == 0
    lines = said.splitlines()
    at = lines.index("Usable with care: one gap.")
    assert lines[at + 1] == CHECK.sentence
    assert "not to be trusted: gap 2 (" in said and ": another person's joints" in said
    assert "trusted" in said
    assert [gap["trusted"] for gap in figures["gaps"]] == [True, False]
    assert [gap["reasons"] for gap in figures["gaps"]] == [[], ["another person's joints"]]
    assert {"start_s", "end_s"} <= set(figures["gaps"][0])
    assert figures["self_check"]["stretches"] == 8
    assert figures["self_check"].keys() >= {
        *("stretches", "length_s", "rms_m", "stated_sigma_m", "inside_95", "sigma_factor")
    }
    assert figures["pairing"].items() >= {"proved": True, "chance": 1e-4, "evidence": 120.0}.items()
    assert figures["usable"] == 1600 - 240  # 3 s of 80 samples per second


def test_strict_ends_with_3_and_writes_all_the_same(smooth, tmp_path: Path) -> None:
    code, figures, said = smooth(WRONG, "--strict", "--report", str(tmp_path / "out.html"))
    assert code == NOT_TRUSTED == 3
    assert (tmp_path / "out.mcap").exists() and (tmp_path / "out.html").exists()
    assert "written: " in said and said.count("sign: gravity is 80 degrees off") == 1
    assert figures["trusted"] is False and figures["usable"] == 0
    assert figures["pairing"]["proved"] is False and figures["self_check"] is None
    assert all(gap["trusted"] is False and gap["reasons"] for gap in figures["gaps"])
    assert smooth(WRONG)[0] == 0
    assert smooth(SOUND, "--strict")[0] == 0
    code, figures, _ = smooth(Estimates(), "--strict")  # nobody judged: nothing says that it is to be trusted
    assert code == NOT_TRUSTED
    assert [gap["trusted"] for gap in figures["gaps"]] == [None, None]


def results(folder: Path) -> Path:
    for name, estimates in (("sound", SOUND), ("partly", PARTLY), ("wrong", WRONG)):
        write_recovery(replace(made(), estimates=estimates), folder / f"{name}.mcap")
    both = [replace(made("left"), estimates=SOUND), replace(made("right"), estimates=WRONG)]
    write_recovery(both, folder / "both.mcap")
    return folder


CAREFUL = "unocclude: warning: Usable with care: one gap. Not to be trusted: gap 2 ("
WARNED = "unocclude: warning: Not to be trusted: the skeleton seems mirrored"
#: What `export` and `validate` begin to warn of on a result, and a line that `info` prints.
SAID = {
    "sound": ("", "Usable."),
    "partly": (CAREFUL, "not to be trusted at 1 time; export lists them"),
    "wrong": (WARNED, WRONG.verdict),
    "both": (WARNED.replace("Not", "right arm: Not"), f"right: {WRONG.verdict}"),
}


@pytest.mark.parametrize("name", SAID)
def test_every_command_says_the_verdict(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    results(tmp_path)
    result, figures, (begins, line) = tmp_path / f"{name}.mcap", tmp_path / "f.json", SAID[name]
    done("export", result, "--format", "csv", "-o", tmp_path / "out.csv", "--json", figures)
    said = capsys.readouterr().err
    assert said.startswith(begins) and said.count("\n") == bool(begins)
    last = json.loads(figures.read_text())["files"][-1]
    assert last["trusted"] is (name in ("sound", "partly"))
    assert bool(last["untrusted"]) is (name == "partly")
    truth = replace(make_recording(), truth=make_truth(np.arange(0, 20, 0.0125)))
    write_recording(truth, tmp_path / "truth.mcap")
    done("info", result)
    assert line in capsys.readouterr().out.splitlines()
    if name != "both":
        done("validate", result, "--truth", tmp_path / "truth.mcap", "--json", figures, "--force")
        err = capsys.readouterr().err
        assert err.startswith(begins) and bool(err) == bool(begins)
        assert json.loads(figures.read_text())["trusted"] is last["trusted"]


DATA = Path(__file__).parents[2] / "data"


def test_info_of_what_cannot_be_recovered(tmp_path, capsys):
    from mcap.writer import Writer

    with open(tmp_path / "empty.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel(
            "/chat", "json", writer.register_schema("text", "jsonschema", b"{}")
        )
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    done("info", tmp_path / "empty.mcap")
    assert "cannot be recovered: " in capsys.readouterr().out


@pytest.mark.slow
def test_uncertain_answers_are_marked(ten_seconds, tmp_path, capsys):
    done(
        *("smooth", ten_seconds / "rec.mcap", "-o", tmp_path / "o.mcap"),
        *("--calibration", ten_seconds / "cal.toml", "--max-sigma-m", 0.004),
        *("--json", tmp_path / "s.json", "--draws", 0),
    )
    figures = json.loads((tmp_path / "s.json").read_text())
    assert figures["answered"] == figures["samples"]  # marked, not taken away
    assert 0 < figures["usable"] < figures["samples"]
    unsure = figures["samples"] - figures["usable"]
    assert (
        f"{unsure} of {figures['samples']} samples are less certain than 0.004 m" in capsys.readouterr().out
    )
    done("export", tmp_path / "o.mcap", "--format", "csv", "-o", tmp_path / "o.csv")
    with open(tmp_path / "o.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(row["usable"] == "0" for row in rows) == unsure
    for row in rows:
        assert row["imu_x"]
        assert (max(float(row[f"sigma_{axis}"]) for axis in "xyz") <= 0.004) == (row["usable"] == "1")


@pytest.mark.slow
def test_demo_as_a_user_runs_it(tmp_path, monkeypatch):
    command = [sys.executable, "-c", "from smoother.cli import main; main()", "demo", "--json", "d.json"]
    finished = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert finished.returncode == 0, finished.stderr
    assert f"recording: {DATA / 'demo.mcap'}" in finished.stdout
    report = Path(finished.stdout.strip().splitlines()[-1].removeprefix("report: "))
    assert report == (tmp_path / "out/demo/demo_report.html").resolve()
    assert report.stat().st_size > 10_000
    figures = json.loads((tmp_path / "d.json").read_text())
    assert figures["validation"]["occluded"]["position_rms_m"] < 0.04
    # a second time, over what the first one left; no figure holds a place of this machine
    report.unlink()
    monkeypatch.setattr("smoother.result.draws.USUAL_DRAWS", 0)
    done("demo", "-o", tmp_path / "out/demo", "--json", tmp_path / "again.json")
    assert report.is_file()
    text = (tmp_path / "again.json").read_text()
    assert json.loads(text)["report"] == "demo_report.html"
    assert str(tmp_path) not in text and str(DATA.parent) not in text
