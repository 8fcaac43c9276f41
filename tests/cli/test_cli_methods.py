"""Every method through the real commands: `smooth --method`, `gaps --methods`, their options and refusals."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done

from smoother import Config, smoothing
from smoother.baselines.registry import BASELINES
from smoother.cli.options import listed
from smoother.errors import SolveError
from smoother.evaluation.compare import compare
from smoother.evaluation.gaps import evaluate_gaps
from smoother.evaluation.methods import METHODS, make_methods
from smoother.io import read_recovery
from smoother.recording import Recording
from smoother.runtime import pool
from smoother.simulation import ArmSimulation, simulate_arm

ALONE = Config.model_validate({"windows": {"processes": 1}})
#: The contract with users.
PROMISED = {
    "graph",
    "rts",
    "ukf",
    "gaussian-process",
    "multirate-kalman",
    "kalman",
    "linear-drift",
    "camera-only",
    "pchip",
    "hold",
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
    names = ["graph", "linear-drift", "live-now"]
    methods = make_methods(names, made.calibration, ALONE)
    tables = [
        evaluate_gaps(made.recording, [0.5, 1.0], methods, gaps_per_run=1, processes=processes)
        for processes in (1, 2)
    ]
    assert len(tables[0].rows) == 2 * len(names)
    for alone, beside in zip(*(table.rows for table in tables), strict=True):
        assert (alone.method, alone.length_s, alone.gap) == (beside.method, beside.length_s, beside.gap)
        assert alone.failure == beside.failure  # of live-now: too short to calibrate itself
        if not alone.failure:
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
    assert sorted(both.validated) == sorted(names)
    restored, given = pickle.loads(pickle.dumps((methods["graph"], blind)))
    with monkeypatch.context() as patch:
        patch.setattr(smoothing, "smooth", lambda *_: pytest.fail("the graph was solved again"))
        assert len(restored(given)) == len(graph)
