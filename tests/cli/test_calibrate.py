"""`calibrate clock`, `imu`, `magnetometer` as users call them, and every calibration without hardware."""

from __future__ import annotations

import json
import shlex
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from cut_files import cut_before_the_summary
from scipy.io import wavfile

from calib.file import read_calibration
from calib.imu import calibrate_imu, imu_answer
from smoother.cli.load import load_arm
from smoother.cli.run import run
from smoother.config import Config
from smoother.io import write_recording
from smoother.io.mcap.messages import nanoseconds
from smoother.io.recording.read import read_imu
from smoother.io.recording.streams import ImuSamples, RecordingFile
from smoother.linalg import sphere
from smoother.recording import ImuStream
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import (
    SensorModel,
    beep,
    broadcast,
    rest_poses,
    simulate_clock_session,
)
from smoother.window.priors import with_measured_noise


def command(*arguments: object) -> int:
    return run(["calibrate", "clock", *map(str, arguments)])


def pcm(sound: np.ndarray) -> np.ndarray:
    return (sound / np.abs(sound).max() * 30000).astype(np.int16)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A beep, and a broadcast's times."""
    place = tmp_path_factory.mktemp("clocks")
    wavfile.write(place / "beep.wav", 16000, np.stack([pcm(beep(1)[0]), np.zeros(64000, np.int16)], axis=1))
    _, heard = broadcast(2, nodes=2)
    rows = zip(heard.event.tolist(), heard.node, heard.t_s.tolist(), strict=True)
    (place / "times.csv").write_text(
        "round,node,t_s\n" + "".join(f"{e},{'base' if n == 'n0' else 'arm'},{t:.7f}\n" for e, n, t in rows)
    )
    return place


