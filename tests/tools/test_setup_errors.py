"""Every wrong set-up is the mistake that it names, and no other; the table says how a result ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from smoother.errors import SolveError
from smoother.recording import JointState
from smoother.result import Recovery
from tools.reliability import setup_errors
from tools.reliability.setup_errors import CASES, Job, Outcome, Setup, draw, run, sound, summarise

#: What each case may change; `truth` where the answer's coordinates change.
CHANGES = {
    "mirrored_skeleton": {"position", "truth"},
    "accelerometer_sign": {"acc"},
    "gyroscope_sign": {"gyro"},
    "left_handed_axes": {"acc", "gyro"},
    "elbow_and_wrist_swapped": {"position", "state"},
    "hand_given_as_wrist": {"position", "state"},
    "joints_of_the_other_arm": {"position"},
    "skeleton_of_another_recording": {"position", "state", "frames", "truth"},
    "sensor_on_the_upper_arm": {"acc", "gyro", "truth"},
    "clocks_apart": {"frames"},
    "imu_at_10_hz": {"acc", "gyro", "samples"},
    "strap_turned_half_way": {"acc", "gyro", "truth"},
    "camera_bumped_half_way": {"position", "truth"},
    "skeleton_interpolated": {"position", "state"},
    "imu_zero_for_a_second": {"acc", "gyro"},
    "one_wild_gyroscope_sample": {"gyro"},
    "frames_far_away": {"position"},
    "radians_called_degrees": {"gyro"},
    "metres_called_millimetres": {"position"},
    "wrong_camera_frame": {"camera_frame"},
    "calibration_of_another_mounting": {"calibration"},
}


def job(case: Callable[[Setup], Setup] = sound, seed: int = 3) -> Job:
    """A job of fourteen seconds."""
    return Job(case, seed, "realistic", 14.0)


@pytest.fixture(scope="module")
def right() -> Setup:
    return job().setup()


def contents(setup: Setup) -> dict[str, np.ndarray]:
    """What a case may change, as arrays by name."""
    imu, arm, truth = setup.recording.imu, setup.recording.arm, setup.recording.truth
    assert truth is not None
    given = setup.calibration.lever_arms["wrist"].position_m if setup.calibration else []
    return {
        "samples": imu.t_s,
        "acc": imu.acc,
        "gyro": imu.gyro,
        "frames": arm.t_s,
        "position": arm.position,
        "state": arm.state,
        "truth": np.hstack([truth.position, truth.quaternion]),
        "camera_frame": np.array([str(setup.recording.camera_frame)]),
        "calibration": np.array(given),
    }


def test_every_case_is_tested():
    names = {case.__name__ for case in CASES}
    assert names == {*CHANGES, "clipped_sensor"}
    assert len(names) == len(CASES) == 22
    assert all(case.__doc__ for case in CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_a_case_changes_what_it_names(case: Callable[[Setup], Setup], right: Setup):
    before = {name: values.copy() for name, values in contents(right).items()}
    wrong = contents(job(case).setup())
    changed = {
        name for name, values in wrong.items() if not np.array_equal(values, before[name], _nan(values))
    }
    if case.__name__ == "clipped_sensor":
        assert len(changed) == 1 and changed < {"acc", "gyro"}
    else:
        allowed = CHANGES[case.__name__]
        assert allowed - {"state"} <= changed <= allowed  # joints may be lost in the same frames
    again = contents(job(case).setup())
    for name, values in wrong.items():  # the same draws every time
        np.testing.assert_array_equal(values, again[name])
    case(replace(right, rng=np.random.default_rng(0)))
    for name, values in contents(right).items():  # what is spoilt is a copy
        np.testing.assert_array_equal(values, before[name])


def _nan(values: np.ndarray) -> bool:
    return values.dtype.kind == "f"


def test_the_sizes_of_the_mistakes(right: Setup):
    cases = {case.__name__: job(case).setup().recording for case in CASES}
    imu, arm = right.recording.imu, right.recording.arm
    assert 0.5 <= abs((cases["clocks_apart"].arm.t_s - arm.t_s)[0]) <= 1.5
    assert cases["imu_at_10_hz"].imu.rate_hz == pytest.approx(10, abs=0.1)
    assert (cases["imu_zero_for_a_second"].imu.acc == 0).all(axis=1).sum() == pytest.approx(80, abs=1)
    assert np.abs(cases["one_wild_gyroscope_sample"].imu.gyro).max() == 34.0
    far = (cases["frames_far_away"].arm.position == 1e6).all(axis=(1, 2))
    assert 0 < far.mean() < 0.12
    tracked = cases["skeleton_interpolated"].arm.state[:, :4] == JointState.TRACKED
    assert tracked.all() and not (arm.state[:, :4] == JointState.TRACKED).all()
    turned = cases["strap_turned_half_way"].imu
    np.testing.assert_allclose(np.linalg.norm(turned.gyro, axis=1), np.linalg.norm(imu.gyro, axis=1))
    assert right.simulated.calibration.R_F_A is not None
    along = right.simulated.calibration.R_F_A[1]
    np.testing.assert_allclose(turned.acc @ along, imu.acc @ along)  # it slips about the arm
    seen = np.isfinite(arm.position)
    bumped = cases["camera_bumped_half_way"].arm.position
    moved = np.linalg.norm(np.where(seen, bumped - arm.position, 0.0), axis=2)
    assert moved[: len(moved) // 2 - 2].max() == 0
    assert 0 < moved.max() < 2.6 * np.radians(5)


def test_a_sensor_on_the_upper_arm_measures_its_own_motion():
    setup = job(setup_errors.sensor_on_the_upper_arm).setup()
    truth = setup.recording.truth
    assert truth is not None
    upper = truth.joints["elbow"] - truth.joints["shoulder"]
    upper /= np.linalg.norm(upper, axis=1, keepdims=True)
    beside = truth.joints["elbow"] - truth.position
    np.testing.assert_allclose((beside * upper).sum(axis=1), 0.08, atol=1e-6)
    still = np.median(np.linalg.norm(setup.recording.imu.acc, axis=1))
    assert still == pytest.approx(9.81, abs=0.5)


def test_draws_do_not_depend_on_how_many_follow():
    few, many = draw(30, 5), draw(60, 5)
    assert many[:30] == few
    assert [each.case for each in many[:22]] == list(CASES)
    assert {each.preset for each in many} == {"white", "realistic", "azure"}
    assert all(24 <= each.duration_s <= 60 for each in many)
    assert draw(30, 6) != few


def test_a_sound_recording_is_answered():
    outcome = run(job())
    assert outcome.sentence == "" and not outcome.off
    assert 0 < outcome.error_m < 0.1 and 0 < outcome.sigma_m < 0.1


def test_the_results_own_verdict_is_read(monkeypatch: pytest.MonkeyPatch):
    one = job()
    setup = one.setup()
    recovery = setup_errors.smooth(
        replace(setup.recording, truth=None), setup.calibration, setup_errors.ONE_PROCESS
    )
    for trusted, verdict in ((True, "trusted"), (False, "not trusted"), (None, "no verdict yet")):
        reasons, cautions = ((), ("slow",)) if trusted else (("clocks",), ())
        estimates = SimpleNamespace(trusted=trusted, reasons=reasons, cautions=cautions)
        object.__setattr__(recovery, "estimates", estimates)
        monkeypatch.setattr(setup_errors, "smooth", lambda *_: recovery)
        outcome = run(one)
        assert (outcome.trusted, outcome.verdict) == (trusted, verdict)
        if trusted is not None:
            assert outcome.reasons == (("slow",) if trusted else ("clocks",))
        monkeypatch.undo()


def test_errors_end_as_their_sentence(monkeypatch: pytest.MonkeyPatch):
    def refuse(*arguments: object) -> Recovery:
        raise SolveError("no motion")

    monkeypatch.setattr(setup_errors, "smooth", refuse)
    outcome = run(job())
    assert (outcome.sentence, outcome.verdict, outcome.off) == ("no motion", "refused", False)


def test_the_last_lines_count_what_must_not_be(capsys: pytest.CaptureFixture[str]):
    wrong, good = job(setup_errors.gyroscope_sign), job()
    outcomes = [Outcome(0.5, 0.1, trusted=True), Outcome(0.5, 0.1, trusted=False), Outcome(0.02, 0.1)]
    outcomes += [
        Outcome(0.02, 0.02, trusted=True),
        Outcome(0.02, 0.02, trusted=False),
        Outcome(sentence="no"),
    ]
    summarise([wrong] * 3 + [good] * 3, outcomes)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2] == "wrong, above 10 cm in the gaps and trusted: 1 of 3 (without a verdict yet: 0)"
    assert lines[-1] == "sound, not trusted or refused: 2 of 3"
