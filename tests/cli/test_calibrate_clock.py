"""`unocclude calibrate clock` as users call it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cut_files import cut_before_the_summary
from scipy.io import wavfile

from calib import read_calibration
from smoother.cli.run import run
from smoother.io import write_recording
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import beep, broadcast


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


def test_sound_and_broadcast_chain(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    end = beep(1)[1]
    cal, figures, page = tmp_path / "cal.toml", tmp_path / "c.json", tmp_path / "c.html"
    arguments = (
        "--sound",
        folder / "beep.wav",
        "--event-time",
        end + 300.0,
        "--broadcast",
        folder / "times.csv",
    )
    assert command(*arguments, "-o", cal, "--json", figures, "--report", page) == 0
    out = capsys.readouterr().out
    assert "never carried over" in out and "beep of" in out
    links = {(link["from"], link["to"]): link for link in json.loads(figures.read_text())["links"]}
    assert set(links) == {("camera", "base"), ("camera", "arm"), ("base", "arm")}
    assert links["camera", "base"]["offset_s"] == pytest.approx(300.0, abs=1e-3)
    assert links["camera", "base"]["sigma_s"] < 1e-3
    clocks, _ = broadcast(2, nodes=2)
    at = links["base", "arm"]["at_s"]
    assert links["base", "arm"]["offset_s"] == pytest.approx(clocks.read(1, at) - at, abs=2e-4)
    assert links["base", "arm"]["skew_ppm"] == pytest.approx(390, abs=10)
    # the table is the session's own, and other tables and arms of the file stay
    table = read_calibration(cal).tables["clock"]
    assert table["valid_for"] == "this session alone" and table["session"] == "beep.wav, times.csv"
    assert len(table["links"]) == 3
    text = page.read_text(encoding="utf-8")
    assert (
        "The beep that ends at" in text
        and "What is left: broadcast" in text
        and "For the next recording" in text
    )


def test_sound_in_a_recording(folder: Path, tmp_path: Path):
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
    assert (
        command("--sound", tmp_path / "sound.mcap", "--event-time", 50.0, "--json", tmp_path / "c.json") == 0
    )
    (link,) = json.loads((tmp_path / "c.json").read_text())["links"]
    assert link["offset_s"] + 1.7e9 == pytest.approx(50.0 - end, abs=1e-3)
    cut_before_the_summary(tmp_path / "sound.mcap", tmp_path / "cut.mcap")
    assert command("--sound", tmp_path / "cut.mcap", "--event-time", 50.0, "--json", tmp_path / "d.json") == 0
    assert "ends in the middle" in json.loads((tmp_path / "d.json").read_text())["notes"][0]


def test_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    simulated = simulate_arm(ArmSimulation.preset("realistic", repetitions=1), 4)
    write_recording(simulated.recording, tmp_path / "rec.mcap")
    arguments = ("--motion", tmp_path / "rec.mcap", "--processes", 1, "--report", tmp_path / "m.html")
    assert command(*arguments, "--motion-clocks", "camera,arm", "--json", tmp_path / "m.json") == 0
    (link,) = json.loads((tmp_path / "m.json").read_text())["links"]
    assert (link["from"], link["to"]) == ("camera", "arm")
    assert link["offset_s"] == pytest.approx(simulated.parameters["clock_offset_s"], abs=5e-3)
    assert 2e-4 < link["sigma_s"] < 5e-3
    assert "the skew of camera-arm is not measured" in capsys.readouterr().out
    assert "The clock in the motion" in (tmp_path / "m.html").read_text(encoding="utf-8")


def test_missed_receptions_are_told_in_any_spelling(tmp_path):
    plain, spelt = tmp_path / "plain.csv", tmp_path / "spelt.csv"
    heard = "".join(f"{k},a,{k}.0\n{k},b,{k + 7}.0\n" for k in range(6))
    plain.write_text("round,node,t_s\n" + heard)
    missed = "".join(f"9{k},a,99\n9{k},b,{word}\n" for k, word in enumerate(("", "nan", "NA", "None")))
    spelt.write_text("round,node,t_s\n" + heard + missed)
    for path in (plain, spelt):
        assert command("--broadcast", path, "--json", path.with_suffix(".json")) == 0
    links = [json.loads(path.with_suffix(".json").read_text())["links"] for path in (plain, spelt)]
    assert links[0] == links[1] and links[0][0]["offset_s"] == pytest.approx(7.0)


@pytest.mark.parametrize(("node", "groups"), [("Base IMU", 1), ("7", 2)])
def test_sound_and_broadcast_chain_by_name_or_say_why_not(tmp_path, node: str, groups: int):
    sound, end, _ = beep(3, 16000)
    wavfile.write(tmp_path / "b.wav", 16000, (20000 * sound / np.abs(sound).max()).astype(np.int16))
    rows = "".join(f"{k},{node},{k}.0\n{k},arm,{k + 7}.0\n" for k in range(8))
    (tmp_path / "t.csv").write_text("round,node,t_s\n" + rows)
    given = ("--sound", tmp_path / "b.wav", "--event-time", end + 5, "--broadcast", tmp_path / "t.csv")
    assert command(*given, "--json", tmp_path / "c.json") == 0
    found = json.loads((tmp_path / "c.json").read_text())
    links = {(link["from"], link["to"]): link["offset_s"] for link in found["links"]}
    assert any("that nothing links" in each for each in found["not_determined"]) == (groups == 2)
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
        (("--broadcast", tmp_path / "head.csv"), 1, "lacks the column round, node, t_s"),
        (("--broadcast", tmp_path / "word.csv"), 1, "word.csv, line 3"),
        (
            ("--broadcast", tmp_path / "twice.csv"),
            1,
            "a has a second time in round 1 (the first is in line 2)",
        ),
        (("--broadcast", tmp_path / "one.csv"), 1, "contains the times of 1 node"),
        (("--broadcast", tmp_path / "apart.csv"), 1, "no event was received by two clocks"),
        (("--broadcast", times, "-o", times), 1, "is read by this command"),
        (("--motion", tmp_path / "none.mcap"), 1, "none.mcap does not exist"),
    ]
    for arguments, code, sentence in cases:
        assert command(*arguments, *(() if "-o" in arguments else ("-o", tmp_path / "c.toml"))) == code
        error = capsys.readouterr().err
        assert sentence in error and error.count("\n") == 1, error
    assert not (tmp_path / "c.toml").exists()
