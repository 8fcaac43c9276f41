"""Measures of answers beside those of their references; detectable changes that a user states."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_joint_truth, make_recording, make_recovery, make_truth

from smoother.errors import UnoccludeError
from smoother.evaluation.progress import read_detectable
from smoother.evaluation.validate import validate
from smoother.measures.definitions import zone_key
from smoother.result import Draws

FLEXION = "elbow_flexion_range_deg"


class TestOneRecording:
    def test_the_same_motion_has_the_same_measures(self):
        found = validate(make_recovery(make_recording()), make_joint_truth(np.arange(0, 20, 0.0125)))
        pairs = found.measures
        assert pairs is not None and len(pairs) > 20
        for one in pairs:
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
        for one in found:
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
        flexion = next(one for one in found if one.key == FLEXION)
        assert flexion.low < flexion.high and flexion.inside is True

    def test_a_truth_of_poses_alone_has_none(self):
        found = validate(make_recovery(make_recording()), make_truth(np.arange(0, 20, 0.0125)))
        assert found.measures is None and found.to_dict()["measures"] is None


def test_a_key_of_no_measure_is_refused_with_the_nearest(tmp_path: Path):
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
