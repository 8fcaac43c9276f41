"""Methods through the real commands: `compare` and `gaps`, `smooth --method`."""

from __future__ import annotations

import json
import pickle
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused

from smoother import Config, smoothing
from smoother.baselines.registry import BASELINES
from smoother.cli.options import listed
from smoother.cli.run import run
from smoother.errors import SolveError
from smoother.evaluation.compare import compare
from smoother.evaluation.gaps import evaluate_gaps
from smoother.evaluation.methods import METHODS, make_methods
from smoother.io import read_recording, read_recovery, write_recording
from smoother.recording import Recording
from smoother.runtime import pool
from smoother.simulation import ArmSimulation, simulate_arm


@pytest.fixture(scope="module")
def everything(ten_seconds: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Figures of every method, held against the recording's own truth."""
    where = tmp_path_factory.mktemp("everything")
    done(
        *("compare", ten_seconds / "rec.mcap", "--calibration", ten_seconds / "cal.toml", "--processes", 1),
        *("--json", where / "c.json"),
    )
    return json.loads((where / "c.json").read_text())


@pytest.mark.slow
def test_every_method_is_there_the_best_first(everything):
    figures = everything
    assert set(figures["order"]) == set(figures["methods"]) == set(METHODS)
    errors = [figures["methods"][name]["occluded"]["position_rms_m"] for name in figures["order"]]
    assert errors == sorted(errors) and all(0 < error < 0.6 for error in errors)
    assert figures["order"].index("graph") < figures["order"].index("linear-drift")
    for name, found in figures["methods"].items():
        assert found["failure"] == "" and found["points"], name
        assert (found["occluded"]["nees"] is None) == (
            name in ("linear-drift", "camera-only", "pchip", "hold")
        ), name


@pytest.mark.slow
def test_a_truth_of_markers(everything, ten_seconds: Path, tmp_path: Path, capsys):
    figures = everything
    done(
        *("compare", ten_seconds / "rec.mcap", "--truth", ten_seconds / "rec.c3d", "--methods", "hold,graph"),
        *("--markers", ten_seconds / "rec_markers.toml", "--calibration", ten_seconds / "cal.toml"),
        *("--processes", 1, "--json", tmp_path / "c.json"),
    )
    said = capsys.readouterr().out
    found = json.loads((tmp_path / "c.json").read_text())
    assert found["alignment"] == "calibration" and found["order"] == ["graph", "hold"]
    assert "frame from the calibration" in " ".join(said.split())
    assert "aligned by the graph's answer, once for all methods" in said
    # the clock is aligned by the answer, which costs some tenths of a millimetre
    assert found["methods"]["graph"]["occluded"]["position_rms_m"] == pytest.approx(
        figures["methods"]["graph"]["occluded"]["position_rms_m"], abs=1e-3
    )


def test_a_recording_without_gaps_is_compared_as_a_whole(tmp_path: Path, capsys):
    from scenes import point

    made = point(2, duration_s=8.0, occlusion_lengths_s=())
    write_recording(made.recording, tmp_path / "p.mcap")
    done(
        *("compare", tmp_path / "p.mcap", "--methods", "hold,graph", "--processes", 1),
        *("--json", tmp_path / "c.json", "--report", tmp_path / "c.html"),
    )
    figures = json.loads((tmp_path / "c.json").read_text())
    assert figures["order"] == ["graph", "hold"] and set(figures["camera"]["lag_before_s"]) == {"strap"}
    assert figures["methods"]["graph"]["occluded"]["samples"] == 0
    assert "over the whole recording, which has no gap" in " ".join(capsys.readouterr().out.split())
    assert "over the whole recording, which has no gap" in (tmp_path / "c.html").read_text()


def test_what_cannot_be_compared_is_said_in_a_sentence(ten_seconds: Path, tmp_path: Path, capsys):
    known = read_recording(ten_seconds / "rec.mcap")
    write_recording(replace(known, truth=None), tmp_path / "bare.mcap")
    assert "has no truth: name one with --truth" in refused(capsys, "compare", tmp_path / "bare.mcap")
    rows = "".join(f"{900 + 0.02 * k},0,0,2\n" for k in range(99))
    (tmp_path / "late.csv").write_text("t_s,x,y,z\n" + rows)
    late = ("--truth", tmp_path / "late.csv", "--methods", "graph", "--json", tmp_path / "c.json")
    assert "check that both use the same clock" in refused(capsys, "compare", ten_seconds / "rec.mcap", *late)
    assert not (tmp_path / "c.json").exists()


def call(*arguments: object) -> int:
    return run([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gaps")
    for seed in (1, 2):
        done(
            *("simulate", "arm", "--preset", "azure", "--set", "protocol=random", "--set", "duration_s=20"),
            *("--seed", seed, "-o", folder / f"{seed}.mcap"),
        )
    return folder


def hide(folder: Path, *more: object) -> int:
    files = (folder / "1.mcap", folder / "2.mcap")
    return call("gaps", *files, "--lengths", "0.5", "--processes", 1, "--force", *more)


@pytest.mark.slow
def test_keep_and_apply(folder: Path, capsys: pytest.CaptureFixture[str]):
    kept, figures = folder / "cal.toml", folder / "gaps.json"
    kept.write_text("[imu.base.gyroscope]\n# kept\noffset = [0.0, 0.0, 0.0]\n", encoding="utf-8")
    assert hide(folder, "--keep-in", kept, "--json", figures, "--report", folder / "gaps.html") == 0
    printed = capsys.readouterr().out
    assert "Sigma correction factor" in printed
    assert "Gaps were hidden where the camera saw the arm" in printed
    values = json.loads(figures.read_text())
    assert {row["recording"] for row in values["rows"]} == {"1.mcap", "2.mcap"}
    assert "Gaps were hidden where" in (folder / "gaps.html").read_text(encoding="utf-8")
    table = tomllib.loads(kept.read_text())["sigma"]
    assert "# kept" in kept.read_text() and table["recordings"] == ["1.mcap", "2.mcap"]
    (row,) = table["gaps"]
    assert row["count"] == len(values["rows"]) and row["factor"] >= 1.0

    # the same table with a factor that nobody can overlook
    kept.write_text(kept.read_text().replace(f"factor = {row['factor']}", "factor = 3.0"), encoding="utf-8")
    recording = folder / "1.mcap"
    done("smooth", recording, "-o", folder / "plain.mcap", "--processes", 1, "--draws", 0, "--force")
    assert "was multiplied" not in capsys.readouterr().out
    done(
        *("smooth", recording, "-o", folder / "wide.mcap", "--json", folder / "wide.json"),
        *("--force", "--processes", 1, "--calibration", kept, "--verbose"),
    )
    assert "sigma of positions in gaps was multiplied by 3.00" in capsys.readouterr().out
    (plain,), (wide,) = read_recovery(folder / "plain.mcap"), read_recovery(folder / "wide.mcap")
    np.testing.assert_allclose(wide.position, plain.position, atol=1e-9)
    rows = plain.occluded & np.isfinite(plain.worst_sigma_m)
    np.testing.assert_allclose(wide.worst_sigma_m[rows], 3.0 * plain.worst_sigma_m[rows], rtol=1e-6)
    seen = ~plain.occluded
    np.testing.assert_allclose(wide.worst_sigma_m[seen], plain.worst_sigma_m[seen], rtol=1e-6)
    assert set(wide.estimates.sigma_factors) == {3.0}
    assert set(json.loads((folder / "wide.json").read_text())["figures"]["sigma_factors"]) == {3.0}


ALONE = Config.model_validate({"windows": {"processes": 1}})
#: The contract with users.
PROMISED = {
    *("graph", "rts", "ukf", "gaussian-process", "multirate-kalman", "kalman", "linear-drift"),
    *("gaussian-process-online", "camera-only", "pchip", "hold"),
}


def test_every_promised_method_is_there():
    assert set(METHODS) == PROMISED == set(listed("all", METHODS, "method"))
    assert listed("hold, graph,hold", METHODS, "method") == ["hold", "graph"]


@pytest.mark.slow
@pytest.mark.parametrize("method", sorted(BASELINES))
def test_smooth(ten_seconds: Path, tmp_path: Path, method: str, capsys):
    out, figures_file = tmp_path / "out.mcap", tmp_path / "out.json"
    done(
        *("smooth", ten_seconds / "rec.mcap", "-o", out, "--method", method, "--json", figures_file),
        *("--calibration", ten_seconds / "cal.toml", "--processes", 1),
    )
    assert "every method to compare with is told" in capsys.readouterr().out
    figures = json.loads(figures_file.read_text())
    assert figures["method"] == method
    assert figures["gaps"] and figures["answered"] > 0.9 * figures["samples"]
    (found,) = read_recovery(out)
    assert found.method == method
    inside = np.isfinite(found.position).all(axis=1) & found.occluded
    assert inside.sum() > 10
    done("validate", out, "--truth", ten_seconds / "rec.mcap", "--json", tmp_path / "v.json")
    validation = json.loads((tmp_path / "v.json").read_text())
    # wide of the mark only where a method is: none is off by more than the arm is long
    assert validation["visible"]["position_rms_m"] < 0.08
    assert validation["occluded"]["position_rms_m"] < 0.6
    done("export", out, "--format", "csv", "-o", tmp_path / "out.csv")


@pytest.mark.slow
def test_the_orientation_asked_for_is_used(ten_seconds: Path, tmp_path: Path):
    found = {}
    for orientation in ("vqf", "complementary"):
        out = tmp_path / f"{orientation}.mcap"
        done(
            *("smooth", ten_seconds / "rec.mcap", "-o", out, "--method", "pchip", "--processes", 1),
            *("--orientation", orientation, "--calibration", ten_seconds / "cal.toml"),
        )
        (found[orientation],) = read_recovery(out)
        assert found[orientation].estimates.further["orientation"] == orientation
    dot = np.abs(np.sum(found["vqf"].quaternion * found["complementary"].quaternion, axis=1))
    assert np.degrees(2 * np.arccos(np.clip(np.nanmin(dot), 0, 1))) > 2.0


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[Recording]:
    """Every recording that the graph solves, in order."""
    seen: list[Recording] = []
    original = smoothing.smooth

    def counting(recording: Recording, *arguments: object, **options: object):
        seen.append(recording)
        return original(recording, *arguments, **options)

    monkeypatch.setattr(smoothing, "smooth", counting)
    return seen


@pytest.mark.slow
def test_the_graph_is_solved_once_a_copy_and_sees_nothing_hidden(solved: list[Recording]):
    made = simulate_arm(
        ArmSimulation.preset("white", protocol="random", duration_s=10.0, occlusion_lengths_s=()), seed=7
    )
    names = ["hold", "graph", "camera-only", "pchip", "linear-drift"]
    methods = make_methods(names, made.calibration, ALONE)
    table = evaluate_gaps(made.recording, [0.5, 1.0], methods, gaps_per_run=1)
    assert len(solved) == 2 and len(table.rows) == 2 * len(names)
    for copy, row in zip(solved, table.rows[:: len(names)], strict=True):
        assert copy.truth is None
        hidden = row.gap.contains(copy.arm.t_s)
        assert hidden.any() and np.isnan(copy.arm.joint("wrist")[hidden]).all()


def test_what_the_graph_cannot_solve_fails_once_for_all(solved: list[Recording]):
    made = simulate_arm(ArmSimulation.preset("white", protocol="random", duration_s=5.0), seed=7)
    blind = replace(made.recording, arm=made.recording.arm.hide(np.ones(len(made.recording.arm), dtype=bool)))
    methods = make_methods(["graph", "hold", "pchip"], made.calibration, ALONE)
    for method in methods.values():
        with pytest.raises(SolveError, match="never tracked the forearm"):
            method(blind)
    assert len(solved) == 1


@pytest.mark.slow
def test_side_by_side_gives_the_same_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies of a recording in two processes: the methods, with what they share, go there whole."""
    monkeypatch.setattr(pool, "WORTH_FRAMES", 0)
    made = simulate_arm(
        ArmSimulation.preset("white", protocol="random", duration_s=8.0, occlusion_lengths_s=()), seed=7
    )
    names = ["graph", "linear-drift", "hold"]
    methods = make_methods(names, made.calibration, ALONE)
    tables = [
        evaluate_gaps(made.recording, [0.5, 1.0], methods, gaps_per_run=1, processes=processes)
        for processes in (1, 2)
    ]
    assert len(tables[0].rows) == 2 * len(names)
    for alone, beside in zip(*(table.rows for table in tables), strict=True):
        assert (alone.method, alone.length_s, alone.gap) == (beside.method, beside.length_s, beside.gap)
        assert alone.failure == beside.failure == ""
        # libraries of this process may use several threads and round otherwise: a step of the optimiser
        assert alone.figures.position_rms_m == pytest.approx(beside.figures.position_rms_m, rel=0.05)


@pytest.mark.slow
def test_methods_compared_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """They get the answer that the graph has given here, not one of their own."""
    monkeypatch.setattr(pool, "WORTH_FRAMES", 0)
    made = simulate_arm(ArmSimulation.preset("white", protocol="random", duration_s=8.0), seed=7)
    blind = replace(made.recording, truth=None)
    names = ["linear-drift", "hold", "pchip"]
    methods = make_methods(["graph", *names], made.calibration, ALONE)
    graph = methods["graph"](blind)
    others = {name: methods[name] for name in names}
    assert made.recording.truth is not None
    alone, both = (
        compare(blind, graph, made.recording.truth, others, processes=processes) for processes in (1, 2)
    )
    assert alone.to_dict() == both.to_dict()
    assert sorted(both.methods) == sorted(names)
    restored, given = pickle.loads(pickle.dumps((methods["graph"], blind)))
    with monkeypatch.context() as patch:
        patch.setattr(smoothing, "smooth", lambda *_: pytest.fail("the graph was solved again"))
        assert len(restored(given)) == len(graph)
