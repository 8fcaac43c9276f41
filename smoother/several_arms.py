"""Several arms of one recording: `smooth_arms(recordings) -> Recoveries`, an arm at a time by `smooth`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from .calibration import ArmCalibration
from .config import Config
from .errors import RecordingError, UnoccludeError
from .measurements.clock import Clock
from .recording import Recording
from .result import Recoveries, Recovery
from .result.draws import USUAL_DRAWS
from .runtime.pool import WORTH_FRAMES, Pool, Progress
from .smoothing import smooth

#: An arm, and what was given of it.
Arm = tuple[Recording, ArmCalibration | None, Clock | None]


def smooth_arms(
    recordings: Sequence[Recording],
    calibrations: Sequence[ArmCalibration | None] | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
    processes: int | None = None,
    clocks: Sequence[Clock | None] | None = None,
    draws: int = USUAL_DRAWS,
    seed: int = 0,
) -> Recoveries:
    """Recover several arms, each as `smooth` recovers it alone.

    Every arm has its own IMU, clock and shoulder; no arm's result depends on another's, so each
    is what `smooth` gives for it. Short recordings run side by side, one arm per process; a long one
    keeps all processes busy by its sections, arm after arm. The answer depends on neither.

    Parameters
    ----------
    recordings : sequence of Recording
        One per arm, as `read_recordings` gives them.
    calibrations : sequence of ArmCalibration or None, optional
        Of the arms, in the same order.
    config, progress, processes
        As `smooth` takes them.
    clocks : sequence of Clock or None, optional
        As measured, of the arms in the same order.
    draws, seed : int
        As `smooth` takes them; each arm's motions are drawn on their own. 64 unless said otherwise, 0 = none.

    Returns
    -------
    Recoveries
        In the order of the recordings, by side or number. An arm that cannot be recovered is left out, which
        `left_out` and the other arms' notes state.

    Raises
    ------
    UnoccludeError
        No arm can be recovered: the first one's sentence.
    """
    if not recordings:
        raise RecordingError("there is no arm to recover: give at least one recording")
    config = config or Config()
    none = [None] * len(recordings)
    arms: list[Arm] = list(zip(recordings, calibrations or none, clocks or none, strict=True))
    count = config.windows.processes if processes is None else processes
    beside = min(count or os.cpu_count() or 1, len(arms))
    report = progress or (lambda fraction, text: None)
    recovered = partial(_recovered, config=config, draws=draws, seed=seed)
    answers: list[Recovery | UnoccludeError] = []
    if beside > 1 and max(len(recording.arm) for recording in recordings) <= WORTH_FRAMES:
        # one arm per process: none has enough frames to keep several busy
        with Pool(beside, sum(len(recording.arm) for recording in recordings)) as workers:
            for answer in workers.map(partial(recovered, processes=1), arms):
                answers.append(answer)
                report(len(answers) / len(arms), "recovering")
    else:
        for arm in arms:

            def share(done: float, word: str, number: int = len(answers)) -> None:
                report((number + done) / len(arms), word)

            answers.append(recovered(arm, processes=count, progress=share))
    return together(recordings, answers)


def _recovered(
    arm: Arm, config: Config, draws: int, seed: int, processes: int, progress: Progress | None = None
) -> Recovery | UnoccludeError:
    """The recovery of an arm, or why there is none."""
    recording, calibration, clock = arm
    try:
        return smooth(recording, calibration, config, progress, processes, clock, draws, seed)
    except UnoccludeError as error:
        return error


def together(recordings: Sequence[Recording], answers: Sequence[Recovery | UnoccludeError]) -> Recoveries:
    """The arms that were recovered; the others are named in their notes."""
    errors = [answer for answer in answers if isinstance(answer, UnoccludeError)]
    if len(errors) == len(answers):
        raise errors[0]
    left_out = tuple(
        f"The {recording.arm_label} was left out: {str(answer).rstrip('.')}."
        for recording, answer in zip(recordings, answers, strict=True)
        if isinstance(answer, UnoccludeError)
    )
    arms = [answer for answer in answers if isinstance(answer, Recovery)]
    if left_out:
        arms = [replace(arm, notes=(*arm.notes, *left_out)) for arm in arms]
    return Recoveries(tuple(arms), left_out)
