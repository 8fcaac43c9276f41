"""Hidden gaps: where they fall, that nothing leaks, what is scored; stated uncertainty against error."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery, make_truth, turn
from scipy.stats import chi2

from calib.sigma_factor import (
    ENOUGH_GAPS,
    LEVELS,
    factor_sentences,
    hierarchical_quantile,
    length_factors,
    needed_factors,
)
from smoother.array_types import FloatArray
from smoother.calibration import LeverArm
from smoother.errors import RecordingError, SolveError
from smoother.evaluation.gaps import (
    GapErrors,
    GapRow,
    GapTable,
    HiddenGap,
    evaluate_gaps,
    place_gaps,
    pooled,
    score_gap,
    strap_position,
    visible_runs,
)
from smoother.evaluation.summary import camera_inside_95
from smoother.recording import FOREARM_JOINTS, JOINTS, JointState, Recording
from smoother.result import Estimates


def place(recording: Recording, length_s: float, seed: int = 0, count: int = 6, **options):
    return place_gaps(recording, length_s, np.random.default_rng(seed), count=count, **options)


@pytest.mark.parametrize("length_s", [0.5, 1.0, 2.0, 3.0])
def test_gaps_keep_their_distance(length_s):
    recording = make_recording(60.0)
    gaps = place(recording, length_s)
    assert len(gaps) >= 4
    frames = recording.arm.t_s
    for gap in gaps:
        assert gap.length_s == pytest.approx(length_s, abs=0.02)
        assert gap.start_s in frames
        assert gap.end_s in frames
        assert gap.start_s >= frames[0] + 1.5
        assert gap.end_s <= frames[-1] - 1.5 + 0.02
    for a, b in itertools.pairwise(gaps):
        assert b.start_s - a.end_s >= 3.0 - 0.02


def test_occlusions_and_imu_pauses_are_kept_clear_of():
    recording = make_recording(60.0)
    t = recording.arm.t_s
    arm = recording.arm.hide((t > 20) & (t < 24))
    imu = recording.imu.select((recording.imu.t_s < 40) | (recording.imu.t_s > 41))
    recording = replace(recording, arm=arm, imu=imu)
    assert len(visible_runs(recording)) == 3
    for seed in range(5):
        for gap in place(recording, 1.0, seed=seed):
            for start, end in ((20, 24), (40, 41)):
                assert gap.end_s + 1.5 <= start + 0.05 or gap.start_s - 1.5 >= end - 0.05


def test_one_joint_alone_is_no_sight_of_the_forearm():
    recording = make_recording(30.0)
    t = recording.arm.t_s
    state = recording.arm.state.copy()
    for joint in ("elbow", "hand"):
        state[t > 12, JOINTS.index(joint)] = JointState.INFERRED
    recording = replace(recording, arm=replace(recording.arm, state=state))
    assert visible_runs(recording)[-1][1] <= 12.0


def test_a_strap_alone_is():
    recording = make_recording(30.0)
    arm = recording.arm.hide(np.ones(len(recording.arm), bool))
    arm.position[:, JOINTS.index("strap")] = [0, 0, 2.0]
    arm.state[:, JOINTS.index("strap")] = JointState.TRACKED
    assert len(place(replace(recording, arm=arm), 1.0)) >= 2


def test_short_recording_gets_one_gap_in_the_middle():
    recording = make_recording(2.2, truth=False)
    (gap,) = place(recording, 1.0)
    middle = 0.5 * (recording.arm.t_s[0] + recording.arm.t_s[-1])
    assert 0.5 * (gap.start_s + gap.end_s) == pytest.approx(middle, abs=0.04)
    assert place(recording, 1.5) == []


def test_unscored_stretches_are_avoided():
    recording = make_recording(60.0)
    truth = make_truth(np.arange(0, 60, 0.01))
    recording = replace(recording, truth=replace(truth, score=truth.t_s < 30))
    for seed in range(3):
        for gap in place(recording, 2.0, seed=seed):
            assert gap.start_s <= 29.05


def test_nothing_hidden_reaches_the_method():
    recording = make_recording(40.0)
    seen: list[Recording] = []

    def method(copy: Recording):
        seen.append(copy)
        return make_recovery(copy)

    table = evaluate_gaps(recording, [1.0], {"graph": method}, gaps_per_run=3)
    (copy,) = seen
    assert copy.truth is None
    hidden = np.zeros(len(copy.arm), bool)
    for row in table.rows:
        hidden |= row.gap.contains(copy.arm.t_s)
    assert hidden.sum() == pytest.approx(3 * 29, abs=3)
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    assert np.isnan(copy.arm.position[hidden][:, forearm]).all()
    assert (copy.arm.state[hidden][:, forearm] == JointState.NOT_TRACKED).all()
    assert (copy.arm.state[:, JOINTS.index("shoulder")] == JointState.TRACKED).all()
    np.testing.assert_array_equal(copy.arm.position[~hidden], recording.arm.position[~hidden])
    assert np.isfinite(recording.arm.position[hidden][:, forearm[:3]]).all()  # the recording is whole


def test_against_truth():
    recording = make_recording(60.0)
    table = evaluate_gaps(
        recording,
        [0.5, 2.0],
        {"good": lambda copy: make_recovery(copy), "poor": lambda copy: make_recovery(copy, error_m=0.03)},
        repetitions=2,
    ).to_dict()
    assert [entry["length_s"] for entry in table["lengths"]] == [0.5, 2.0]
    for entry in table["lengths"]:
        good, poor = entry["methods"]["good"], entry["methods"]["poor"]
        assert {"rms_m", "median_m", "p95_m", "max_m", "nees", "gaps", "samples", "rms_cm"} <= set(good)
        assert good["rms_m"] < 1e-5
        assert poor["rms_m"] == pytest.approx(0.03 * np.sqrt(3), rel=0.1)
        assert poor["rms_cm"] == pytest.approx(100 * poor["rms_m"])
        assert poor["nees"] == pytest.approx(9.0, rel=0.2)
        assert good["gaps"] == poor["gaps"] >= 8
        assert good["orientation_rms_deg"] < 0.01
    rows = table["rows"]
    assert {row["reference"] for row in rows} == {"truth"}
    assert rows[0]["start_s"] == next(row for row in rows if row["method"] == "poor")["start_s"]


@pytest.mark.parametrize("offset_s", [0.0, 0.06])
def test_against_the_camera_with_its_clock_offset(offset_s):
    recording = make_recording(40.0, offset_s=offset_s, noise_m=0.005, truth=False)

    def method(copy: Recording):
        return make_recovery(copy, offset_s=offset_s, sigma_m=1e-4)

    table = evaluate_gaps(recording, [1.0], {"graph": method})
    figures = table.lengths[1.0]["graph"].figures
    assert table.reference == "wrist"
    assert figures.position_rms_m == pytest.approx(0.005 * np.sqrt(3), rel=0.15)
    assert figures.samples == pytest.approx(29 * len(table.rows), abs=8)
    assert 0.2 < figures.nees < 1.0  # the residuals say 8 mm, so the camera's noise is in the covariance
    wrong = evaluate_gaps(recording, [1.0], {"graph": lambda copy: make_recovery(copy, offset_s=0.3)})
    assert wrong.lengths[1.0]["graph"].figures.position_rms_m > 0.02


def drifting_clock(truth: bool) -> tuple[Recording, Recording]:
    """An arm, and it with a camera's clock that loses 0.2 s in 40 s: 0.1 s off the mean at its ends."""
    even = make_recording(40.0, noise_m=0.005, truth=truth)
    return even, replace(even, arm=replace(even.arm, t_s=even.arm.t_s * (1 - 5e-3)))


