"""A truth of poses that cannot be this recording's, or not as it is given: one sentence says which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery, path, turn
from scipy.spatial.transform import Rotation

from smoother.evaluation.compare import compare
from smoother.evaluation.mocap.motion import _exchanged
from smoother.evaluation.truth import truth_notes
from smoother.evaluation.validate import validate
from smoother.recording import Truth

T = np.arange(0, 60.0, 0.01)


def warped(t: np.ndarray) -> np.ndarray:
    """Movements that each begin up to a second earlier or later, so that no two have one rhythm."""
    return t + 1.0 * np.sin(1.7 * t)


def truth_of(t: np.ndarray, at: np.ndarray) -> Truth:
    quaternion = turn(at).as_quat(scalar_first=True)
    return Truth(t, path(at), quaternion, np.ones(len(t), dtype=bool))


@pytest.fixture(scope="module")
def truth() -> Truth:
    return truth_of(T, warped(T))


@pytest.fixture(scope="module")
def recovery(truth):
    recovery = make_recovery(make_recording(60.0, truth=False))
    at = warped(recovery.t_s)
    noise = np.random.default_rng(0).normal(size=(len(at), 3)) * 0.004
    return replace(recovery, position=path(at) + noise, quaternion=turn(at).as_quat(scalar_first=True))


def test_a_right_truth_needs_no_word(recovery, truth):
    assert truth_notes(recovery, truth) == []
    late = replace(truth, t_s=truth.t_s + 0.2)  # a lag that is stated as one
    assert truth_notes(recovery, late) == []
    rest, level = np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0, 0.0])
    still = replace(
        recovery, position=0 * recovery.position + rest, quaternion=0 * recovery.quaternion + level
    )
    assert truth_notes(still, replace(truth, position=0 * truth.position + rest)) == []


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres")])
def test_another_unit(recovery, truth, factor, unit):
    wrong = replace(truth, position=factor * truth.position)
    for aligned in (False, True):
        (note,) = truth_notes(recovery, wrong, aligned)
        assert f"they look like {unit}; metres are needed" in note


def test_another_recording_or_clock(recovery, truth):
    for wrong in (truth_of(T, T * 1.3), replace(truth, t_s=truth.t_s + 1.5)):
        (note,) = truth_notes(recovery, wrong)
        assert "of another recording, or its clock is elsewhere; try --align" in note
        without = replace(wrong, quaternion=np.full_like(wrong.quaternion, np.nan))
        assert "another recording" in truth_notes(recovery, without)[0]
    assert truth_notes(recovery, truth_of(T, T * 1.3), aligned=True) == []


def test_another_order_of_the_quaternion(recovery, truth):
    tilted = Rotation.from_euler("xyz", [0.4, 1.9, 0.8])
    mine = Rotation.from_quat(recovery.quaternion, scalar_first=True) * tilted
    other = Rotation.from_quat(truth.quaternion, scalar_first=True) * tilted
    recovery = replace(recovery, quaternion=mine.as_quat(scalar_first=True))
    assert truth_notes(recovery, replace(truth, quaternion=other.as_quat(scalar_first=True))) == []
    (note,) = truth_notes(recovery, replace(truth, quaternion=other.as_quat(scalar_first=False)))
    assert "fits as qx, qy, qz, qw" in note


def test_other_axes(recovery, truth):
    turned = Rotation.from_quat(truth.quaternion, scalar_first=True) * Rotation.from_euler("z", 90, True)
    (note,) = truth_notes(recovery, replace(truth, quaternion=turned.as_quat(scalar_first=True)))
    assert "90 degrees (median) off by a constant turn: is the order qw, qx, qy, qz" in note
    (note,) = truth_notes(recovery, replace(truth, position=truth.position + np.array([1.0, 0, 0])))
    assert "lies 1.00 m (median) from it" in note and "--align" in note


def test_the_notes_stand_among_those_of_validate_and_compare(recovery, truth):
    wrong = replace(truth, position=1000 * truth.position)
    assert any("millimetres" in note for note in validate(recovery, wrong).to_dict()["notes"])
    recording = make_recording(60.0, truth=False)
    comparison = compare(recording, recovery, wrong, {"graph": lambda _: recovery})
    assert sum("millimetres" in note for note in comparison.to_dict()["notes"]) == 1


def test_markers_of_elbow_and_wrist_exchanged():
    """An elbow that bends between a still shoulder and a forearm of 25 cm."""
    bend = 1.0 + 0.8 * np.sin(T)
    elbow = np.tile([0.0, -0.3, 2.0], (len(T), 1))
    along = np.column_stack([np.sin(bend), -np.cos(bend), 0 * T])
    joints = {"shoulder": elbow + np.array([0, 0.3, 0]), "elbow": elbow, "wrist": elbow + 0.25 * along}
    swapped = {**joints, "elbow": joints["wrist"], "wrist": joints["elbow"]}
    hand = {"hand": elbow + 0.33 * along}
    assert _exchanged(joints) == _exchanged(joints | hand) == []
    (note,) = _exchanged(swapped)
    assert "exchanged" in note and "the upper arm's length changes by" in note
    (note,) = _exchanged({**swapped, **hand})
    assert "the hand is 8 cm from the elbow and 33 cm from the wrist" in note
    assert _exchanged({"wrist": joints["elbow"]}) == []
