"""The method on one page: `smooth(recording, calibration, config) -> Recovery`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from .assemble import assemble, frame_residuals
from .calibration import ArmCalibration
from .clock import LARGEST_OFFSET_S, Clock
from .config import Config
from .errors import SolveError
from .firstpass import combine, tell
from .join import Motion, join
from .magnetic import with_magnetometer
from .pieces import Piece, take_apart
from .plan import Stretch, cut, cut_times
from .pool import Pool
from .prepare import GRAVITY, prepare
from .priors import calibration_from, first_priors, noise_of, with_measured_noise
from .recording import FOREARM_JOINTS, Recording
from .result import Recovery
from .screen import by_camera, by_residual
from .selfcal import Knowledge, screen_attitude, self_calibrate, started
from .window import Noise, Priors, Solution, Window

Progress = Callable[[float, str], None]


def smooth(
    recording: Recording,
    calibration: ArmCalibration | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
) -> Recovery:
    """Recover the arm's motion over a whole recording.

    Parameters
    ----------
    recording : one arm and its forearm IMU.
    calibration : lever arms and upper-arm length; not needed where `strap` is the only forearm joint.
    config : settings; the defaults where None.
    progress : called with a fraction (0..1) and a word for the step.

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
    say = progress or (lambda fraction, text: None)
    _check(recording)

    with Pool(config.windows.processes, len(recording.arm)) as pool:
        pieces = [by_camera(piece) for piece in take_apart(recording, slack_s=LARGEST_OFFSET_S)]
        if not pieces:
            raise SolveError(f"{recording.name}: at no time do the IMU and a visible forearm come together")
        # clocks, and what the calibration lacks
        say(0.0, "calibrating")
        known = self_calibrate(pieces, calibration, config, pool)
        clock = known.clocks[0]
        # what is occluded, start values
        pieces = [screen_attitude(piece, known.start, clock) for piece in known.bias.corrected(pieces)]
        ready = [
            (piece, each)
            for piece in pieces
            if (each := prepare(piece, known.start, clock, known.sigma_m)) is not None
        ]
        if not ready:
            raise SolveError(f"{recording.name}: too little of what the camera saw can be believed")
        stretches = [each[0] for _, each in ready]
        alignments = [each[1] for _, each in ready]
        # windows, graphs, solve: a first pass for what they share, a second with what the first one found
        prior = first_priors(stretches, alignments, [piece for piece, _ in ready], known.start, config)
        noise = noise_of(config, known.flex_m)
        borders = [cut_times(stretch, config.windows.length_s) for stretch in stretches]
        cuts: Iterable[Window] = _cut(
            stretches, borders, [prior] * sum(len(b) - 1 for b in borders), config, noise
        )
        first, answers = _solve(
            pool,
            cuts,
            borders,
            recording.imu.mag_calibrated,  # it is judged by what the first pass knows of the attitude
            lambda share: say(0.2 + 0.35 * share, "first pass"),
        )
        heard = [answer.message for each in answers for answer in each]
        told = tell(heard, prior)
        found = calibration_from(combine(heard, prior), prior.layout, known.start, known.bias.sigma_m)
        better = []
        for (piece, _), stretch, windows, solutions in zip(ready, stretches, first, answers, strict=True):
            motion = join(stretch.t, windows, solutions)
            believed, stretch = _believe(piece, stretch, motion, known, found, clock)
            pieces = [believed if each is piece else each for each in pieces]
            better.append(stretch)
        cuts = _cut(better, borders, told, config, noise)
        # a calibrated magnetometer, where it agrees with the first pass
        cuts, magnetometer = with_magnetometer(recording.imu, first, answers, cuts)
        second, answers = _solve(
            pool, cuts, borders, True, lambda share: say(0.55 + 0.4 * share, "recovering")
        )
    # join
    motions = [
        join(stretch.t, windows, solutions)
        for stretch, windows, solutions in zip(better, second, answers, strict=True)
    ]
    messages = [answer.message for each in answers for answer in each]
    say(1.0, "done")
    return magnetometer.noted(assemble(recording, found, config, known, pieces, better, motions, messages))


def _believe(
    piece: Piece, stretch: Stretch, motion: Motion, known: Knowledge, found: ArmCalibration, clock: Clock
) -> tuple[Piece, Stretch]:
    """The piece without samples that the first pass contradicts, and its stretch with better start values."""
    frame_t = piece.frame_t + clock.at(piece.frame_t)
    residual = frame_residuals(piece.position, frame_t, stretch, motion, found)
    believed = by_residual(piece, residual, known.noise)
    again = prepare(believed, known.start, clock, known.sigma_m) if believed is not piece else None
    if again is None:
        return piece, replace(stretch, start=motion.states)
    return believed, started(again[0], motion)


def _check(recording: Recording) -> None:
    if not any(joint in FOREARM_JOINTS for joint in recording.arm.present):
        raise SolveError(f"{recording.name}: the camera never tracked the forearm")


def _cut(
    stretches: list[Stretch],
    borders: list[list[float]],
    priors: list[Priors],
    config: Config,
    noise: Noise,
) -> Iterator[Window]:
    """The windows of all stretches one after the other; `priors` in the same order."""
    told = iter(priors)
    for stretch, border in zip(stretches, borders, strict=True):
        mine = [next(told) for _ in border[1:]]
        yield from cut(stretch, mine, noise, border, config.windows.margin_s, GRAVITY, len(priors))


def _solve(
    pool: Pool,
    windows: Iterable[Window],
    borders: list[list[float]],
    with_covariance: bool,
    say: Callable[[float], None],
) -> tuple[list[list[Window]], list[list[Solution]]]:
    """Solve the windows of all stretches together; windows and solutions by stretch."""
    made: list[Window] = []

    def kept() -> Iterator[Window]:
        for window in windows:
            made.append(window)
            yield window

    total = sum(len(border) - 1 for border in borders)
    solved = pool.solve(kept(), with_covariance, lambda count: say(count / total))
    ends = np.cumsum([len(border) - 1 for border in borders])
    parts = [slice(end - len(border) + 1, end) for end, border in zip(ends, borders, strict=True)]
    return [made[part] for part in parts], [solved[part] for part in parts]