def recovered_with_drift(copy: Recording, even: Recording):
    recovery = make_recovery(replace(copy, arm=replace(copy.arm, t_s=even.arm.t_s)), sigma_m=1e-4)
    return replace(recovery, clock_offset_s=float(np.mean(even.arm.t_s - copy.arm.t_s)))


def test_a_clock_that_drifts_costs_hidden_frames_nothing():
    even, drifting = drifting_clock(truth=False)
    table = evaluate_gaps(drifting, [1.0], {"graph": lambda copy: recovered_with_drift(copy, even)})
    figures = table.lengths[1.0]["graph"].figures
    assert figures.position_rms_m == pytest.approx(0.005 * np.sqrt(3), rel=0.15)  # the camera's noise


def test_a_clock_that_drifts_moves_no_gap_against_the_truth():
    """The answer is wrong in the hidden seconds alone: every sample that is scored has to show it."""
    even, drifting = drifting_clock(truth=True)

    def wrong_where_hidden(copy: Recording):
        recovery = recovered_with_drift(copy, even)
        hidden = ~copy.arm.tracked("wrist")
        nearest = np.abs(recovery.t_s[:, None] - even.arm.t_s).argmin(axis=1)
        return replace(recovery, position=recovery.position + 0.05 * hidden[nearest, None])

    table = evaluate_gaps(drifting, [1.0], {"graph": wrong_where_hidden})
    for row in table.rows:
        errors = row.errors
        # half a frame at either end belongs to the visible frame beside the gap
        inner = errors.distance_m[4:-4]
        assert len(inner) > 50
        np.testing.assert_allclose(inner, 0.05 * np.sqrt(3), rtol=1e-3)


