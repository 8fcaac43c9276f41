"""Methods against one truth: order, failures, remaining lag, the spread over gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import LEVERS, make_recording, make_recovery, make_truth, path, turn
from hypothesis import given, settings
from hypothesis import strategies as st

from smoother.errors import RecordingError, SolveError
from smoother.evaluation.compare import compare
from smoother.evaluation.gaps import GapErrors, GapRow, GapTable, HiddenGap
from smoother.evaluation.metrics import lag_s
from smoother.recording import Recording, Truth
from smoother.result import Recovery

GAPS = ((4.0, 5.5), (9.0, 11.0), (15.0, 16.0))
LATE_S = 0.030


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Three gaps; the camera is 30 ms late (its clock shows more than the IMU's)."""
    made = make_recording(20.0, offset_s=-LATE_S, noise_m=0.004)
    t = made.arm.t_s
    hidden = np.any([(t > start) & (t < end) for start, end in GAPS], axis=0)
    return replace(made, arm=made.arm.hide(hidden), truth=None)


@pytest.fixture(scope="module")
def truth() -> Truth:
    t = np.arange(0.0, 20.0, 0.01)
    joints = {name: path(t) + turn(t).apply(lever) for name, lever in LEVERS.items()}
    return replace(make_truth(t), joints=joints)


def delayed(recovery: Recovery, late_s: float, only_in_gaps: bool = False) -> Recovery:
    """The recovery, late by so much."""
    t = recovery.t_s - late_s
    moved = path(t) + (recovery.position - path(recovery.t_s))
    if only_in_gaps:
        moved = np.where(recovery.occluded[:, None], moved, recovery.position)
    return replace(recovery, position=moved)


class TestCompare:
    @pytest.fixture(scope="class")
    @staticmethod
    def found(recording, truth):
        def failing(_: Recording) -> Recovery:
            raise SolveError("it had no wish to")

        graph = make_recovery(recording, error_m=0.005, offset_s=-LATE_S)
        methods = {
            "broken": failing,
            "coarse": lambda r: make_recovery(r, error_m=0.05, offset_s=-LATE_S),
            "graph": lambda r: graph,
            "late": lambda r: delayed(graph, 0.040),
            "late in gaps": lambda r: delayed(graph, 0.025, only_in_gaps=True),
        }
        return compare(recording, graph, truth, methods)

    def test_the_best_stands_first_and_a_failure_last(self, found):
        order = list(found.methods)
        errors = list(found.rms_m.values())
        assert order[0] == "graph" and order[-1] == "broken"
        assert errors == sorted(errors)
        assert found.methods["broken"] == "it had no wish to"
        assert any("broken could not recover it" in note for note in found.notes)
        # white noise of 5 mm per axis is 8.7 mm of distance; some 360 samples in the gaps
        assert errors[0] == pytest.approx(0.005 * np.sqrt(3), rel=0.1)

    def test_a_delay_is_found_to_a_few_milliseconds(self, found):
        lag = {name: (each.lag_s, each.lag_occluded_s) for name, each in found.validated.items()}
        assert lag["graph"] == pytest.approx((0.0, 0.0), abs=0.002)
        assert lag["late"] == pytest.approx((0.040, 0.040), abs=0.002)
        assert lag["late in gaps"][1] == pytest.approx(0.025, abs=0.002)
        assert abs(lag["late in gaps"][0]) < 0.01

    def test_the_cameras_own_delay(self, found):
        assert set(found.camera_lag_s) == set(LEVERS)
        for lag in found.camera_lag_s.values():
            assert lag == pytest.approx(LATE_S, abs=0.002)
        plain = found.to_dict()["camera"]
        assert plain["latency_s"] == LATE_S and plain["clock_offset_sigma_s"] == 0.002
        assert "+30.0 +- 2.0 ms late" in found.camera_words

    def test_everything_by_name(self, found):
        plain = found.to_dict()
        assert plain["point"] == "sensor" and plain["alignment"] == "none"
        assert plain["order"][-1] == "broken" and plain["methods"]["broken"] == {
            "failure": "it had no wish to"
        }
        graph = plain["methods"]["graph"]
        assert {"all", "occluded", "visible", "points", "gaps", "lag_s", "lag_occluded_s"} <= set(graph)
        assert set(graph["points"]) == set(LEVERS) and len(graph["gaps"]) == 3
        assert graph["occluded"]["samples"] + graph["visible"]["samples"] == graph["all"]["samples"]

    def test_without_the_sensors_place_the_wrist_is_compared(self, recording, truth):
        of_joints = replace(truth, position=np.full_like(truth.position, np.nan))
        graph = make_recovery(recording, error_m=0.005, offset_s=-LATE_S)
        found = compare(recording, graph, of_joints, {"graph": lambda r: graph})
        assert found.point == "wrist"
        (only,) = found.validated.values()
        assert only.figures_of("wrist", "all").position_rms_m == pytest.approx(0.0087, rel=0.1)
        assert only.lag_s == pytest.approx(0.0, abs=0.002)

    def test_a_truth_that_shares_nothing_is_refused(self, recording, truth):
        graph = make_recovery(recording, offset_s=-LATE_S)
        shoulder = {"shoulder": np.tile([0.0, 0.3, 2.1], (len(truth.t_s), 1))}
        blank = replace(truth, position=np.full_like(truth.position, np.nan), joints=shoulder)
        with pytest.raises(RecordingError, match="no position that the methods answer"):
            compare(recording, graph, blank, {"graph": lambda r: graph})


