"""`calibrate` as users run it, sensors, clocks and panels, and every calibration without hardware."""

from __future__ import annotations

import json
import shlex
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from commands import done, refused
from cut_files import cut_before_the_summary
from scipy.io import wavfile
from scipy.spatial.transform import Rotation

from calib.file import CalibrationFile, read_calibration, write_calibration
from calib.imu import calibrate_imu, imu_answer
from calib.world import with_gravity
from smoother.cli.load import load_arm
from smoother.cli.run import run
from smoother.config import Config
from smoother.errors import RecordingError
from smoother.io import read_recording, write_recording
from smoother.io.export.markers import write_trc
from smoother.io.mcap.messages import nanoseconds
from smoother.io.recording.read import read_imu
from smoother.io.recording.streams import ImuSamples, RecordingFile
from smoother.io.tables.markers import read_positions
from smoother.linalg import sphere
from smoother.recording import ImuStream, Recording
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.config import ClockSources
from smoother.simulation.rig import (
    beep,
    simulate_clock_session,
)
from smoother.smoothing import smooth
from smoother.window.priors import with_measured_noise


def pcm(sound: np.ndarray) -> np.ndarray:
    return (sound / np.abs(sound).max() * 30000).astype(np.int16)


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
    session = simulate_clock_session(ClockSources(), 5)
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


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two poses as files and as a recording."""
    folder = tmp_path_factory.mktemp("panel")
    two_poses = ("--set", "poses=2", "--seed", 5)
    done("simulate", "panel", "-o", folder / "s", "--mcap", folder / "s.mcap", *two_poses)
    return folder


def pose(folder: Path, number: int = 1, **other: Path) -> list[str]:
    """The options of a pose."""
    files = {what: folder / "s" / f"pose_0{number}_{what}.png" for what in ("depth", "infrared")}
    files |= {"markers": folder / "s" / f"pose_0{number}_markers.csv", **other}
    return [part for what, path in files.items() for part in (f"--{what}", str(path))]


def known(folder: Path, **other: Path) -> list[str]:
    """Lens and panel."""
    files = {"intrinsics": folder / "s" / "intrinsics.toml", "panel": folder / "s" / "panel.toml", **other}
    return [part for what, path in files.items() for part in (f"--{what}", str(path))]


def check(table: dict, folder: Path, degrees: float, metres: float) -> None:
    truth = tomllib.loads((folder / "s" / "truth.toml").read_text())["camera_from_mocap"]
    turn = Rotation.from_quat(table["rotation"], scalar_first=True).inv() * Rotation.from_quat(
        truth["rotation"], scalar_first=True
    )
    assert np.degrees(turn.magnitude()) < degrees
    assert np.linalg.norm(np.subtract(table["translation"], truth["translation"])) < metres


def test_files_to_calibration_and_json(session: Path, tmp_path: Path, capsys):
    output, figures = tmp_path / "cal.toml", tmp_path / "panel.json"
    output.write_text('format = "unocclude calibration"\nversion = 1\n[other]\nkept = 1\n')
    options = [*pose(session, 1), *pose(session, 2), *known(session), "-o", str(output)]
    command = ["calibrate", "panel", *options, "--json", str(figures)]
    done(*command)
    said = capsys.readouterr().out
    assert "verdict: Rotation within" in said and "next: record 4 to 8 poses" in said
    tables = read_calibration(output).tables
    table = tables["camera_from_mocap"]
    assert tables["other"] == {"kept": 1}
    check(table, session, 0.15, 0.004)  # the mocap's origin is metres away
    assert table["poses"] == 2 and len(table["residuals"]) == 2 and table["grade"] == "good"
    assert np.shape(table["covariance"]) == (6, 6)
    sigma = np.sqrt(np.diag(table["covariance"]))
    np.testing.assert_allclose(np.degrees(sigma[:3]), table["rotation_sigma_deg"])
    np.testing.assert_allclose(sigma[3:], table["translation_sigma_m"])
    check(table["published"], session, 0.6, 0.02)
    written = json.loads(figures.read_text())
    assert written["camera_from_mocap"]["rotation"] == table["rotation"]
    assert written["grade"] == "good"
    assert run(command) == 1  # the JSON exists


def test_a_recording_gives_the_same(session: Path, tmp_path: Path):
    output, files = tmp_path / "a.toml", tmp_path / "b.toml"
    panel = known(session)[2:]
    done("calibrate", "panel", session / "s.mcap", *panel, "-o", output)
    done("calibrate", "panel", *pose(session, 1), *pose(session, 2), *known(session), "-o", files)
    one, other = (read_calibration(path).tables["camera_from_mocap"] for path in (output, files))
    # CSV has whole micrometres
    np.testing.assert_allclose(one["rotation"], other["rotation"], atol=1e-5)
    np.testing.assert_allclose(one["translation"], other["translation"], atol=3e-5)
    cut = tmp_path / "cut.mcap"
    cut_before_the_summary(session / "s.mcap", cut)
    json_file = tmp_path / "c.json"
    done("calibrate", "panel", cut, *panel, "-o", tmp_path / "c.toml", "--json", json_file)
    assert "ends in the middle" in json.loads(json_file.read_text())["notes"][0]


def edited(source: Path, target: Path, *changes: tuple[str, str]) -> Path:
    text = source.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    target.write_text(text)
    return target


def leaves_nothing(options: list[str], folder: Path, capsys, *words: str, picture: bool = False) -> None:
    """It is refused, and nothing is written but the picture that the sentence names."""
    output = folder / "out" / "cal.toml"
    output.parent.mkdir()
    error = refused(capsys, "calibrate", "panel", *options, "-o", output)
    assert all(word in error for word in words), error
    left = [path.name for path in output.parent.iterdir()]
    assert left == (["cal.seen.png"] if picture else [])
    if picture:
        assert "cal.seen.png" in error
        assert cv2.imread(str(output.parent / "cal.seen.png")).shape[1] >= 1000


def covered(session: Path, target: Path, pixel: np.ndarray) -> Path:
    """The infrared image with a marker painted over in the panel's own shade."""
    image = cv2.imread(str(session / "s" / "pose_01_infrared.png"), cv2.IMREAD_UNCHANGED)
    x, y = np.rint(pixel).astype(int)
    shade = int(np.median(image[y - 15 : y + 15, x - 15 : x + 15]))
    cv2.circle(image, (int(x), int(y)), 7, shade, -1)
    cv2.imwrite(str(target), image)
    return target