def test_a_method_that_fails_is_a_row():
    recording = make_recording(30.0)

    def broken(copy: Recording):
        raise SolveError("the motion is not determined")

    def silent(copy: Recording):
        recovery = make_recovery(copy)
        return replace(recovery, position=np.full_like(recovery.position, np.nan))

    methods = {"broken": broken, "silent": silent, "good": make_recovery}
    table = evaluate_gaps(recording, [1.0], methods)
    failed = {name: group.counts["failed"] for name, group in table.lengths[1.0].items()}
    count = len(table.lengths[1.0]["good"].rows)
    assert failed == {"broken": count, "silent": count, "good": 0}
    assert table.lengths[1.0]["broken"].figures.position_rms_m is None
    assert table.lengths[1.0]["silent"].figures.unanswered > 0
    assert any("not determined" in note for note in table.notes)


def test_no_room_is_a_sentence():
    with pytest.raises(RecordingError, match="long enough to hide a gap of 5 s"):
        evaluate_gaps(make_recording(4.0), [5.0], {"graph": make_recovery})
    table = evaluate_gaps(make_recording(8.0), [1.0, 20.0], {"graph": make_recovery})
    assert list(table.lengths) == [1.0]
    assert any("20 s" in note for note in table.notes)


def errors(*metres: float) -> GapErrors:
    """Samples with these errors; nan where there is no answer."""
    distance = np.array(metres)
    more = {"scored": np.ones(len(metres), bool), "needed_factors": np.full((len(metres), len(LEVELS)), 1.5)}
    along_x = distance[:, None] * [1.0, 0.0, 0.0]
    return GapErrors.of_positions(along_x, (distance / 0.01) ** 2, **more, reference="truth")


def row(length_s: float, method: str, of: GapErrors, recording: str = "a", failure: str = "") -> GapRow:
    gap = HiddenGap(5.0, 5.0 + length_s)
    return GapRow(length_s, method, 0, gap, of, failure, recording)


def table(recording: str, *entries: tuple[float, str, GapErrors], notes: tuple[str, ...] = ()) -> GapTable:
    return GapTable(tuple(row(length, method, of, recording) for length, method, of in entries), notes)


FIRST = table(
    "a",
    (1.0, "graph", errors(0.01, 0.03)),
    (1.0, "hold", errors(0.2)),
    (2.0, "graph", errors(0.04)),
    notes=("once",),
)
SECOND = table("b", (1.0, "graph", errors(0.05)), (2.0, "graph", errors(np.nan)), notes=("once", "twice"))


def test_samples_count_not_gaps() -> None:
    both = pooled([FIRST, SECOND])
    figures = both.lengths[1.0]["graph"]
    assert figures.counts | {"samples": figures.figures.samples} == {"gaps": 2, "failed": 0, "samples": 3}
    assert figures.figures.position_rms_m == pytest.approx(np.sqrt((0.01**2 + 0.03**2 + 0.05**2) / 3))
    assert figures.figures.position_max_m == pytest.approx(0.05)
    assert len(both.lengths[1.0]["hold"].rows) == 1
    # what is not answered is counted, and spoils no figure
    assert both.lengths[2.0]["graph"].figures.unanswered == 1
    assert both.lengths[2.0]["graph"].figures.position_rms_m == pytest.approx(0.04)


def test_a_failed_gap_is_counted() -> None:
    of = errors(np.nan, np.nan)
    failed = GapTable((row(1.0, "graph", of, failure="no answer inside the gap"),))
    entry = failed.to_dict()["lengths"][0]["methods"]["graph"]
    assert (entry["gaps"], entry["failed"], entry["unanswered"], entry["rms_m"]) == (1, 1, 2, None)
    assert entry["rms_cm"] is None