class TestLagLeft:
    t = np.arange(0.0, 20.0, 0.0125)

    @settings(max_examples=25, deadline=None)
    @given(late=st.floats(-0.3, 0.3))
    def test_between_samples(self, late):
        # straight lines between samples are off by 25 microns at most; the vertex of 2 ms steps by 0.1 ms
        found = lag_s(self.t[200:-200], path(self.t[200:-200] - late), path(self.t), self.t)
        assert found == pytest.approx(late, abs=3e-4)

    def test_shrunk_noisy_and_shifted_samples_keep_their_lag(self):
        rng = np.random.default_rng(3)
        samples = 0.7 * path(self.t - 0.05) + 0.1 + rng.normal(scale=0.02, size=(len(self.t), 3))
        assert lag_s(self.t, samples, path(self.t), self.t) == pytest.approx(0.05, abs=0.005)

    def test_nothing_where_nothing_can_be_told(self):
        known = path(self.t)
        assert lag_s(self.t, np.full_like(known, np.nan), known, self.t) is None
        assert lag_s(self.t, np.zeros_like(known), known, self.t) is None
        assert lag_s(self.t[:10], known[:10], known, self.t) is None
        assert lag_s(self.t, path(self.t - 1.2), known, self.t) is None  # beyond half a second


def test_quartiles_over_gaps_by_length_and_method():
    def row(length: float, method: str, error: float, failure: str = "") -> GapRow:
        errors = GapErrors.of_positions(np.array([[error, 0.0, 0.0]]), np.zeros(1))
        return GapRow(length, method, 0, HiddenGap(1.0, 1.0 + length), errors, failure)

    metres = (0.01, 0.05, np.nan, 0.02, 0.04, 0.03)
    rows = [row(2.0, "b", 0.2), *(row(0.5, "a", each) for each in metres), row(0.5, "a", 0.9, "no answer")]
    table = GapTable((*rows, row(1.0, "c", np.nan)))
    spread = table.lengths[0.5]["a"].spread
    assert (spread["gaps"], spread["failed"], spread["worst_m"]) == (7, 2, 0.05)
    quartiles = [spread[name] for name in ("low_m", "median_m", "high_m")]
    assert quartiles == pytest.approx([0.02, 0.03, 0.04])
    assert spread["rms_m"] == pytest.approx(np.sqrt(np.mean(np.square([0.01, 0.05, 0.02, 0.04, 0.03]))))
    nothing = table.lengths[1.0]["c"].spread
    assert (nothing["median_m"], nothing["rms_m"], nothing["failed"]) == (None, None, 1)
    assert [each["length_s"] for each in table.to_dict()["spread"]] == [0.5, 1.0, 2.0]
