"""The method on one page: `smooth(recording, calibration, config) -> Recovery`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from .calibration import ArmCalibration
from .cameras import join_cameras
from .config import Config
from .errors import SolveError, UnoccludeError
from .measurements.clock import OFFSET_SIGMA_S, Clock
from .measurements.outliers import reject_by_camera
from .measurements.segment import Timeline
from .measurements.timestamps import even_times, in_packets
from .recording import FOREARM_JOINTS, JointState, Recording
from .recovery.ambiguity import with_ambiguities
from .recovery.camera_blocks import CameraEvidence, Solved, without_wrong_blocks
from .recovery.cameras import names_of, with_cameras
from .recovery.cause import diagnose_failures, with_cause
from .recovery.magnetometer import Magnetometer, judged, takes_part
from .recovery.merge import merge
from .recovery.sections import Sections
from .recovery.self_check import with_self_check, with_sigma_factors
from .recovery.solve_section import clock_over, observed_field, solve_sections
from .recovery.task import Task
from .recovery.trunk import with_trunk
from .recovery.trust import with_gap_verdicts, with_verdict
from .result import Recovery
from .runtime.pool import Pool, Progress, one_blas_thread
from .selfcal.excerpts import informative_excerpts, is_read_whole
from .selfcal.further_imu import calibrate_further_imus, joined, without_joints_of
from .selfcal.mounting import contradictions
from .selfcal.pairing import pair
from .selfcal.rounds import self_calibrate
from .window.priors import limb_lengths, with_measured_noise, with_measured_shoulder

Answer = TypeVar("Answer")


@one_blas_thread()
def smooth(
    recording: Recording,
    calibration: ArmCalibration | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
    processes: int | None = None,
    clock: Clock | None = None,
    draws: int = 0,
    seed: int = 0,
) -> Recovery:
    """Recover the arm's motion over a whole recording.

    Excerpts give what the whole recording shares; then sections of about a minute are solved side by side in
    processes. The answer depends neither on the number of processes nor on the threads that NumPy may use.

    Parameters
    ----------
    recording : Recording
        One arm and its forearm IMU.
    calibration : ArmCalibration, optional
        Lever arms and upper-arm length, with sigmas; what is missing is estimated.
    config : Config, optional
        Settings.
    progress : callable, optional
        Called with a fraction (0..1) and a word for the step.
    processes : int, optional
        Worker processes, 0 for one per core; None uses the configuration's value.
    clock : Clock, optional
        The camera's against the IMU's as it was measured, with its sigma: a prior. The motion gives it where
        there is none.
    draws : int
        This many whole motions drawn from the posterior (`Recovery.draws`); the answer is the same with and
        without. `smoother.smooth` and the command draw 64.
    seed : int
        Of the draws' random numbers, 0 or more: the same one gives the same motions.

    Returns
    -------
    Recovery
        At the IMU's times, in the camera's frame {K}, with covariance.

    Raises
    ------
    UnoccludeError
        `draws` or `seed` is below zero.
    SolveError, CalibrationError
        Nothing of the recording can be solved, in one sentence.
    """
    if draws < 0 or seed < 0:
        raise UnoccludeError(f"draws and seed are whole numbers, 0 or more; not {min(draws, seed)}")
    config = with_measured_shoulder(with_measured_noise(config or Config(), recording.imu), recording.arm)
    given = calibration or ArmCalibration(side=recording.side)
    report = progress or (lambda fraction, text: None)
    if not any(joint in FOREARM_JOINTS for joint in recording.arm.present):
        raise SolveError(f"{recording.name}: the camera never tracked the forearm")
    _check_unit(recording)

    recording = _out_of_packets(recording)
    # 0. Several cameras: where each stands, its clock, and all frames as one stream in the first one's frame.
    recording, rig = join_cameras(recording, float(limb_lengths(config.arm).mean[0]))
    # 1. Clocks: whether the streams are a pair, and the camera's stamps where the fine search finds the rest.
    report(0.0, "calibrating")
    as_recorded = recording
    timeline = Timeline.of(recording)
    count = config.windows.processes if processes is None else processes
    with Pool(count, len(recording.arm)) as workers:
        with diagnose_failures(recording, given, clock):
            recording, coarse_clock, pairing = pair(
                recording, timeline, clock, workers, given.forearm_direction
            )

        def solved(one: Recording) -> Solved:
            return _solved(one, given, config, workers, report, clock, coarse_clock, (draws, seed))

        # 2. to 5. The motion; blocks of the camera's samples that the rest contradicts are left out of it.
        with diagnose_failures(recording, given, clock):
            best = without_wrong_blocks(recording, solved, names_of(rig, recording.arm))
    #    The thorax by an IMU on the trunk, where there is one.
    recovery = with_cameras(with_trunk(best.recovery, as_recorded), rig)
    # 6. Sigma as hidden gaps of this camera asked for: the calibration's, or the self-check's.
    recovery = with_sigma_factors(recovery, given.sigma_factors)
    recovery = with_self_check(recovery, best.evidence.stretches)
    report(1.0, "done")
    # 7. A verdict with its likeliest cause, also by the gaps that the visible motion leaves ambiguous.
    pairing = best.paired(pairing, recording, clock)
    clock_given_s = None if clock is None else (clock.mean_s, clock.sigma_s)
    found = replace(recovery.estimates, pairing=pairing, clock_given_s=clock_given_s)
    recovery = replace(recovery, estimates=found)
    steps, anatomy = tuple(best.steps()), config.arm.anatomy
    recovery = with_verdict(
        recovery, recording, anatomy, best.misfits, best.open_questions, steps, clock, coarse_clock
    )
    recovery = with_cause(recovery, recording, given, clock)
    recovery = with_gap_verdicts(with_ambiguities(recovery, recording, best.excerpts, given))
    return with_cause(recovery, recording, given, clock)


def _out_of_packets(recording: Recording) -> Recording:
    """IMU samples that were stamped as their packets arrived, on the even times that those show."""
    imu = recording.imu
    even = even_times(np.asarray(imu.t_s)) if in_packets(np.asarray(imu.t_s)) else None
    if even is None:
        return recording
    note = f"the IMU's stamps are those of packets: its samples were counted at {1.0 / even.tick_s:.2f} Hz"
    return replace(recording, imu=replace(imu, t_s=even.t_s), notes=(*recording.notes, note))


#: No depth camera sees a person beyond this, m.
_FARTHEST_M = 50.0


def _check_unit(recording: Recording) -> None:
    """Refuse positions that cannot be metres."""
    tracked = recording.arm.position[recording.arm.state == JointState.TRACKED]
    distance = float(np.median(np.linalg.norm(tracked, axis=-1))) if len(tracked) else 0.0
    if distance > _FARTHEST_M:
        unit, factor = ("millimetres", 1000) if distance > 20 * _FARTHEST_M else ("centimetres", 100)
        raise SolveError(
            f"{recording.name}: positions are in metres, and these are {distance:.0f} from the camera; they"
            f" seem to be {unit}: divide them by {factor}"
        )


def _solved(
    recording: Recording,
    given: ArmCalibration,
    config: Config,
    workers: Pool,
    report: Progress,
    measured: Clock | None,
    coarse_clock: Clock | None,
    drawing: tuple[int, int],
) -> Solved:
    """Steps 2 to 5: calibrate, solve every section, and join the answers."""
    timeline = Timeline.of(recording)
    # 2. Self-calibration on the excerpts that are most informative: lever arms, clock, camera noise.
    excerpts = [reject_by_camera(excerpt) for excerpt in informative_excerpts(recording, timeline)]
    if not excerpts:
        raise SolveError(f"{recording.name}: the IMU and a visible forearm never overlap")
    misfits = tuple(contradictions(excerpts, given))
    clock_sigma_s = OFFSET_SIGMA_S if measured is None else measured.sigma_s
    #    IMUs on other segments, where there are any: how they sit, and their clocks.
    further, left_out = calibrate_further_imus(recording, given, config, workers)
    own = [without_joints_of(excerpt, further) for excerpt in excerpts]
    model = self_calibrate(own, given, config, workers, clock_sigma_s)
    model, further, used = joined(model, further)
    recording = replace(recording, notes=(*recording.notes, *left_out, *used))
    # 3. The clock over a long recording, the magnetic field, and the motions that are drawn.
    sections = Sections(recording, timeline, model.clock, further)
    usual_gap_s = timeline.usual_gap_s(recording.arm.t_s)
    task = Task.of(recording, sections, model, config, usual_gap_s, is_read_whole(timeline))
    task = clock_over(sections, task, workers, timeline.synthetic_stamps).drawing(*drawing, recording)
    magnetometer = Magnetometer()
    if takes_part(recording.imu):
        magnetometer = judged(observed_field(sections, task, workers))
        task = replace(task, field=magnetometer.field)
    # 4. Every section solved as one window; visible stretches hidden, recovered and compared.
    evidence = CameraEvidence()
    answers = evidence.collecting(solve_sections(sections, task, workers))
    # 5. One trajectory at the IMU's own stamps.
    answers = _reported(answers, len(sections), lambda share: report(0.25 + 0.7 * share, "recovering"))
    recovery = merge(answers, recording, timeline, task, magnetometer, coarse_clock)
    misfits = (*misfits, *model.misfits)
    return Solved(recovery, evidence, excerpts, misfits, model.open_questions)


def _reported(answers: Iterable[Answer], count: int, report: Callable[[float], None]) -> Iterator[Answer]:
    """The answers as they come, each followed by the share that is done."""
    for number, answer in enumerate(answers, start=1):
        yield answer
        report(number / count)
