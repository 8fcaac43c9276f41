"""A mirrored skeleton is named, and a gap that the visible motion leaves ambiguous is not trusted."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from arms import make_recording, make_recovery
from scenes import ALONE

from smoother import smooth
from smoother.measurements.remedy import Remedy
from smoother.recording import CameraFrame, Recording
from smoother.recovery import ambiguity
from smoother.recovery.ambiguity import with_ambiguities
from smoother.recovery.explanations import Explanation
from smoother.recovery.trust import with_gap_verdicts
from smoother.result import Recovery
from tools.reliability.cases import mirrored_in_one_plane
from tools.reliability.judging import Trial, trial_of
from tools.reliability.scene import draw_scene

#: When the wrist is hidden, s.
GAP_S = (8.0, 10.0)


@pytest.fixture(scope="module")
def in_one_plane() -> Trial:
    """An arm that the camera sees in one upright plane, and that moves freely where it does not."""
    return trial_of(mirrored_in_one_plane(draw_scene("in one plane", 24.0, [5, 0])))


def test_a_mirrored_skeleton_is_named_though_it_fits(in_one_plane: Trial) -> None:
    recording = replace(in_one_plane.recording, truth=None)
    mirrored = smooth(recording, None, ALONE)
    assert mirrored.estimates.trusted is False
    assert mirrored.estimates.reasons[0].startswith("the skeleton seems mirrored (x)")
    assert "--mirror x" in mirrored.estimates.remedies
    mended = smooth(Remedy(mirror="x").applied(recording), None, ALONE)
    assert mended.estimates.trusted and not any(
        "mirrored" in reason for each in mended.estimates.untrusted for reason in each.reasons
    )


@pytest.fixture
def recovery() -> tuple[Recording, Recovery]:
    """A path made by hand, which bends to all sides; hidden for two seconds."""
    recording = make_recording(20.0, noise_m=0.0)
    hidden = (recording.arm.t_s > GAP_S[0]) & (recording.arm.t_s < GAP_S[1])
    recording = replace(
        recording,
        arm=recording.arm.hide(hidden, ("elbow", "wrist", "hand")),
        camera_frame=CameraFrame.KINECT,
    )
    recovery = make_recovery(recording)
    estimates = replace(recovery.estimates, trusted=True)
    return recording, replace(recovery, estimates=estimates)


def explained(monkeypatch: pytest.MonkeyPatch, *others: Explanation) -> None:
    """Let these be the other explanations."""
    along = np.array([0.0, 1.0, 0.0])
    own = Explanation(np.eye(3), along, 0.0)
    monkeypatch.setattr(ambiguity, "explanations", lambda *args: (own, others))


def mirror(normal: list[float], cost: float) -> Explanation:
    """The mirror image at a plane."""
    across = np.array(normal) / np.linalg.norm(normal)
    Q_K = np.eye(3) - 2.0 * np.outer(across, across)
    return Explanation(Q_K, np.array([0.0, 1.0, 0.0]), cost)


def test_a_gap_that_another_explanation_contradicts(
    monkeypatch: pytest.MonkeyPatch, recovery: tuple[Recording, Recovery]
) -> None:
    recording, answer = recovery
    explained(monkeypatch, mirror([1.0, 0.0, 0.0], cost=3.0))
    ambiguous = with_ambiguities(answer, recording, [])
    (gap,) = ambiguous.estimates.untrusted
    assert (gap.start_s, gap.end_s) == pytest.approx(GAP_S, abs=0.1)
    assert "a mirrored skeleton fits the visible motion about as well" in gap.reasons[0]
    assert gap.reasons[0].endswith("run again with --mirror x")
    # the only gap: nothing is left to trust
    judged = with_gap_verdicts(ambiguous).estimates
    assert judged.trusted is False and judged.reasons == gap.reasons and judged.remedies == ()


@pytest.mark.parametrize(
    ("other", "trusted"),
    [
        (mirror([1.0, 0.0, 0.0], cost=-20.0), False),  # the mirrored skeleton fits clearly better
        (mirror([1.0, 0.0, 0.0], cost=30.0), True),  # it does not fit; `explanations` leaves it out
    ],
)
def test_what_fits_clearly_better_is_the_cause(
    monkeypatch: pytest.MonkeyPatch, recovery: tuple[Recording, Recovery], other: Explanation, trusted: bool
) -> None:
    recording, answer = recovery
    explained(monkeypatch, *([] if trusted else [other]))
    judged = with_ambiguities(answer, recording, []).estimates
    assert judged.trusted is trusted and not judged.untrusted
    assert judged.remedies == (() if trusted else ("--mirror x", "--negate accelerometer"))
    if not trusted:
        undone = replace(recording, applied_fixes=("--mirror x",))
        again = with_ambiguities(answer, undone, []).estimates
        assert again.remedies == () and again.cause is not None
        assert again.cause.endswith("run again without --mirror x")


def test_another_mounting(monkeypatch: pytest.MonkeyPatch, recovery: tuple[Recording, Recovery]) -> None:
    recording, answer = recovery
    turned = Explanation(np.eye(3), np.array([np.sin(0.6), np.cos(0.6), 0.0]), 2.0)
    explained(monkeypatch, turned)
    (gap,) = with_ambiguities(answer, recording, []).estimates.untrusted
    assert gap.reasons[0].startswith("a mounting of the sensor that is 34 degrees off fits")
    # less likely than a mounting may be, and one that differs by less than sigma states
    explained(monkeypatch, replace(turned, cost=6.0))
    assert with_ambiguities(answer, recording, []).estimates.trusted
    explained(monkeypatch, turned)
    unsure = replace(answer, pose_covariance=answer.pose_covariance * 2000.0)
    assert with_ambiguities(unsure, recording, []).estimates.trusted


def test_what_is_not_trusted_already(
    monkeypatch: pytest.MonkeyPatch, recovery: tuple[Recording, Recovery]
) -> None:
    """A mirror that fits is its cause; one that fits badly, or as well as the answer, is not."""
    recording, answer = recovery
    distrusted = replace(answer, estimates=replace(answer.estimates, trusted=False, reasons=("why",)))
    mirrored = mirror([1.0, 0.0, 0.0], cost=-20.0)
    explained(monkeypatch, mirrored)
    named = with_ambiguities(distrusted, recording, []).estimates
    assert named.cause == named.reasons[0] != "why" and named.reasons[1:] == ("why",)
    for unfit in (replace(mirrored, direction_rad=0.5), replace(mirrored, cost=0.0)):
        explained(monkeypatch, unfit)
        assert with_ambiguities(distrusted, recording, []) is distrusted
