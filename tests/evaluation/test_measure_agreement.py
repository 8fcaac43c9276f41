"""Measures of answers beside those of their references: which are compared, what is pooled, what is said."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_joint_truth, make_recording, make_recovery, make_truth
from commands import done

from smoother.cli.run import run
from smoother.errors import UnoccludeError
from smoother.evaluation.measure_agreement import (
    MeasureComparison,
    MeasurePair,
    read_detectable,
    read_pairs,
    unique_pairs,
)
from smoother.evaluation.statistics import detectable_change
from smoother.evaluation.validate import validate
from smoother.measures.definitions import zone_key
from smoother.result import Draws
from smoother.runtime.printable import plain

FLEXION = "elbow_flexion_range_deg"


def pair(recording: str, value: float, reference: float, **more: object) -> MeasurePair:
    about = {"side": "right", "key": FLEXION, "name": "elbow", "unit": "deg"}
    numbers = {"low": value - 4, "high": value + 4, "recovered_share": 0.1}
    return MeasurePair(recording=recording, value=value, reference=reference, **(about | numbers | more))


class TestOneRecording:
    def test_the_same_motion_has_the_same_measures(self):
        found = validate(make_recovery(make_recording()), make_joint_truth(np.arange(0, 20, 0.0125))).measures
        assert found is not None and len(found.pairs) > 20
        for one in found.pairs:
            if one.key.startswith(("elbow_flexion", "hand_path_length", "sparc", "shoulder_elevation_range")):
                assert one.value == pytest.approx(one.reference, rel=1e-3, abs=1e-3), one.key
        assert any("no draws" in note for note in found.notes)

    def test_samples_without_truth_are_in_neither(self):
        truth = make_joint_truth(np.arange(0, 20, 0.0125))
        bent = (truth.t_s > 5) & (truth.t_s < 12)
        wrong = {name: np.where(bent[:, None], np.nan, place) for name, place in truth.joints.items()}
        recovery = make_recovery(make_recording())
        strange = bent[:, None] & np.array([True, False, False])  # the answer errs where there is no truth
        joints = {
            name: place + 0.4 * strange * np.sin(9 * truth.t_s)[:, None] if name == "wrist" else place
            for name, place in recovery.joints.items()
        }
        found = validate(replace(recovery, joints=joints), replace(truth, joints=wrong)).measures
        assert found is not None
        for one in found.pairs:
            if one.key == FLEXION:
                assert one.value == pytest.approx(one.reference, abs=0.1)

    def test_intervals_come_of_the_draws(self):
        recovery = make_recovery(make_recording())
        t = recovery.t_s[::10]
        rng = np.random.default_rng(0)
        slow = 0.01 * rng.normal(size=(30, 1, 3)) * np.ones((1, len(t), 1))
        draws = Draws(t, 0, slow, np.zeros_like(slow), {"wrist": slow, "hand": slow})
        found = validate(replace(recovery, draws=draws), make_joint_truth(np.arange(0, 20, 0.0125))).measures
        assert found is not None
        flexion = next(one for one in found.pairs if one.key == FLEXION)
        assert flexion.low < flexion.high and flexion.inside is True

    def test_a_truth_of_poses_alone_has_none(self):
        found = validate(make_recovery(make_recording()), make_truth(np.arange(0, 20, 0.0125)))
        assert found.measures is None and found.to_dict()["measures"] is None


class TestManyRecordings:
    @pytest.fixture
    def comparison(self) -> MeasureComparison:
        rng = np.random.default_rng(0)
        true = rng.normal(90, 15, 12)
        pairs = [pair(f"r{n}", value + 1 + rng.normal(0, 2), value) for n, value in enumerate(true)]
        return MeasureComparison(tuple(pairs[8:]), tuple(pairs[:8]))

    def test_agreement_over_all_of_them(self, comparison: MeasureComparison):
        found = comparison.agreements[FLEXION]
        differences = np.array([one.difference for one in comparison.together])
        assert (found["pairs"], found["recordings"], found["intervals"]) == (12, 12, 12)
        assert found["bias"] == pytest.approx(differences.mean())
        assert found["mdc95"] == pytest.approx(detectable_change(differences.std(ddof=1)))
        assert 0.9 < found["icc"] < 1
        assert found["inside"] == sum(abs(differences) <= 4)

    def test_what_is_written_is_read_again(self, comparison: MeasureComparison, tmp_path: Path):
        file = tmp_path / "v.json"
        file.write_text(json.dumps(plain({"measures": comparison.to_dict()})))
        assert unique_pairs([*read_pairs(file), *comparison.together]) == comparison.together
        found = comparison.agreements[FLEXION]
        assert read_detectable(file) == {FLEXION: pytest.approx(found["mdc95"])}

    def test_the_arm_with_the_most_pairs_states_the_detectable_change(self, tmp_path: Path):
        def arm(mdc95: float | None, pairs: int) -> dict:
            session = {FLEXION: {"mdc95": mdc95, "pairs": pairs}}
            return {"measures": {"agreement": {"session": session}, "pairs": []}}

        file = tmp_path / "v.json"
        file.write_text(json.dumps({"arms": [arm(2.0, 3), arm(5.0, 6), arm(None, 9)]}))
        assert read_detectable(file) == {FLEXION: 5.0}

    def test_a_key_of_no_measure_is_refused_with_the_nearest(self, tmp_path: Path):
        file = tmp_path / "mdc.toml"
        keys = (FLEXION, "hand_peak_speed_m_s", f"{FLEXION}_symmetry_percent")
        keys += (zone_key("elbow_flexion", 30, 10), zone_key("pronation", -90, 10))
        file.write_text("[mdc95]\n" + "".join(f"{key} = 6\n" for key in keys))
        assert set(read_detectable(file)) == set(keys)
        wrong = "elbow_flexion_rang_deg", "elbow_flexion_zone_30_to_x_percent", "elbow_zone_0_to_9_percent"
        for key in wrong:
            file.write_text(f"[mdc95]\n{FLEXION} = 6\n{key} = 6\n")
            with pytest.raises(UnoccludeError, match=f"no measure {key}.*the nearest is "):
                read_detectable(file)
        file.write_text("[mdc95]\nelbow_flexion_rang_deg = 6\n")
        with pytest.raises(UnoccludeError, match=f"the nearest is {FLEXION}$"):
            read_detectable(file)


def test_values_that_are_not_finite_survive_the_file(tmp_path: Path):
    file = tmp_path / "v.json"
    one = pair("r", 90.0, 91.0, low=math.nan, high=math.nan)
    file.write_text(json.dumps(plain({"measures": {"pairs": [one.to_dict()]}})))
    (again,) = read_pairs(file)
    assert math.isnan(again.low) and again.inside is None and again.identity == one.identity


class TestCommand:
    @pytest.fixture(scope="class")
    @staticmethod
    def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
        """A simulated arm, recovered with a few draws."""
        where = tmp_path_factory.mktemp("validated")
        short = ("--set", "protocol=random", "--set", "duration_s=8")
        done("simulate", "arm", *short, "--seed", 4, "-o", where / "a.mcap")
        done("smooth", where / "a.mcap", "-o", where / "out.mcap", "--draws", 20, "--processes", 1)
        return where

    def command(self, folder: Path, *more: object) -> int:
        return run(["validate", *map(str, (folder / "out.mcap", "--truth", folder / "a.mcap", *more))])

    def test_pooled_files_state_the_agreement(self, folder: Path, tmp_path: Path, capsys):
        earlier = [pair(f"r{n}", 90.0 + 10 * n + n % 2, 90.0 + 10 * n) for n in range(4)]
        pairs = plain({"measures": {"pairs": [one.to_dict() for one in earlier]}})
        (tmp_path / "old.json").write_text(json.dumps(pairs))
        files = ("--json", tmp_path / "v.json", "--report", tmp_path / "v.html")
        assert self.command(folder, "--pool", tmp_path / "old.json", *files) == 0
        assert "Agreement of the measures" in capsys.readouterr().out
        found = json.loads((tmp_path / "v.json").read_text())["measures"]["agreement"]["session"][FLEXION]
        assert found["pairs"] == 5 and found["mdc95"] > 0
        assert found["icc_low"] < found["icc"] < found["icc_high"]
        assert "How well the measures agree" in (tmp_path / "v.html").read_text(encoding="utf-8")
        # the same recording again, with a file that holds it already
        again = ("--pool", tmp_path / "v.json", "--pool", tmp_path / "old.json")
        assert self.command(folder, *again, "--json", tmp_path / "w.json") == 0
        again_found = json.loads((tmp_path / "w.json").read_text())["measures"]["agreement"]["session"]
        assert again_found[FLEXION] == found
        assert read_detectable(tmp_path / "w.json")[FLEXION] == found["mdc95"]