def test_sigma_factors_are_of_one_method() -> None:
    assert [factor.length_s for factor in FIRST.sigma_factors()] == [1.0, 2.0]
    assert [factor.length_s for factor in FIRST.sigma_factors("hold")] == [1.0]
    assert FIRST.sigma_factors("nothing") == ()


def test_quartiles_over_gaps_by_length_and_method():
    metres = (0.01, 0.05, np.nan, 0.02, 0.04, 0.03)
    rows = [
        row(2.0, "b", errors(0.2)),
        *(row(0.5, "a", errors(each)) for each in metres),
        row(0.5, "a", errors(0.9), failure="no answer"),
    ]
    table = GapTable((*rows, row(1.0, "c", errors(np.nan))))
    spread = table.lengths[0.5]["a"].spread
    assert (spread["gaps"], spread["failed"], spread["worst_m"]) == (7, 2, 0.05)
    quartiles = [spread[name] for name in ("low_m", "median_m", "high_m")]
    assert quartiles == pytest.approx([0.02, 0.03, 0.04])
    assert spread["rms_m"] == pytest.approx(np.sqrt(np.mean(np.square([0.01, 0.05, 0.02, 0.04, 0.03]))))
    nothing = table.lengths[1.0]["c"].spread
    assert (nothing["median_m"], nothing["rms_m"], nothing["failed"]) == (None, None, 1)
    assert [each["length_s"] for each in table.to_dict()["spread"]] == [0.5, 1.0, 2.0]


LEVER = np.array([0.01, -0.02, 0.03])


def test_a_solved_lever_arm_counts():
    recording = make_recording(truth=False)
    recovery = make_recovery(recording)
    assert recovery.calibration is not None
    lever = LeverArm(LEVER, np.full(3, 0.004))
    solved = replace(
        recovery,
        calibration=replace(
            recovery.calibration, lever_arms={**recovery.calibration.lever_arms, "strap": lever}
        ),
    )
    expected = recovery.position + turn(recovery.t_s).apply(LEVER)
    np.testing.assert_allclose(strap_position(solved), expected, atol=1e-12)
    np.testing.assert_array_equal(strap_position(recovery), recovery.position)
    # a camera that sees the strap alone, there
    position, state = np.full_like(recording.arm.position, np.nan), np.zeros_like(recording.arm.state)
    strap = JOINTS.index("strap")
    at_frames = [np.interp(recording.arm.t_s, recovery.t_s, expected[:, k]) for k in range(3)]
    position[:, strap], state[:, strap] = np.stack(at_frames, axis=1), JointState.TRACKED
    seen = replace(recording, arm=replace(recording.arm, position=position, state=state))
    gap = HiddenGap(8.0, 9.0)
    right, wrong = score_gap(seen, solved, gap), score_gap(seen, recovery, gap)
    assert right.reference == "strap"
    assert right.distance_m.max() < 1e-3 < 0.9 * np.linalg.norm(LEVER) < wrong.distance_m.min()


def test_camera_residuals_hold_the_noise_and_no_constant_error() -> None:
    made = make_recovery(make_recording())  # its residuals are white, 8 mm
    kept = made.residuals
    assert kept is not None and camera_inside_95(made) == {}
    residual = kept.residual.copy()
    residual[:, JOINTS.index("wrist")] += [0.02, 0.0, 0.0]
    noise = dict.fromkeys(("elbow", "wrist", "hand", "strap"), 0.008)
    figures = {"camera_sigma_m": noise, "joint_bias_m": {"wrist": [0.02, 0.0, 0.0]}}
    covariance = {name: value for name, value in made.joint_covariance.items() if name != "hand"}
    covariance["elbow"] = np.where(made.t_s[:, None, None] < 5.0, np.nan, covariance["elbow"])
    made = replace(
        made,
        residuals=replace(kept, residual=residual),
        estimates=Estimates.from_plain(figures),
        joint_covariance=covariance,
    )
    found = camera_inside_95(made)
    assert set(found) == {"elbow", "wrist"}, "nothing is stated of the hand, no strap was seen"
    assert list(found.values()) == pytest.approx([0.95, 0.95], abs=0.03)
    assert camera_inside_95(replace(made, residuals=None)) == {}


def spread(rng: np.random.Generator, count: int) -> FloatArray:
    """Covariances (count, 3, 3) with axes of their own, m^2."""
    root = 0.02 * rng.normal(size=(count, 3, 3)) + 0.01 * np.eye(3)
    return root @ np.swapaxes(root, 1, 2)