def marker_pixels(session: Path) -> np.ndarray:
    truth = tomllib.loads((session / "s" / "truth.toml").read_text())
    return np.array(truth["pose"]["01"]["marker_pixels"])


def no_depth(session: Path, target: Path) -> Path:
    """The depth image without any under the panel."""
    depth = cv2.imread(str(session / "s" / "pose_01_depth.png"), cv2.IMREAD_UNCHANGED)
    x, y = marker_pixels(session).mean(axis=0).astype(int)
    depth[max(0, y - 150) : y + 150, max(0, x - 150) : x + 150] = 0
    cv2.imwrite(str(target), depth)
    return target


def three_markers(session: Path, target: Path) -> Path:
    target.write_text("marker,x,y,z\na,0,0,0\nb,1,0,0\nc,0,1,0\n")
    return target


def grey(session: Path, target: Path) -> Path:
    cv2.imwrite(str(target), np.zeros((424, 512), np.uint8))
    return target


MIRRORED = (("0.35]", "-0.35]"), ("[[-0.05, -0.05], [0.55, 0.4]]", "[[-0.05, -0.40], [0.55, 0.05]]"))
#: What is wrong: the option, how its file is made, and the words of the refusal.
WRONG = {
    "mirrored": ("panel", lambda s, to: edited(s / "s/panel.toml", to, *MIRRORED), ["mirror image"]),
    "size": (
        "intrinsics",
        lambda s, to: edited(s / "s/intrinsics.toml", to, ("width = 512", "width = 640")),
        ["512 x 424", "640 x 424"],
    ),
    "spots": ("infrared", lambda s, to: covered(s, to, marker_pixels(s)[1]), ["three bright spots"]),
    "depth": ("depth", no_depth, ["depth is missing under the panel"]),
    "markers": ("markers", three_markers, ["3 mocap markers"]),
    "no image": ("depth", lambda s, _: s / "s/panel.toml", ["panel.toml", "not an image"]),
    "8 bit": ("depth", grey, ["16 bit"]),
    "definition": (
        "panel",
        lambda s, to: edited(s / "s/panel.toml", to, (", [0.0, 0.35]", "")),
        ["panel.markers"],
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_with_a_file(session: Path, tmp_path: Path, capsys, case: str):
    option, made, words = WRONG[case]
    ending = {"panel": "toml", "intrinsics": "toml", "markers": "csv"}.get(option, "png")
    file = {option: made(session, tmp_path / f"x.{ending}")}
    of_pose = option in ("depth", "infrared", "markers")
    options = [*pose(session, **(file if of_pose else {})), *known(session, **({} if of_pose else file))]
    leaves_nothing(options, tmp_path, capsys, *words, picture=case == "spots")


def test_markers_of_a_file_that_people_make(tmp_path: Path):
    path = tmp_path / "m.csv"
    path.write_bytes(b"\xef\xbb\xbfmarker, x, y ,z, note\r\n C , 1e-1,0.2,-3, x\r\nlost,,,,\r\nA,1,2,3,\r\n")
    found = read_positions(path)
    assert list(found) == ["C", "A"]
    np.testing.assert_allclose(found["C"], [0.1, 0.2, -3])
    path.write_text("marker,x,y,z\na,,,\n")
    with pytest.raises(RecordingError, match="no rows"):
        read_positions(path)


def test_markers_over_time(tmp_path: Path):
    path, t = tmp_path / "m.trc", np.arange(50) / 100
    place = np.tile([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], (50, 1, 1))
    place[:, 0, 0] += 1e-3 * (-1) ** np.arange(50)  # noise of a marker that stands still
    write_trc(path, ("P1", "P2"), t, place, 100.0)
    np.testing.assert_allclose(read_positions(path)["P1"], [0.1, 0.2, 0.3], atol=1e-9)
    place[:, 1, 0] += 0.1 * t  # one that is carried
    write_trc(path, ("P1", "P2"), t, place, 100.0, force=True)
    with pytest.raises(RecordingError, match="P2 moved by"):
        read_positions(path)


FROM_OPTICAL = np.diag([-1.0, -1.0, 1.0])


def matrix(table: dict) -> np.ndarray:
    return Rotation.from_quat(np.roll(table["rotation"], -1)).as_matrix()


def degrees(R: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(R).magnitude()))


@pytest.fixture(scope="module")
def world_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five poses, the camera turned between them."""
    folder = tmp_path_factory.mktemp("world")
    arguments = ["--set", "poses=5", "--seed", "21", "--set", "camera_tilt_deg=30", "--set", "tilt_deg=15,38"]
    done = run(["simulate", "panel", "-o", str(folder / "s"), "--mcap", str(folder / "s.mcap"), *arguments])
    assert done == 0
    return folder


@pytest.mark.slow
def test_recording_gives_camera_from_base_and_the_mounting(world_session: Path, tmp_path: Path, capsys):
    cal, figures = tmp_path / "cal.toml", tmp_path / "world.json"
    write_calibration(cal, CalibrationFile().with_table("kept", {"value": 1}))
    panel = ["--panel", str(world_session / "s/panel.toml")]
    command = ["calibrate", "world", str(world_session / "s.mcap"), *panel]
    command += ["-o", str(cal), "--json", str(figures)]
    done(*command)
    said = capsys.readouterr().out
    assert run(command) == 1  # the JSON exists
    assert "--force" in capsys.readouterr().err
    truth = tomllib.loads((world_session / "s/truth.toml").read_text())
    tables = read_calibration(cal).tables
    assert degrees(matrix(tables["camera_from_base"]) @ matrix(truth["camera_from_base"]).T) < 0.4
    assert degrees(matrix(tables["panel_from_imu"]).T @ matrix(truth["panel_from_imu"])) < 0.4
    assert tables["kept"] == {"value": 1}
    assert tables["world"]["heading"] == "known" and tables["world"]["poses"] == 5
    assert tables["world"]["verdict"] in said and "verdict:" in said
    assert json.loads(figures.read_text())["grade"] == tables["world"]["grade"]


@pytest.fixture(scope="module")
def still() -> tuple[Recording, np.ndarray, np.ndarray]:
    """An arm that hangs still before a camera with a base IMU; down in the camera; R_K_B (optical)."""
    arm = simulate_arm(ArmSimulation.preset("realistic", protocol="hang", duration_s=12, still_all=True), 1)
    down = np.asarray(arm.parameters["gravity"]) / 9.81
    R_K_B = Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    rng = np.random.default_rng(5)
    t_s = np.arange(0.5, 1100) / 100
    acc = -9.81 * (R_K_B.T @ FROM_OPTICAL @ down) + 0.03 * rng.normal(size=(len(t_s), 3))
    base = ImuStream("/imu/base", t_s, acc, 0.002 * rng.normal(size=(len(t_s), 3)))
    return replace(arm.recording, base_imu=base), down, R_K_B


def known_to(R_K_B: np.ndarray, sigma_deg: float, off_deg: float) -> CalibrationFile:
    off = Rotation.from_rotvec(np.radians([off_deg, 0, 0])).as_matrix()
    q = np.roll(Rotation.from_matrix(off @ R_K_B).as_quat(), 1)
    table = {"rotation": q.tolist(), "rotation_sigma_deg": [sigma_deg] * 3}
    return CalibrationFile().with_table("camera_from_base", table)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))))


@pytest.mark.slow
def test_a_base_imu_keeps_the_tilt_of_a_still_recording(still):
    recording, down, R_K_B = still
    without = smooth(recording)
    told = with_gravity(recording, known_to(R_K_B, 0.2, 0.2))
    assert angle(told.gravity_hint, down) < 0.3
    assert 0.2 < np.degrees(told.gravity_sigma_rad) < 0.5
    assert any("base IMU" in note for note in told.notes)
    tilt = angle(smooth(told).gravity_direction, down)
    assert tilt < 0.5 and tilt < 0.2 * angle(without.gravity_direction, down)


def test_smooth_takes_it_through_the_files(still, tmp_path: Path):
    recording, down, R_K_B = still
    rec, cal, out = tmp_path / "rec.mcap", tmp_path / "cal.toml", tmp_path / "out.mcap"
    write_recording(recording, rec)
    assert read_recording(rec).base_imu is not None
    write_calibration(cal, known_to(R_K_B, 0.2, 0.1))
    from smoother.io import read_recovery

    done("smooth", rec, "-o", out, "--calibration", cal, "--draws", "0")
    assert angle(read_recovery(out)[0].gravity_direction, down) < 0.5


def test_a_free_heading_costs_where_the_camera_stands_otherwise(still):
    """Gravity is sure where the camera stands as in the poses, unsure where it is tilted elsewhere."""
    recording, down, R_K_B = still
    up = -FROM_OPTICAL @ down
    free = np.zeros((6, 6))
    free[:3, :3] = np.radians(60) ** 2 * np.outer(up, up) + np.radians(0.1) ** 2 * np.eye(3)
    file = known_to(R_K_B, 0.1, 0.0)
    file.tables["camera_from_base"]["covariance"] = free.tolist()
    here = with_gravity(recording, file)
    assert np.degrees(here.gravity_sigma_rad) < 0.4
    tilted = Rotation.from_rotvec(np.radians(20) * np.cross(up, [0, 0, 1])).as_matrix()
    base = replace(recording.base_imu, acc=recording.base_imu.acc @ (R_K_B.T @ tilted @ R_K_B).T)
    assert np.degrees(with_gravity(replace(recording, base_imu=base), file).gravity_sigma_rad) > 5


def test_a_base_imu_that_cannot_be_used_is_told(still):
    recording, _, R_K_B = still
    file = known_to(R_K_B, 0.2, 0.0)
    assert with_gravity(recording, CalibrationFile()) is recording
    assert with_gravity(replace(recording, base_imu=None), file).gravity_sigma_rad is None
    odd = with_gravity(replace(recording, camera_frame=None), file)
    assert odd.gravity_sigma_rad is None and "are unknown" in odd.notes[-1]
    newer = file.with_table(
        "imu", {"base": {"accelerometer": {"offset": [0.1, 0, 0], "matrix": np.eye(3).tolist()}}}
    )
    assert "calibrate world" in with_gravity(recording, newer).notes[-1]
    file.tables["camera_from_base"]["rotation"] = [1, 1, 0, 0]
    with pytest.raises(Exception, match="unit quaternion"):
        with_gravity(recording, file)
