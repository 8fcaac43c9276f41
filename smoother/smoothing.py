"""The method on one page: `smooth(recording, calibration, config) -> Recovery`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice

from .calibration import ArmCalibration
from .config import Config
from .errors import SolveError
from .measurements.outliers import reject_by_camera
from .measurements.timestamps import synthetic_stamps
from .recording import FOREARM_JOINTS, JOINTS, FloatArray, Recording
from .recovery.magnetometer import (
    NO_MAGNETOMETER,
    FieldMean,
    Magnetometer,
    decide,
    takes_part,
    usual_strength,
)
from .recovery.passes import (
    FirstAnswer,
    SecondAnswer,
    SectionState,
    Task,
    first_pass,
    second_pass,
    section_field_means,
)
from .recovery.sections import Sections
from .recovery.stitch import Merger
from .result import Recovery
from .runtime.pool import Pool
from .runtime.store import Store
from .selfcal.clock_fit import ClockScore, pooled_score, refined_clock
from .selfcal.coarse_clock import synchronise_coarsely
from .selfcal.excerpts import excerpts_of
from .selfcal.rounds import SelfCalibration, self_calibrate
from .window.pooling import leave_one_out_priors, pooled
from .window.priors import calibration_from, first_priors, noise_of, with_measured_noise
from .window.problem import FieldMeasurements, Message, Priors

#: With so many sections the clock is found anew from all of them: it wanders over a long recording.
CLOCK_SECTIONS = 5

Progress = Callable[[float, str], None]


def smooth(
    recording: Recording,
    calibration: ArmCalibration | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
    store: Store | None = None,
) -> Recovery:
    """Recover the arm's motion over a whole recording.

    The recording is worked on in sections of about a minute, side by side in processes: each is solved once
    alone for what all sections share, then again with what the others found. The answer does not depend on
    the number of processes.

    Parameters
    ----------
    recording : one arm and its forearm IMU.
    calibration : lever arms and upper-arm length; not needed where `strap` is the only forearm joint.
    config : settings; the defaults where None.
    progress : called with a fraction (0..1) and a word for the step.
    store : where what grows with the recording's length lives; in memory where None.

    Returns
    -------
    Recovery
        At the IMU's times, in the camera's frame {K}, with covariance.

    Raises
    ------
    SolveError, CalibrationError
        Nothing of the recording can be solved, in one sentence.
    """
    config = with_measured_noise(config or Config(), recording.imu)
    calibration = calibration or ArmCalibration(side=recording.side)
    say, store = progress or (lambda fraction, text: None), store or Store()
    _check(recording)

    recording, coarse = synchronise_coarsely(recording)
    with Pool(config.windows.processes, len(recording.arm)) as pool:
        # clocks, and what the calibration lacks
        say(0.0, "calibrating")
        blocks = [reject_by_camera(block) for block in excerpts_of(recording)]
        if not blocks:
            raise SolveError(f"{recording.name}: at no time do the IMU and a visible forearm come together")
        known = self_calibrate(blocks, calibration, config, pool)
        # every section alone: what they share
        sections = Sections(recording, known.clocks[0])
        task = _task(recording, known, config, sections)
        first = _First(pool, sections, task, store, lambda share: say(0.2 + 0.35 * share, "first pass"))
        if not first.messages:
            raise SolveError(f"{recording.name}: too little of what the camera saw can be believed")
        known = first.known(synthetic_stamps(recording.arm.t_s))
        task = replace(task, known=known)
        arm = pooled(first.messages, task.prior)
        found = calibration_from(arm, task.prior.layout, known.start, known.bias.sigma_m)
        told = leave_one_out_priors(first.messages, task.prior)
        first.messages.clear()
        # a calibrated magnetometer, where it agrees with them
        fields, magnetometer = first.magnetometer(found, task)
        # every section again, told what the others found
        stitch = Merger(recording, task.joints, store)
        jobs = (
            (kept, list(islice(told, b - a)), {k - a: fields[k] for k in range(a, b) if k in fields})
            for kept, a, b in first.taken()
        )
        second = partial(_second, found=found, task=task)
        for count, answer in enumerate(pool.map(second, jobs)):
            stitch.add(answer.answer, answer.messages)
            say(0.55 + 0.4 * (count + 1) / len(first.kept), "recovering")
    recovery = magnetometer.noted(stitch.recovery(found, config, known, known.clocks[0].after(coarse)))
    say(1.0, "done")
    return recovery


def _second(
    job: tuple[SectionState, list[Priors], dict[int, FieldMeasurements]], found: ArmCalibration, task: Task
) -> SecondAnswer:
    kept, told, fields = job
    return second_pass(kept, told, found, fields, task)


class _First:
    """The first pass over all sections: what they say, and what the second pass needs of each.

    Attributes
    ----------
    messages : of all windows in the order of time.
    kept : a handle of the room a section.
    """

    def __init__(
        self, pool: Pool, sections: Sections, task: Task, store: Store, say: Callable[[float], None]
    ) -> None:
        self._pool, self._task, self._store = pool, task, store
        self.kept: list[object] = []
        self.messages: list[Message] = []
        self._strengths: list[FloatArray] = []
        self._scores: list[ClockScore] = []
        self._first_window = [0]
        answers: Iterator[FirstAnswer | None] = pool.map(partial(first_pass, task=task), sections)
        for count, answer in enumerate(answers):
            if answer is not None:
                self.kept.append(store.put(answer.kept))
                self.messages += answer.messages
                self._strengths += answer.strengths
                self._scores.append(answer.score)
                self._first_window.append(len(self.messages))
            say((count + 1) / len(sections.all))

    def taken(self) -> Iterator[tuple[SectionState, int, int]]:
        """Each section, its first window's number and the next section's, once."""
        for handle, a, b in zip(self.kept, self._first_window, self._first_window[1:], strict=False):
            kept = self._store.pop(handle)
            assert isinstance(kept, SectionState)
            yield kept, a, b

    def known(self, synthetic_stamps: bool) -> SelfCalibration:
        """What is known, with the clock as all sections see it."""
        known = self._task.known
        if not self._task.with_clock:
            return known
        return replace(
            known, clocks=(refined_clock(known.clocks[0], pooled_score(self._scores), synthetic_stamps),)
        )

    def magnetometer(
        self, found: ArmCalibration, task: Task
    ) -> tuple[dict[int, FieldMeasurements], Magnetometer]:
        """What a calibrated magnetometer adds, by window, and what became of it."""
        if not task.magnetometer:
            return {}, NO_MAGNETOMETER
        strength, reason = usual_strength(self._strengths)
        if not strength > 0:
            return {}, reason
        job = partial(_field, strength=strength, found=found, task=task)
        blocks: list[FieldMean] = []
        kept = []
        for each, more in self._pool.map(job, self.taken()):
            kept.append(self._store.put(each))
            blocks += more
        self.kept = kept
        return decide(blocks)


def _field(
    job: tuple[SectionState, int, int], strength: float, found: ArmCalibration, task: Task
) -> tuple[SectionState, list[FieldMean]]:
    kept, first_window, _ = job
    return section_field_means(kept, first_window, strength, found, task)


def _task(recording: Recording, known: SelfCalibration, config: Config, sections: Sections) -> Task:
    windows = sum(max(round(each.length_s / config.windows.length_s), 1) for each in sections.all)
    present = recording.arm.present
    return Task(
        known=known,
        config=config,
        prior=first_priors(known.begin, known.start, config),
        noise=noise_of(config, known.upper_arm_sigma_m),
        sharing=windows,
        joints=tuple(joint for joint in JOINTS if joint in present and joint != "strap"),
        magnetometer=takes_part(recording.imu),
        with_clock=len(sections.all) >= CLOCK_SECTIONS,
    )


def _check(recording: Recording) -> None:
    if not any(joint in FOREARM_JOINTS for joint in recording.arm.present):
        raise SolveError(f"{recording.name}: the camera never tracked the forearm")
