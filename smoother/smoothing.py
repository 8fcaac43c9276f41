"""The method on one page: `smooth(recording, calibration, config) -> Recovery`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from .assemble import assemble
from .calibration import ArmCalibration
from .clock import LARGEST_OFFSET_S
from .config import Config
from .errors import SolveError
from .firstpass import combine, tell
from .join import join
from .pieces import take_apart
from .plan import Stretch, cut, cut_times
from .pool import Pool
from .prepare import GRAVITY, prepare
from .priors import calibration_from, first_priors, noise_of
from .recording import FOREARM_JOINTS, Recording
from .result import Recovery
from .selfcal import self_calibrate
from .window import Priors, Solution, Window

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
    config = config or Config()
    calibration = calibration or ArmCalibration(side=recording.side)
    say = progress or (lambda fraction, text: None)
    _check(recording)

    pieces = take_apart(recording, slack_s=LARGEST_OFFSET_S)
    if not pieces:
        raise SolveError(f"{recording.name}: at no time do the IMU and a visible forearm come together")
    nodes = sum(len(piece.frame_t) for piece in pieces)
    with Pool(config.windows.processes, nodes) as pool:
        # clocks, and what the calibration lacks
        say(0.0, "calibrating")
        known = self_calibrate(pieces, calibration, config, pool)
        clock = known.clocks[0]
        pieces = known.bias.corrected(pieces)
        # what is occluded, start values
        ready = [(piece, prepare(piece, known.start, clock, known.sigma_m)) for piece in pieces]
        ready = [(piece, each) for piece, each in ready if each is not None]
        stretches = [each[0] for _, each in ready]
        alignments = [each[1] for _, each in ready]
        # windows, graphs, solve: a first pass for what they share, a second with what the first one found
        prior = first_priors(stretches, alignments, [piece for piece, _ in ready], known.start, config)
        borders = [cut_times(stretch, config.windows.length_s) for stretch in stretches]
        first = _cut(stretches, borders, [prior] * sum(len(b) - 1 for b in borders), config)
        answers = _solve(pool, first, False, lambda share: say(0.2 + 0.35 * share, "first pass"))
        heard = [answer.message for each in answers for answer in each]
        told = tell(heard, prior)
        found = calibration_from(combine(heard, prior), prior.layout, known.start)
        better = [
            replace(stretch, start=join(stretch.t, windows, solutions).states)
            for stretch, windows, solutions in zip(stretches, first, answers, strict=True)
        ]
        second = _cut(better, borders, told, config)
        answers = _solve(pool, second, True, lambda share: say(0.55 + 0.4 * share, "recovering"))
    # join
    motions = [
        join(stretch.t, windows, solutions)
        for stretch, windows, solutions in zip(stretches, second, answers, strict=True)
    ]
    messages = [answer.message for each in answers for answer in each]
    say(1.0, "done")
    return assemble(recording, found, config, known, stretches, motions, messages)


def _check(recording: Recording) -> None:
    if not any(joint in FOREARM_JOINTS for joint in recording.arm.present):
        raise SolveError(f"{recording.name}: the camera never tracked the forearm")


def _cut(
    stretches: list[Stretch], borders: list[list[float]], priors: list[Priors], config: Config
) -> list[list[Window]]:
    """The windows of every stretch; `priors` in the order of all windows."""
    told = iter(priors)
    return [
        cut(
            stretch,
            [next(told) for _ in border[1:]],
            noise_of(config),
            border,
            config.windows.margin_s,
            GRAVITY,
            len(priors),
        )
        for stretch, border in zip(stretches, borders, strict=True)
    ]


def _solve(
    pool: Pool, windows: list[list[Window]], with_covariance: bool, done: Callable[[float], None]
) -> list[list[Solution]]:
    """Solve the windows of all stretches together and give them back by stretch."""
    flat = iter(pool.solve([window for each in windows for window in each], with_covariance, done))
    return [[next(flat) for _ in each] for each in windows]
