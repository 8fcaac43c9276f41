"""The simple baselines on the recordings of others: BROAD (optical truth), UTD-MHAD (Kinect, wrist IMU)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from scenes import there
from solved_arms import ALONE

from smoother import Recovery
from smoother.baselines.registry import ORIENTATIONS, recover
from smoother.evaluation.gaps import GapTable, evaluate_gaps
from smoother.evaluation.methods import make_methods, shared_graph
from smoother.io import import_broad, import_utd_mhad
from smoother.recording import Recording

pytestmark = pytest.mark.real

SIMPLE = ("graph", "linear-drift", "camera-only", "hold", "pchip")


def moving(name: str) -> Recording:
    """Thirty seconds of a BROAD trial; movement starts after about half a minute."""
    recording = import_broad(there("broad", name))
    imu, frames = recording.imu.t_s, recording.arm.t_s
    return replace(
        recording,
        imu=recording.imu.select((imu >= 40.0) & (imu < 70.0)),
        arm=recording.arm.select((frames >= 40.0) & (frames < 70.0)),
    )


def rms_of(table: GapTable, length_s: float) -> dict[str, float]:
    rms = {}
    for name, result in table.lengths[length_s].items():
        assert result.failed == 0 and result.figures.position_rms_m is not None, name
        rms[name] = result.figures.position_rms_m
    return rms


def test_a_strap_alone():
    """Slow translation, gaps of 1 s; measured 0.5, 7.5, 15, 24 and 11 cm over 80 s of the trial."""
    graph = shared_graph(None, ALONE)

    def baseline(name: str, orientation: str = "vqf") -> Callable[[Recording], Recovery]:
        return lambda copy: recover(copy, graph(copy), name, orientation)

    others = {name: baseline(name) for name in ("camera-only", "hold", "pchip")}
    drifts = {f"linear-drift, {name}": baseline("linear-drift", name) for name in ORIENTATIONS}
    recording = moving("11_undisturbed_slow_translation_B.mat")
    table = evaluate_gaps(recording, [1.0], {"graph": graph, **others, **drifts}, seed=1)
    rms = rms_of(table, 1.0)
    for name in drifts:
        assert 2.0 * rms["graph"] < rms[name] < 0.15
    assert all(rms["graph"] < rms[name] < 0.5 for name in others)


@pytest.mark.parametrize("name", ["a8_s1_t1", "a20_s1_t1"])
def test_a_kinect_and_a_wrist(name: str):
    """Made-up stamps, three seconds long: every method answers, and none is off by an arm's length."""
    recording = import_utd_mhad(
        there("utd_mhad", "Inertial", f"{name}_inertial.mat"),
        there("utd_mhad", "Skeleton", f"{name}_skeleton.mat"),
    )
    rms = rms_of(
        evaluate_gaps(recording, [0.5], make_methods(SIMPLE, None, ALONE), seed=1, margin_s=0.4), 0.5
    )
    assert rms["graph"] < 0.11 and rms["linear-drift"] < 0.20
    assert max(rms.values()) < 0.6