def test_sound_in_a_recording(tmp_path: Path):
    """Foxglove's RawAudio in blocks stamped late by a jitter of some milliseconds."""
    from foxglove_schemas_protobuf.RawAudio_pb2 import RawAudio
    from mcap.writer import Writer

    from smoother.io.wire.schemas import schema_data

    sound, end, _ = beep(3)
    samples, rng, start_ns = pcm(sound), np.random.default_rng(0), 1_700_000_000_000_000_000
    with open(tmp_path / "sound.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("foxglove.RawAudio", "protobuf", schema_data("foxglove.RawAudio"))
        channel = writer.register_channel("/audio", "protobuf", schema)
        for first in range(0, len(samples), 800):
            stamp = start_ns + first * 62500 + int(rng.normal(0, 1e6))
            part = RawAudio(
                data=samples[first : first + 800].tobytes(),
                format="pcm-s16",
                sample_rate=16000,
                number_of_channels=1,
            )
            part.timestamp.FromNanoseconds(stamp)
            writer.add_message(channel, stamp, part.SerializeToString(), stamp)
        writer.finish()
    done(
        *("calibrate", "clock", "--sound", tmp_path / "sound.mcap", "--event-time", 50.0, "--json"),
        tmp_path / "c.json",
    )
    (link,) = json.loads((tmp_path / "c.json").read_text())["links"]
    assert link["offset_s"] + 1.7e9 == pytest.approx(50.0 - end, abs=1e-3)
    cut_before_the_summary(tmp_path / "sound.mcap", tmp_path / "cut.mcap")
    done(
        *("calibrate", "clock", "--sound", tmp_path / "cut.mcap", "--event-time", 50.0, "--json"),
        tmp_path / "d.json",
    )
    assert "ends in the middle" in json.loads((tmp_path / "d.json").read_text())["notes"][0]


@pytest.mark.parametrize(("node", "groups"), [("Base IMU", 1), ("7", 2)])
def test_sound_and_broadcast_chain_by_name_or_say_why_not(tmp_path, node: str, groups: int):
    sound, end, _ = beep(3, 16000)
    wavfile.write(tmp_path / "b.wav", 16000, (20000 * sound / np.abs(sound).max()).astype(np.int16))
    rows = "".join(f"{k},{node},{k}.0\n{k},arm,{k + 7}.0\n" for k in range(8))
    (tmp_path / "t.csv").write_text("round,node,t_s\n" + rows)
    done(
        *("calibrate", "clock", "--sound", tmp_path / "b.wav", "--event-time", end + 5),
        *("--broadcast", tmp_path / "t.csv", "--json", tmp_path / "c.json"),
    )
    found = json.loads((tmp_path / "c.json").read_text())
    links = {(link["from"], link["to"]): link["offset_s"] for link in found["links"]}
    assert any("nothing links" in each for each in found["not_determined"]) == (groups == 2)
    if groups == 1:
        offset = links.get(("camera", "arm"), -links.get(("arm", "camera"), np.nan))
        assert offset == pytest.approx(12.0, abs=2e-3)


def test_refusals(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    sound, times = folder / "beep.wav", folder / "times.csv"
    (tmp_path / "cut.wav").write_bytes(sound.read_bytes()[:30])
    wavfile.write(tmp_path / "quiet.wav", 16000, np.zeros(16000, np.int16))
    bad = {
        "head.csv": "a,b\n1,2\n",
        "word.csv": "round,node,t_s\n1,a,1.0\n1,b,soon\n",
        "twice.csv": "round,node,t_s\n1,a,1.0\n1,a,2.0\n",
        "one.csv": "round,node,t_s\n1,a,1.0\n2,a,2.0\n",
        "apart.csv": "round,node,t_s\n1,a,1.0\n2,b,2.0\n",
    }
    for name, text in bad.items():
        (tmp_path / name).write_text(text)
    cases = [
        ((), 2, "give --sound with --event-time, --broadcast, --motion"),
        (("--sound", sound), 2, "--sound and --event-time belong together"),
        (("--sound", sound, "--event-time", 1, "--event-time", 2), 1, "event times given: 2"),
        (("--sound", tmp_path / "cut.wav", "--event-time", 1), 1, "cut.wav is not a WAV file"),
        (("--sound", tmp_path / "quiet.wav", "--event-time", 1), 1, "quiet.wav: the sound is silent"),
        (("--sound", sound, "--event-time", "nan"), 2, "--event-time takes seconds"),
        (("--sound", sound, "--event-time", 1, "--sound-clocks", "a"), 2, "takes two names"),
        (("--broadcast", tmp_path / "none.csv"), 1, "none.csv does not exist"),
        (("--broadcast", tmp_path / "head.csv"), 1, "has none of the columns round, node, t_s"),
        (("--broadcast", tmp_path / "word.csv"), 1, "word.csv, row 2"),
        (
            ("--broadcast", tmp_path / "twice.csv"),
            1,
            "a has a second time in round 1 (the first is in row 1)",
        ),
        (("--broadcast", tmp_path / "one.csv"), 1, "contains the times of 1 node"),
        (("--broadcast", tmp_path / "apart.csv"), 1, "no event was received by two clocks"),
        (("--broadcast", times, "-o", times), 1, "is read by this command"),
        (("--motion", tmp_path / "none.mcap"), 1, "none.mcap does not exist"),
    ]
    for arguments, code, sentence in cases:
        output = () if "-o" in arguments else ("-o", tmp_path / "c.toml")
        assert sentence in refused(capsys, "calibrate", "clock", *arguments, *output, code=code)
    assert not (tmp_path / "c.toml").exists()


TOPIC = "/imu/forearm_right"


def record(path: Path, *streams: ImuStream) -> Path:
    file = RecordingFile(path)
    for each in streams:
        stamp = nanoseconds(each.t_s, 0)
        file.imus.append(
            ImuSamples(each.name, each.name.split("/")[-1], stamp, each.acc, each.gyro, each.mag)
        )
    write_recording(file, path)
    return path


def sensor(seed: int = 0) -> SensorModel:
    return SensorModel.draw(seed, offset=0.5, scale=0.03, cross=0.01)


def test_refusals_name_file_and_sensor_and_write_nothing(tmp_path, capsys):
    out = tmp_path / "cal.toml"
    eight, _ = rest_poses(sensor(), 8)
    path = record(tmp_path / "eight.mcap", eight)
    assert f"eight.mcap, {TOPIC}: the recording contains 8" in refused(
        capsys, "calibrate", "imu", path, "-o", out
    )
    assert "has no magnetometer" in refused(capsys, "calibrate", "magnetometer", path, "-o", out)
    plane = np.random.default_rng(0).normal(0.0, 0.3, (len(eight), 3))
    angle = np.linspace(0.0, 30.0, len(eight))
    plane += 48.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    flat = record(tmp_path / "flat.mcap", replace(eight, mag=plane))
    assert "one axis only (its z axis)" in refused(capsys, "calibrate", "magnetometer", flat, "-o", out)
    two = record(tmp_path / "two.mcap", eight, replace(eight, name="/imu/base"))
    assert "has several IMUs" in refused(capsys, "calibrate", "imu", two, "-o", out)
    assert not out.exists()
    out.write_text('format = "unocclude calibration"\nversion = 1\nimu = [1]\n')
    assert "[imu.NAME]" in refused(capsys, "calibrate", "imu", path, "-o", out)


def test_corrections_are_applied_as_a_recording_is_loaded(tmp_path, capsys):
    made = simulate_arm(ArmSimulation(repetitions=1), 1).recording
    path, cal = tmp_path / "arm.mcap", tmp_path / "cal.toml"
    write_recording(replace(made, imu=replace(made.imu, name=TOPIC)), path)
    cal.write_text(
        'format = "unocclude calibration"\nversion = 1\n'
        "[imu.forearm_right.accelerometer]\noffset = [0.1, 0.2, 0.3]\nmatrix = [[1.1,0,0],[0,1,0],[0,0,1]]\n"
        "noise_density = 0.02\n[imu.forearm_right.gyroscope]\noffset = [0.0, 0.1, 0.0]\n"
    )
    raw, _ = load_arm(path)
    recording, arm = load_arm(path, cal)
    assert arm is None  # a file of sensors alone leaves the arm to be found
    assert recording.imu.acc[:, 0] == pytest.approx(1.1 * (raw.imu.acc[:, 0] - 0.1))
    assert recording.imu.gyro[:, 1] == pytest.approx(raw.imu.gyro[:, 1] - 0.1)
    assert any("accelerometer, gyroscope corrected; its measured noise is used" in n for n in recording.notes)
    assert with_measured_noise(Config(), recording.imu).imu.accelerometer_density == 0.02
    stated = Config.model_validate({"imu": {"accelerometer_density": 0.05}})
    assert with_measured_noise(stated, recording.imu).imu.accelerometer_density == 0.05
    other = cal.read_text().replace("forearm_right", "base")
    cal.write_text(other)
    assert any("left uncorrected" in note for note in load_arm(path, cal)[0].notes)
    cal.write_text(other.replace("imu.base", "imu.forearm_right").replace("[0.1, 0.2, 0.3]", '["a", 0, 0]'))
    said = refused(capsys, "smooth", path, "-o", tmp_path / "o.mcap", "--calibration", cal)
    assert "imu.forearm_right.accelerometer.offset" in said


#: A normalised error beyond this has a chance of one in fifteen thousand.
MOST_SIGMAS = 4.0


def simulated(capsys: pytest.CaptureFixture[str], *words: object) -> list[str]:
    """Run `unocclude simulate ..`; the command that it says to try, in words."""
    done("simulate", *words)
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith("try: unocclude ")
    return shlex.split(line)[2:]


def truth_of(path: Path) -> dict:
    return tomllib.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("seed", [1, 2])
def test_imu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, seed: int) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(simulated(capsys, "imu", "-o", "poses.mcap", "--seed", seed)) == 0
    truth = truth_of(Path("poses_truth.toml"))["imu"]["forearm_right"]
    answer = imu_answer(calibrate_imu(read_imu("poses.mcap")[0]))
    upper = np.triu_indices(3)  # whose sigmas are stated
    for sensor, name, rows in (
        ("accelerometer", "offset", ...),
        ("accelerometer", "matrix", upper),
        ("gyroscope", "offset", ...),
    ):
        found = answer.figures[sensor]
        error = (np.array(found[name]) - np.array(truth[sensor][name]))[rows]
        assert np.abs(error / found[f"{name}_sigma"]).max() < MOST_SIGMAS, (sensor, name)
    # the file of the printed command holds the same, and the truth reads as a calibration file
    held = read_calibration("arm.toml").tables["imu"]["forearm_right"]["accelerometer"]
    np.testing.assert_allclose(held["offset"], answer.figures["accelerometer"]["offset"])
    assert read_calibration("poses_truth.toml").tables["imu"]["forearm_right"] == truth
    assert Path("imu.html").exists()


def test_a_long_rest_gives_the_noise(tmp_path: Path, capsys) -> None:
    path, figures = tmp_path / "rest.mcap", tmp_path / "rest.json"
    words = simulated(capsys, "imu", "-o", path, "--set", "long_rest_s=300")[:3]
    done(*words, "-o", tmp_path / "arm.toml", "--json", figures)
    found = json.loads(figures.read_text())
    # 300 s of a density: each axis to about 3 %
    assert found["accelerometer"]["noise_density"] == pytest.approx(2e-3, rel=0.1)
    assert found["gyroscope"]["noise_density"] == pytest.approx(2e-4, rel=0.1)
    truth = truth_of(tmp_path / "rest_truth.toml")["imu"]["forearm_right"]
    assert found["gyroscope"]["offset"] == pytest.approx(truth["gyroscope"]["offset"], abs=1e-4)


def test_magnetometer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    words = simulated(capsys, "magnetometer", "-o", "turning.mcap", "--set", "field=0.5", "--seed", 3)
    assert run(words) == 0
    truth = truth_of(Path("turning_truth.toml"))["imu"]["forearm_right"]["magnetometer"]
    found = read_calibration("arm.toml").tables["imu"]["forearm_right"]["magnetometer"]
    # what the sensor reads of fields in all directions, corrected: of length 1 to 1 % / sqrt(3000 / 9)
    read = sphere(300) @ np.linalg.inv(truth["matrix"]).T + truth["offset"]
    length = np.linalg.norm((read - found["offset"]) @ np.transpose(found["matrix"]), axis=1)
    assert np.sqrt(np.mean((length - 1.0) ** 2)) < 3 * found["residual_rms"] / np.sqrt(found["samples"] / 9)
    # the turns of gyroscope and accelerometer are those of the magnetometer: the dip does not change
    stream, _ = read_imu("turning.mcap")
    field = (stream.mag - truth["offset"]) @ np.transpose(truth["matrix"])
    down = np.einsum("ni,ni->n", field, stream.acc) / 9.81
    assert down == pytest.approx(np.full(len(down), -np.sin(np.radians(60.0))), abs=0.06)


@pytest.mark.slow
def test_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    words = simulated(capsys, "clock", "-o", "session", "--seed", 5)
    done(*words, "--processes", "1")
    links = read_calibration("clock.toml").tables["clock"]["links"]
    session = simulate_clock_session(5)
    assert len(links) == 3
    for link in links:
        true = session.clocks.offset_between_s(link["from"], link["to"], link["at_s"])
        assert abs(link["offset_s"] - true) < MOST_SIGMAS * link["sigma_s"], link
        assert link["sigma_s"] < 1e-3
    of_file = {
        (link["from"], link["to"]): link for link in truth_of(Path("session/truth.toml"))["clock"]["links"]
    }
    at_zero = of_file["base", "forearm_right"]
    assert at_zero["offset_s"] == session.clocks.offset_between_s("base", "forearm_right", 0.0)
    assert at_zero["skew_ppm"] == pytest.approx(390.0, abs=0.01)


def test_nothing_is_overwritten_unasked(tmp_path: Path, capsys) -> None:
    for words, other in (
        (["imu", "-o", "a.mcap"], "a_truth.toml"),
        (["magnetometer", "-o", "b.mcap"], "b_truth.toml"),
        (["strap", "-o", "c.mcap"], "c_truth.toml"),
        (["clock", "-o", "d"], "d/notes.txt"),
    ):
        held = tmp_path / other
        held.parent.mkdir(exist_ok=True)
        held.write_text("mine")
        words = [*words[:2], str(tmp_path / words[2])]
        assert run(["simulate", *words]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "exists already" in error
        assert held.read_text() == "mine" and len(list(tmp_path.rglob("*"))) == (
            2 if words[0] == "clock" else 1
        )
        held.unlink()
    (tmp_path / "d" / "notes.txt").write_text("mine")
    said = refused(capsys, "simulate", "clock", "-o", tmp_path / "d", "--force")
    assert "contains other things than a simulation" in said


def test_missed_receptions_are_told_in_any_spelling(tmp_path):
    plain, spelt = tmp_path / "plain.csv", tmp_path / "spelt.csv"
    heard = "".join(f"{k},a,{k}.0\n{k},b,{k + 7}.0\n" for k in range(6))
    plain.write_text("round,node,t_s\n" + heard)
    missed = "".join(f"9{k},a,99\n9{k},b,{word}\n" for k, word in enumerate(("", "nan", "NA", "None")))
    spelt.write_text("round,node,t_s\n" + heard + missed)
    for path in (plain, spelt):
        done("calibrate", "clock", "--broadcast", path, "--json", path.with_suffix(".json"))
    links = [json.loads(path.with_suffix(".json").read_text())["links"] for path in (plain, spelt)]
    assert links[0] == links[1] and links[0][0]["offset_s"] == pytest.approx(7.0)
