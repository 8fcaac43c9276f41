"""Results as recordings of Rerun, read back with Rerun's own reader."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done
from results import made, without_answer

from smoother.cli.run import run
from smoother.errors import UnoccludeError
from smoother.io import write_recovery
from smoother.io.export import prepare_export
from smoother.io.export.rrd import prepare_rrd, rerun_module


@pytest.fixture
def rerun():
    return pytest.importorskip("rerun", reason="rerun-sdk, the extra `view`, is not installed")


def columns(path: Path) -> dict[str, dict[str, list]]:
    """Rows of every entity with times, by path and column."""
    from rerun.chunk import RrdReader

    tables: dict[str, dict[str, list]] = {}
    for chunk in RrdReader(str(path)).stream():
        if chunk.timeline_names:
            batch = chunk.to_record_batch()
            table = tables.setdefault(chunk.entity_path, {})
            for name, values in zip(batch.schema.names, batch.columns, strict=True):
                values = values.cast("int64") if name == "time" else values
                table.setdefault(name.rpartition(":")[2], []).extend(values.to_pylist())
    return tables


def seconds(table: dict[str, list]) -> np.ndarray:
    return 1e-9 * np.array(table["time"])


def test_everything_is_there_and_right(rerun, tmp_path):
    recovery = made("right")
    prepare_rrd([recovery]).write(tmp_path / "a.rrd", False)
    tables = columns(tmp_path / "a.rrd")
    space, curves = "/scene/camera/right", "/curves/wrist_{}/right"
    wanted = {f"{space}/{name}" for name in ("after", "after/joints", "before", "trail", "two_sigma")}
    wanted |= {"/curves/elbow_flexion/right/two_sigma", "/curves/sigma/right"}
    wanted |= {f"{curves.format(axis)}/{line}" for axis in "xyz" for line in ("after", "two_sigma", "camera")}
    assert wanted | {"/gaps/right"} <= set(tables)
    wrist = recovery.joints["wrist"]
    sigma = np.sqrt(np.einsum("nii->ni", recovery.joint_covariance["wrist"]))
    for axis, name in enumerate("xyz"):
        after = np.array(tables[f"{curves.format(name)}/after"]["scalars"])[:, 0]
        band = np.array(tables[f"{curves.format(name)}/two_sigma"]["scalars"])
        np.testing.assert_array_equal(after, wrist[:, axis])
        np.testing.assert_allclose(band[:, 1] - band[:, 0], 4 * sigma[:, axis], atol=1e-12)
        np.testing.assert_allclose(band.mean(axis=1), after, atol=1e-12)
    table = recovery.angles()
    for name, step in (("elbow_flexion", 1), ("shoulder_plane", 3), ("shoulder_elevation", 3)):
        after = np.array(tables[f"/curves/{name}/right/after"]["scalars"])[:, 0]
        band = np.array(tables[f"/curves/{name}/right/two_sigma"]["scalars"])
        angle, sigma_deg = table.values[name][::step], table.sigmas[name][::step]
        assert np.isfinite(after).mean() > 0.9
        known = np.isfinite(after)  # a curve is broken where it passes 180 degrees
        np.testing.assert_allclose(after[known], angle[known], atol=1e-9)
        np.testing.assert_allclose((band[:, 1] - band[:, 0])[known], 4 * sigma_deg[known], atol=1e-9)
    # In space: pictures at about the camera's rate, in single precision, orange where occluded.
    arm = tables[f"{space}/after"]
    t_s = seconds(arm)
    assert 20 <= 1 / np.median(np.diff(t_s)) <= 45
    near = np.abs(recovery.t_s[:, None] - t_s).argmin(axis=0)
    strips = np.array([strip[0] for strip in arm["strips"]])
    for place, joint in enumerate(("shoulder", "elbow", "wrist", "hand")):
        np.testing.assert_allclose(strips[:, place], recovery.joints[joint][near], atol=1e-6)
    red = np.array([color[0] for color in arm["colors"]]) >> 24
    np.testing.assert_array_equal(red > 128, recovery.occluded[near])
    # The ellipsoid: half axes are 2 sigma along the axes of the covariance.
    half = np.array(tables[f"{space}/two_sigma"]["half_sizes"])[:, 0]
    variance = np.linalg.eigvalsh(recovery.joint_covariance["wrist"][near])
    np.testing.assert_allclose(np.sort(half, axis=1), 2 * np.sqrt(variance), rtol=1e-5, atol=1e-7)
    states = [state[0] for state in tables["/gaps/right"]["state"]]
    assert states == ["seen", "occluded"] * len(recovery.gaps) + ["seen"]


def test_without_an_answer(rerun, tmp_path):
    """Nothing is drawn there, and the states say it."""
    recovery = without_answer(made("left"), 9.5, 10.5)
    prepare_rrd([recovery]).write(tmp_path / "a.rrd", False)
    tables = columns(tmp_path / "a.rrd")
    arm = tables["/scene/camera/left/after"]
    t_s = seconds(arm)
    empty = np.array([not strip for strip in arm["strips"]])
    np.testing.assert_array_equal(empty, (t_s > 9.5) & (t_s < 10.5))
    states = [state[0] for state in tables["/gaps/left"]["state"]]
    assert states == ["seen", "occluded", "seen", "occluded", "no answer", "occluded", "seen"]


def test_several_arms_in_one_file(rerun, tmp_path, capsys):
    write_recovery([made("left"), made("right")], tmp_path / "both.mcap")
    done("export", tmp_path / "both.mcap", "--format", "rrd", "-o", tmp_path / "a.rrd")
    assert "a.rrd" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.rrd", "both.mcap"]
    tables = columns(tmp_path / "a.rrd")
    assert {"/scene/camera/left/after", "/scene/camera/right/after"} <= set(tables)
    done("export", tmp_path / "both.mcap", "--format", "rrd", "--side", "left", "-o", tmp_path / "left.rrd")
    assert not any("right" in path for path in columns(tmp_path / "left.rrd"))
    prepare_rrd([made("right"), made("right")]).write(tmp_path / "same.rrd", False)  # two people's right arms
    assert {"/gaps/right_1", "/gaps/right_2"} <= set(columns(tmp_path / "same.rrd"))


def test_a_strap_alone_and_no_gravity(rerun, tmp_path):
    strap = replace(made(strap=True), gravity_direction=np.full(3, np.nan))
    prepare_rrd([strap]).write(tmp_path / "a.rrd", False)
    tables = columns(tmp_path / "a.rrd")
    assert "/curves/imu_x/arm/after" in tables
    assert "/curves/elbow_flexion/arm/after" not in tables


def test_nothing_to_show(rerun, tmp_path):
    nothing = without_answer(made(), -1, 100)
    with pytest.raises(UnoccludeError, match="no answer at any time"):
        prepare_rrd([nothing])
    with pytest.raises(UnoccludeError, match="exists already"):
        (tmp_path / "b.rrd").write_text("mine")
        prepare_rrd([made()]).write(tmp_path / "b.rrd", False)
    assert [path.name for path in tmp_path.iterdir()] == ["b.rrd"]


def test_without_rerun_one_sentence(tmp_path, monkeypatch, capsys):
    write_recovery(made(), tmp_path / "out.mcap")
    monkeypatch.setitem(sys.modules, "rerun", None)  # as if it were not there
    with pytest.raises(UnoccludeError, match=r"pip install '\.\[view\]'"):
        rerun_module()
    with pytest.raises(UnoccludeError, match="rerun-sdk"):
        prepare_export(made(), "rrd")
    for command in (["view"], ["export", "--format", "rrd", "-o", str(tmp_path / "a.rrd")]):
        assert run([command[0], str(tmp_path / "out.mcap"), *command[1:]]) == 1
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert "pip install '.[view]'" in said
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]


def test_what_is_not_trusted_has_a_colour_and_a_state(rerun, tmp_path):
    from smoother.io.export.rrd import packed
    from smoother.io.result.streams import UNTRUSTED
    from smoother.result import Estimates, UntrustedInterval

    body = UntrustedInterval(9.0, 12.0, ("another person's joints",))
    recovery = replace(made("right"), estimates=Estimates(trusted=True, untrusted=(body,)))
    prepare_rrd([recovery]).write(tmp_path / "a.rrd", False)
    tables = columns(tmp_path / "a.rrd")
    states = dict(
        zip(seconds(tables["/gaps/right"]), (s[0] for s in tables["/gaps/right"]["state"]), strict=True)
    )
    assert [at for at, state in states.items() if state == "not to be trusted"] == pytest.approx(
        [9.0], abs=0.02
    )
    arm = tables["/scene/camera/right/after"]
    red = np.array([colour[0] for colour in arm["colors"]]) == packed(UNTRUSTED)
    t_s = seconds(arm)
    np.testing.assert_array_equal(red, (t_s >= 9.0) & (t_s < 12.0))
