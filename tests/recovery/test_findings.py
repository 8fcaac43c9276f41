"""What the program finds costs trust: a finding that contradicts some times distrusts the gaps there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE
from scipy.spatial.transform import Rotation

from smoother.recording import Recording
from smoother.result import Estimates
from smoother.result.verdict import EVER, Finding, UntrustedInterval
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth


@pytest.mark.parametrize(
    ("findings", "trusted", "reasons", "cautions", "untrusted"),
    [
        ([], True, (), (), ()),
        ([Finding("a remark"), Finding("a remark")], True, (), ("a remark",), ()),
        ([Finding("a push", (3.0, 5.0))], True, (), (), (UntrustedInterval(3.0, 5.0, ("a push",)),)),
        ([Finding("no arm", EVER)], False, ("no arm",), (), ()),
    ],
)
def test_one_rule_for_every_finding(findings, trusted, reasons, cautions, untrusted) -> None:
    found = Estimates(trusted=True).with_findings(findings)
    assert (found.trusted, found.reasons, found.cautions) == (trusted, reasons, cautions)
    assert found.untrusted == untrusted


def arm(seed: int, **settings: object) -> tuple[Recording, tuple[float, float]]:
    """An arm of 30 s and the middle of its gaps, s on the IMU's clock."""
    config = ArmSimulation.preset("white", protocol="random", duration_s=30.0, **settings)
    made = simulate_arm(config, seed)
    t_s = made.recording.arm.t_s + made.parameters["clock_offset_s"]
    hidden = np.flatnonzero(np.diff(made.occluded.astype(int)))
    gaps = [(t_s[a + 1], t_s[b]) for a, b in zip(hidden[::2], hidden[1::2], strict=False)]
    gap = min(gaps, key=lambda each: abs(sum(each) - 30.0))
    return replace(made.recording, truth=None), (float(gap[0]), float(gap[1]))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_camera_that_pitches_in_a_gap(seed: int) -> None:
    """12 degrees: off by some 20 cm at the gap; trusted with a question about the camera beside it before."""
    recording, (start_s, end_s) = arm(seed)
    tracks = recording.arm
    turned = tracks.position @ Rotation.from_euler("x", 12.0, degrees=True).as_matrix().T
    late = tracks.t_s > 0.5 * (start_s + end_s)
    moved = replace(tracks, position=np.where(late[:, None, None], turned, tracks.position))
    recovery = smooth(replace(recording, arm=moved), None, ALONE)
    verdicts = [
        each.trusted
        for gap, each in zip(recovery.gaps, recovery.gap_verdicts, strict=True)
        if gap.start_s < end_s and gap.end_s > start_s
    ]
    assert recovery.estimates.trusted is False or not any(verdicts)


def test_sound_ones_stay_trusted() -> None:
    recording, _ = arm(1)
    recovery = smooth(recording, None, ALONE)
    assert recovery.estimates.trusted and all(each.trusted for each in recovery.gap_verdicts)
