"""Both arms of one person before one camera, with truth: `simulate_both_arms`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .arm import SimulatedArm, random_streams, record_arm, simulate_arm
from .body import draw_measures
from .config import ArmSimulation
from .motion import draw_stage
from .people import mounted_anew, varied
from .protocol import perform


def simulate_both_arms(
    config: ArmSimulation | None = None, seed: int = 0
) -> tuple[SimulatedArm, SimulatedArm]:
    """Simulate an arm as `simulate_arm` does, and the same person's other arm beside it.

    The first is the arm that `simulate_arm` gives, but for the names. The other moves by itself in `random`
    and follows the first, in its own way, in `behind`; both sway with one trunk, have one camera's frames
    and the same gravity. Every IMU has its own errors.

    Parameters
    ----------
    config : ArmSimulation, optional
        As for the first arm; `side` is its side.
    seed : int
        Non-negative.

    Returns
    -------
    first, other : SimulatedArm
        Their recordings can be written to one file.
    """
    config = config or ArmSimulation()
    first = simulate_arm(config, seed)
    other_config = config.model_copy(update={"side": "left" if config.side == "right" else "right"})
    # what both share is drawn again from the first arm's streams: the person, the camera, its frames
    body_rng, *streams_of_first = random_streams(seed)
    measures = draw_measures(body_rng)
    stage = draw_stage(config.distance_m, config.camera_frame, body_rng)
    performance = perform(config, body_rng)
    own_rng, *streams = random_streams([seed, 1])
    streams[3] = streams_of_first[3]  # one camera: the same frames
    if config.protocol == "random" and not config.still_all:
        own = perform(other_config, own_rng)
        posture = own.posture[: len(performance.posture)]
    else:
        posture = performance.posture
        if config.protocol == "behind":
            posture = varied(posture, performance.t_s, own_rng)
    performance = replace(performance, posture=posture, sway=performance.sway * np.array([-1.0, 1.0, 1.0]))
    other = record_arm(
        other_config,
        first.recording.name,
        mounted_anew(measures, own_rng),
        stage,
        performance,
        streams,
    )
    return _named(first), _named(other)


def _named(arm: SimulatedArm) -> SimulatedArm:
    """Its IMU named after its side."""
    recording = arm.recording
    imu = replace(recording.imu, name=f"/imu/forearm_{recording.side}")
    return replace(arm, recording=replace(recording, imu=imu))
