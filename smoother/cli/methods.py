"""Recovery methods by name, as the commands offer them; the strap's lever arm; the limit of sigma."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import typer

from ..baselines.registry import BASELINES, DEFAULT_ORIENTATION, LIVE_BASELINES
from ..errors import UnoccludeError
from ..evaluation.methods import GRAPH, METHODS, BaselineSettings, make_methods

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..measurements.clock import Clock
    from ..recording import Recording
    from ..result import Recoveries, Recovery

    Progress = Callable[[float, str], None]


def choose(names: str) -> list[str]:
    """The methods of a comma-separated list; "all" is every one."""
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    if wanted == ["all"]:
        return list(METHODS)
    for name in wanted:
        if name not in METHODS:
            raise typer.BadParameter(f"there is no method '{name}'; methods: {', '.join(METHODS)}")
    if not wanted:
        raise typer.BadParameter(f"name a method; methods: {', '.join(METHODS)}")
    return list(dict.fromkeys(wanted))


def baseline_settings(names: Sequence[str], orientation: str | None) -> BaselineSettings:
    """Check what was set for the baselines among the chosen methods."""
    known = BASELINES | LIVE_BASELINES
    if orientation is not None and not any(known[name].needs_orientation for name in names if name in known):
        raise typer.BadParameter(
            "--orientation belongs to the methods that need a filter's orientation, such as rts; no such"
            f" method was chosen, but {', '.join(names)}"
        )
    return BaselineSettings(orientation or DEFAULT_ORIENTATION)


def usual_draws(draws: int | None) -> int:
    """How many motions are drawn: as was said, or as usual."""
    from ..result.draws import USUAL_DRAWS

    return USUAL_DRAWS if draws is None else draws


def drawn_motions(draws: int | None, seed: int | None, method: str) -> int:
    """How many motions are drawn from the posterior: as usual unless something else was said."""
    if method != GRAPH:
        if draws or seed is not None:
            option = "--draws" if draws else "--seed"
            raise typer.BadParameter(f"{option} belongs to the method {GRAPH}: '{method}' has no posterior")
        return 0
    if seed is not None and draws == 0:
        raise typer.BadParameter("--seed is for the drawn motions, and --draws 0 draws none; leave one out")
    return usual_draws(draws)


def recover_arms(
    recordings: Sequence[Recording],
    name: str,
    calibrations: Sequence[ArmCalibration | None],
    clocks: Sequence[Clock | None],
    config: Config,
    settings: BaselineSettings,
    progress: Progress,
    draws: int = 0,
    seed: int = 0,
) -> Recoveries:
    """The arms of a recording by one method; those that cannot be recovered are left out.

    Motions are drawn from the graph's posterior only.
    """
    from ..several_arms import smooth_arms, together

    if name == GRAPH:
        return smooth_arms(recordings, calibrations, config, progress, clocks=clocks, draws=draws, seed=seed)
    answers: list[Recovery | UnoccludeError] = []
    for recording, calibration, clock in zip(recordings, calibrations, clocks, strict=True):
        recover = make_methods([name], calibration, config, settings, progress, clock)[name]
        try:
            answers.append(recover(recording))
        except UnoccludeError as error:
            answers.append(error)
    return together(recordings, answers)


#: How far the camera's strap may lie from the IMU where that is to be found, m per axis.
STRAP_SIGMA_M = 0.02


def with_strap(calibration: ArmCalibration | None, recording: Recording) -> ArmCalibration:
    """The calibration with the strap's lever arm as a variable, unless it contains one."""
    import numpy as np

    from ..calibration import ArmCalibration, LeverArm

    calibration = calibration or ArmCalibration(side=recording.side)
    if "strap" not in recording.arm.present:
        raise typer.BadParameter(
            "--solve-lever-arms is for recordings with a tracked strap;"
            " lever arms of the joints are found without it"
        )
    strap = LeverArm(np.zeros(3), np.full(3, STRAP_SIGMA_M))
    return replace(calibration, lever_arms={"strap": strap, **calibration.lever_arms})


def with_strap_note(recovery: Recovery) -> Recovery:
    """The recovery with a note that its positions are the IMU's, not the strap's."""
    import numpy as np

    arm = recovery.calibration
    if arm is None or "strap" not in arm.lever_arms:
        return recovery
    lever = arm.lever_arms["strap"]
    note = (
        f"The tracked strap was found {1e3 * np.linalg.norm(lever.position_m):.1f} mm from the IMU; positions"
        " are those of the IMU, and a reference of the strap is that far off."
    )
    return replace(recovery, notes=(*recovery.notes, note))


def limit_sigma(recovery: Recovery, max_sigma_m: float | None) -> Recovery:
    """Mark the samples whose position is less certain than asked for; they stay as they are."""
    if max_sigma_m is None:
        return recovery
    from ..result.untrusted import certain

    answered = int(certain(recovery).sum())
    marked = replace(recovery, estimates=replace(recovery.estimates, max_sigma_m=float(max_sigma_m)))
    below = int(certain(marked).sum())
    note = (
        f"{answered - below} of {answered} samples are less certain than {max_sigma_m:g} m (one standard"
        " deviation) and are marked as not to be used: `usable` is 0 in the CSV export."
    )
    return replace(marked, notes=(*recovery.notes, note))
