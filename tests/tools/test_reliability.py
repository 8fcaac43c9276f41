"""The second simulator and the wrong set-ups: cases change what they name, the judge counts right."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.errors import SolveError
from smoother.recording import JOINTS, JointState
from smoother.result import Recovery
from smoother.result.verdict import UntrustedInterval
from smoother.smoothing import smooth
from tools.reliability import __main__ as runner
from tools.reliability import judging, setup_errors
from tools.reliability.__main__ import preset_jobs, preset_pair
from tools.reliability.cases import CASES, SOUND, UNUSUAL, WRONG
from tools.reliability.judging import (
    ONE_PROCESS,
    Interval,
    Outcome,
    Rated,
    Row,
    rated,
    summarise,
    trial_of,
    trusted_samples,
)
from tools.reliability.motions import EXERCISES, SPECIAL, perform
from tools.reliability.real import known_offset_s
from tools.reliability.scene import Scene, Tracker, draw_scene, film, ideal_imu, plan_gaps
from tools.reliability.setup_errors import Job, Setup, draw, run, sound

#: Cases that are a choice of exercise, length or rate, and leave the scene as it was drawn.
DRAWN = {"sound", "sound at another rate", "sound short"}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw_scene("daily life", 14.0, [5, 0], tracker_name="good")


@pytest.mark.parametrize("name", ["drinking", "wheelchair", "reaching with tremor"])
@pytest.mark.parametrize("left", [False, True])
def test_the_ideal_imu_adds_up_to_the_path(name: str, left: bool):
    motion = perform(name, 5.0, np.random.default_rng(1))
    imu = ideal_imu(motion, 5.0, 500.0, left=left)
    edges = np.arange(len(imu) + 1) / 500.0
    R_true, p_true = motion.imu_pose(edges, left=left)
    h, here = 1e-4, np.zeros(1) + 1e-4
    velocity = (
        (motion.imu_pose(here + h, left=left)[1] - motion.imu_pose(here - h, left=left)[1]) / (2 * h)
    )[0]
    R, p = Rotation.from_matrix(R_true[0]), p_true[0].copy()
    for row in range(len(imu)):
        half = R * Rotation.from_rotvec(0.5 * imu.gyro[row] / 500.0)
        acceleration = half.apply(imu.acc[row]) + motion.camera.gravity
        p = p + velocity / 500.0 + 0.5 * acceleration / 500.0**2
        velocity = velocity + acceleration / 500.0
        R = R * Rotation.from_rotvec(imu.gyro[row] / 500.0)
    # a millimetre a second: what is left of the steps' coning and sculling, and of the first velocity
    assert np.linalg.norm(p - p_true[-1]) < 0.006
    assert np.degrees((R.inv() * Rotation.from_matrix(R_true[-1])).magnitude()) < 0.1


@pytest.mark.parametrize("name", [*EXERCISES, *SPECIAL])
def test_people_keep_their_bones_and_move_as_people_do(name: str):
    motion = perform(name, 12.0, np.random.default_rng(2), ((3.0, 5.0),))
    t_s = np.arange(0.0, 12.0, 0.01)
    for left in (False, True):
        joints = motion.joints(t_s, left=left)
        bones = [motion.bones.upper_arm, motion.bones.forearm, motion.bones.hand]
        for (one, other), length in zip(
            (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand")), bones, strict=True
        ):
            np.testing.assert_allclose(np.linalg.norm(joints[one] - joints[other], axis=1), length, atol=1e-9)
        sensor = motion.imu_pose(t_s, left=left)[1]
        assert np.linalg.norm(sensor - joints["wrist"], axis=1).max() < 0.13
        speed = np.linalg.norm(np.diff(joints["wrist"], axis=0), axis=1) / 0.01
        assert 0.02 < speed.max() < 4.5
    R_K_A, _ = motion.imu_pose(t_s)
    np.testing.assert_allclose(np.linalg.det(R_K_A), 1.0, atol=1e-9)
    up = -motion.camera.gravity @ motion.camera.R_K_P / 9.81
    np.testing.assert_allclose(up, [0.0, 1.0, 0.0], atol=1e-12)


def test_repetitions_and_people_differ():
    t_s = np.arange(0.0, 10.0, 0.1)
    one, again, other = (
        perform("drinking", 10.0, np.random.default_rng(seed)).joints(t_s)["wrist"] for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert np.linalg.norm((one - one.mean(axis=0)) - (other - other.mean(axis=0)), axis=1).mean() > 0.05


def test_a_tracker_without_errors_states_the_truth():
    motion, rng = perform("combing", 12.0, np.random.default_rng(3)), np.random.default_rng(4)
    gaps = plan_gaps(12.0, rng)
    clean = film(motion, Tracker(0.0, (0.0,) * 4, 0.5, 0.0), 12.0, gaps, rng)
    tracks = clean.tracks(0.25, rng)
    for joint in JOINTS[:4]:
        seen = tracks.tracked(joint)
        true = motion.joints(clean.t_s)[joint]
        np.testing.assert_allclose(tracks.joint(joint)[seen], true[seen], atol=1e-12)
        assert (seen & clean.hidden).mean() < 0.02 or joint in ("shoulder", "elbow")
    assert np.abs(tracks.t_s + 0.25 - clean.t_s).max() < 0.005
    assert (np.diff(tracks.t_s) > 0).all()
    hidden_s = clean.hidden.mean() * 12.0
    assert hidden_s == pytest.approx(sum(end - start for start, end in gaps), abs=0.2)


def contents(scene: Scene) -> dict[str, np.ndarray]:
    """What is given to `smooth`, as arrays."""
    recording = scene.recording()
    return {
        "acc": recording.imu.acc,
        "gyro": recording.imu.gyro,
        "imu_t": recording.imu.t_s,
        "frame_t": recording.arm.t_s,
        "position": recording.arm.position,
        "state": recording.arm.state,
    }


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_case_changes_the_recording(case, scene: Scene):
    before = contents(scene)
    spoilt = case.apply(replace(scene, rng=np.random.default_rng(9)))
    after = contents(spoilt)
    same = all(
        len(after[name]) == len(values) and np.array_equal(after[name], values, values.dtype.kind == "f")
        for name, values in before.items()
    )
    assert same == (case.name in DRAWN)
    again = contents(case.apply(replace(scene, rng=np.random.default_rng(9))))
    for name, values in after.items():  # the same draws every time, and what is spoilt is a copy
        np.testing.assert_array_equal(values, again[name])
        np.testing.assert_array_equal(contents(scene)[name], before[name])
    trial = trial_of(spoilt)
    assert trial.intervals and trial.truth_at(np.array([5.0, 6.0]))["wrist"].shape[1:] == (2, 3)
    visible = [span for span in spoilt.faulty if span[1] > span[0]]
    if case.kind != "sound" and visible:  # a faulty time shows a place that is not
        true, film = spoilt.film.true, spoilt.film
        rows = np.any([film.between(*span) for span in visible], axis=0) & ~film.hidden
        tracked = rows[:, None] & (film.state == JointState.TRACKED)
        off = np.linalg.norm(film.position - true, axis=2)[tracked]
        assert np.median(off[off > 0.06]) > 0.06 and (off > 0.06).mean() > 0.1


def test_names_are_unique_and_every_row_of_the_table_of_causes_is_there():
    names = [case.name for case in CASES if case not in SOUND]
    assert len(set(names)) == len(names) == len(WRONG) + len(UNUSUAL)
    rows = """imu of another session; trial cut by hand; other body after a gap;
        sides exchanged after a gap; sides exchanged from the middle;
        drape seen nearer; guessed hanging; guessed frozen; guessed at the hip; guessed on the trunk;
        mirrored in one plane; elbow and wrist exchanged; camera turned in a gap; samples lost;
        accelerometer scale small; shoulder moves fast; shoulder away for a while"""
    assert {" ".join(row.split()) for row in rows.split(";")} <= set(names)
    assert "pendulum" in EXERCISES


def test_held_out_seeds_are_others():
    def seeds(family: int) -> list[tuple[int, int]]:
        jobs = runner.draw_jobs(WRONG, 40, np.random.default_rng([0, 0, family]), family)
        return [(job.seed, job.family) for job in jobs]

    assert not set(seeds(0)) & set(seeds(1))
    one, other = (draw_scene("drinking", 6.0, [3, family]) for family in (0, 1))
    assert len(one.imu) != len(other.imu) or not np.allclose(one.imu.acc, other.imu.acc)
    few, many = (runner.draw_jobs(WRONG, count, np.random.default_rng(1), 0) for count in (5, 9))
    assert many[:5] == few


@pytest.fixture(scope="module")
def answered() -> tuple[Scene, Recovery]:
    scene = draw_scene("reaching out", 12.0, [8, 0], tracker_name="good", every_s=3.0)
    return scene, smooth(scene.recording(), None, ONE_PROCESS)


def test_a_sound_answer_is_near_its_truth(answered: tuple[Scene, Recovery]):
    scene, recovery = answered
    found = rated(recovery, trial_of(scene))
    assert len(found) == len(scene.gaps)
    assert all(each.error_m < 0.06 and not each.off() for each in found)


def test_what_is_wrong_and_trusted_is_found(answered: tuple[Scene, Recovery]):
    scene, recovery = answered
    trial, gap = trial_of(scene), scene.gaps[0]
    rows = (recovery.t_s > gap[0]) & (recovery.t_s < gap[1])
    wrist = recovery.joints["wrist"].copy()
    wrist[rows] += [0.5, 0.0, 0.0]
    moved = replace(recovery, joints=recovery.joints | {"wrist": wrist})
    first = rated(moved, trial)[0]
    assert first.trusted and first.off() and first.error_m == pytest.approx(0.5, abs=0.06)
    assert Outcome((first,), trusted=True).wrong_and_trusted == (first,)
    doubtful = UntrustedInterval(gap[0] - 0.1, gap[1] + 0.1, ("the camera contradicts itself",))
    careful = replace(moved, estimates=replace(moved.estimates, trusted=True, untrusted=(doubtful,)))
    assert not rated(careful, trial)[0].trusted
    assert rated(careful, trial)[0].reasons == ("the camera contradicts itself",)
    assert not trusted_samples(replace(moved, estimates=replace(moved.estimates, trusted=False))).any()


def test_the_known_clock_of_a_real_trial_is_found_in_a_simulated_one(scene: Scene):
    shifted = scene.changed(offset_s=1.2).recording()
    assert known_offset_s(shifted) == pytest.approx(1.2, abs=0.08)


def test_a_solve_that_nobody_waits_for_is_given_up(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    def endless(*arguments: object) -> Recovery:
        raise judging.TooSlow(f"{judging.TOO_SLOW} 80 s of processor time")

    monkeypatch.setattr(judging, "smooth", endless)
    outcome = judging.run(trial_of(scene))
    assert outcome.verdict == "refused" and Row("", "", "wrong", 1, outcome).fails == "TOO SLOW"
    with judging.time_limit(scene.recording()):
        assert signal.getitimer(signal.ITIMER_VIRTUAL)[0] > 60.0
    assert signal.getitimer(signal.ITIMER_VIRTUAL)[0] == 0.0


def test_a_pair_of_presets_shares_nothing():
    preset, protocol, skeleton, imu = preset_jobs(3, np.random.default_rng(0))[1]
    assert (preset, protocol) == ("realistic", "random") and skeleton != imu
    trial = preset_pair(preset, protocol, skeleton, imu)
    assert trial.offset_s is not None and trial.recording.truth is None and len(trial.intervals) >= 4
    assert np.isfinite(trial.truth_at(np.array([10.0, 20.0]))["wrist"]).all()


def test_the_summary_counts_what_must_not_be(capsys: pytest.CaptureFixture[str]):
    gap = Interval(1.0, 2.0)
    bad, good = (Rated(gap, error, 0.02, True, np.ones(5), 0.3) for error in (0.5, 0.01))
    rows = [
        Row("mirrored", "", "wrong", 1, Outcome((bad,), trusted=True, seconds=1.0, duration_s=10.0)),
        Row("mirrored", "", "wrong", 2, Outcome((replace(bad, trusted=False),), trusted=True)),
        Row("mirrored", "", "wrong", 3, Outcome((bad,), trusted=True)),
        Row("sound", "", "sound", 4, Outcome((good,), trusted=True)),
        Row("sound", "", "sound", 5, Outcome(sentence="no")),
        Row("imu of another person", "", "pair", 6, Outcome((good,), trusted=True)),
    ]
    for row in rows:
        row.show()
    summarise(rows)
    text = capsys.readouterr().out
    assert text.count("WRONG AND TRUSTED") == 2 and text.count("PAIR TRUSTED") == 1
    assert "an interval wrong and trusted: 2 of 3" in text
    assert "wrong pairs called trusted: 1 of 1" in text
    assert "sound recordings not trusted or refused: 1 of 2" in text
    assert "100 % of the samples in the 95 % region" in text


def test_the_command_runs(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    arguments = ["reliability", "--only", "sound short", "--seed", "3", "--sound", "1"]
    monkeypatch.setattr(sys, "argv", arguments)
    runner.main()
    assert "sound recordings not trusted or refused: " in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["reliability", "--only", "no such case"])
    with pytest.raises(SystemExit):
        runner.main()


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


def contents_of(setup: Setup) -> dict[str, np.ndarray]:
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
    names = {case.__name__ for case in setup_errors.CASES}
    assert names == {*CHANGES, "clipped_sensor"}
    assert len(names) == len(setup_errors.CASES) == 22
    assert all(case.__doc__ for case in setup_errors.CASES)


@pytest.mark.parametrize("case", setup_errors.CASES, ids=lambda case: case.__name__)
def test_a_case_changes_what_it_names(case: Callable[[Setup], Setup], right: Setup):
    before = {name: values.copy() for name, values in contents_of(right).items()}
    wrong = contents_of(job(case).setup())
    changed = {
        name for name, values in wrong.items() if not np.array_equal(values, before[name], _nan(values))
    }
    if case.__name__ == "clipped_sensor":
        assert len(changed) == 1 and changed < {"acc", "gyro"}
    else:
        allowed = CHANGES[case.__name__]
        assert allowed - {"state"} <= changed <= allowed  # joints may be lost in the same frames
    again = contents_of(job(case).setup())
    for name, values in wrong.items():  # the same draws every time
        np.testing.assert_array_equal(values, again[name])
    case(replace(right, rng=np.random.default_rng(0)))
    for name, values in contents_of(right).items():  # what is spoilt is a copy
        np.testing.assert_array_equal(values, before[name])


def _nan(values: np.ndarray) -> bool:
    return values.dtype.kind == "f"


def test_the_sizes_of_the_mistakes(right: Setup):
    cases = {case.__name__: job(case).setup().recording for case in setup_errors.CASES}
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
    assert [each.case for each in many[:22]] == list(setup_errors.CASES)
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
    outcomes = [
        setup_errors.Outcome(0.5, 0.1, trusted=True),
        setup_errors.Outcome(0.5, 0.1, trusted=False),
        setup_errors.Outcome(0.02, 0.1),
    ]
    outcomes += [
        setup_errors.Outcome(0.02, 0.02, trusted=True),
        setup_errors.Outcome(0.02, 0.02, trusted=False),
        setup_errors.Outcome(sentence="no"),
    ]
    setup_errors.summarise([wrong] * 3 + [good] * 3, outcomes)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2] == "wrong, above 10 cm in the gaps and trusted: 1 of 3 (without a verdict yet: 0)"
    assert lines[-1] == "sound, not trusted or refused: 2 of 3"