def test_the_factor_puts_the_error_on_the_regions_border():
    rng = np.random.default_rng(1)
    stated, noise = spread(rng, 200), np.diag([4e-6, 9e-6, 1e-6])
    error = 0.05 * rng.normal(size=(200, 3))
    factors = needed_factors(error, stated, noise)
    for column, level in enumerate((0.5, 0.95)):
        for row in np.flatnonzero(factors[:, column] > 1e-6):
            total = factors[row, column] ** 2 * stated[row] + noise
            squared = error[row] @ np.linalg.solve(total, error[row])
            assert squared == pytest.approx(chi2.ppf(level, 3), rel=1e-6)
    assert (factors > 1e-6).any()


def test_samples_without_an_answer_need_no_factor():
    stated = np.tile(1e-4 * np.eye(3), (3, 1, 1))
    stated[1] = np.nan
    stated[2, 0, 0] = -1.0
    error = np.array([[np.nan, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.0, 0.0]])
    assert np.isnan(needed_factors(error, stated, np.zeros((3, 3)))).all()


def test_too_few_gaps_have_no_quantile():
    values = [np.array([float(k)]) for k in range(18)]
    assert hierarchical_quantile(values, 0.95) == np.inf
    assert hierarchical_quantile([*values, np.array([18.0])], 0.95) == 18.0


def gaps_like(rng: np.random.Generator, count: int, scale: float) -> list[FloatArray]:
    """Squared sigmas over the limit in gaps whose samples share their error: heavy tails from gap to gap."""
    errors = []
    for _ in range(count):
        own, samples = scale * rng.standard_t(4, size=3), int(rng.integers(5, 60))
        errors.append(own + 0.2 * scale * rng.normal(size=(samples, 3)))
    ends = np.cumsum([len(error) for error in errors])
    factors = needed_factors(np.concatenate(errors), np.tile(np.eye(3), (ends[-1], 1, 1)), np.zeros((3, 3)))
    return np.split(factors, ends[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("count", [ENOUGH_GAPS, 40])
def test_coverage_of_the_next_gap_on_exchangeable_gaps(count: int):
    """Over 120 studies a sample of the next gap lies inside in 95 of 100 (standard error 2)."""
    rng = np.random.default_rng(count)
    inside, wrong = [], []
    for _ in range(120):
        groups = gaps_like(rng, count + 1, 1.7)
        row = length_factors([(1.0, group) for group in groups[:-1]])[0]
        inside.append(np.mean(groups[-1][:, 1] <= row.factor_95))
        samples = np.concatenate([group[:, 1] for group in groups[:-1]])
        wrong.append(np.mean(groups[-1][:, 1] <= np.quantile(samples, 0.95)))
    assert 0.925 <= np.mean(inside) <= 0.99
    assert np.mean(wrong) < np.mean(inside)  # samples treated as if each stood for itself


def test_lengths_with_few_gaps_are_taken_together():
    rng = np.random.default_rng(2)
    gaps = [(0.5, group) for group in gaps_like(rng, 25, 1.0)]
    gaps += [(3.0, group) for group in gaps_like(rng, 4, 3.0)]
    short, long = length_factors(gaps)
    assert (short.count, short.pooled, long.count, long.pooled) == (25, False, 29, True)
    assert long.factor_95 > short.factor_95


def test_few_gaps_take_the_largest_and_say_what_it_holds():
    (row,) = length_factors([(1.0, group) for group in gaps_like(np.random.default_rng(3), 4, 2.0)])
    assert row.level == pytest.approx(0.8)
    assert np.isfinite(row.factor)
    assert any("4 gaps are too few" in sentence for sentence in factor_sentences([row]))


def test_below_one_only_on_firm_evidence():
    rng = np.random.default_rng(4)
    few = length_factors([(1.0, group) for group in gaps_like(rng, 30, 0.2)])[0]
    many = length_factors([(1.0, group) for group in gaps_like(rng, 200, 0.2)])[0]
    assert few.factor_95 < 1.0 and few.factor == 1.0
    assert many.factor_95 <= many.factor < 1.0


def test_gaps_without_an_answer_count_for_nothing():
    nothing = np.full((4, 2), np.nan)
    assert length_factors([(1.0, nothing)]) == ()
    assert factor_sentences(()) == []
    (row,) = length_factors([(1.0, nothing), *((1.0, g) for g in gaps_like(np.random.default_rng(5), 3, 1))])
    assert row.count == 3
