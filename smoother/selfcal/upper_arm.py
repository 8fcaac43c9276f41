"""Self-calibration of an upper-arm IMU.

Shoulder and elbow are to it what elbow and wrist are to the forearm's IMU. So nothing is new here: the same
clocks, closed form and rounds give the elbow and the shoulder in its axes {B}, and its clock against the
camera's; with the forearm IMU's clock that is the clock of one IMU against the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..body import UPPER_ARM
from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..measurements.clock import Clock
from ..measurements.outliers import reject_by_camera
from ..measurements.segment import Timeline, without_spikes
from ..measurements.timestamps import dejitter, split_at_pauses
from ..recording import ImuStream, Recording
from ..runtime.pool import Pool
from ..runtime.store import Store
from .excerpts import informative_excerpts
from .pairing import synchronise_coarsely
from .rounds import self_calibrate
from .self_calibration import SelfCalibration

#: A run's ends are held so much longer, s.
PADDING_S = 0.02
#: Rounds at most: the windows with both IMUs refine all but the clock.
ROUNDS = 3
#: How far elbow and shoulder are from constant in {B}, m an axis: no less and no more than this.
LEAST_TISSUE_M, MOST_TISSUE_M = 0.003, 0.04
#: Tissue turns the IMU against the bone, so that elbow and shoulder, on both sides of it, are off in opposite
#: directions at the same time: as independent errors of sqrt(2) times the size they turn the bone as far.
OPPOSED_ERROR_FACTOR = float(np.sqrt(2.0))
#: Where shoulder and elbow scatter by more, an axis, the IMU is on another limb: the right one shows 0.016 at
#: most on simulated arms, the forearm's or another person's 0.060.
WRONG_LIMB_M = 0.05
#: A run of samples shorter than this is not worth a filter.
FEWEST_SAMPLES = 40


@dataclass(frozen=True)
class UpperArm:
    """What the visible motion says of an upper-arm IMU.

    Attributes
    ----------
    imu : ImuStream
        Its samples, on the forearm IMU's clock, dejittered.
    model : SelfCalibration
        Of the upper arm, whose shoulder is called elbow and whose elbow wrist in it.
    tissue_m : float, m
        How far elbow and shoulder are from constant in its axes.
    clock : Clock
        Of the camera against it.
    """

    imu: ImuStream
    model: SelfCalibration
    tissue_m: float
    clock: Clock

    def runs(self, start_s: float, end_s: float) -> tuple[ImuStream, ...]:
        """Its samples between two times of the forearm IMU's clock, cut at its pauses, in memory."""
        first, last = np.searchsorted(self.imu.t_s, [start_s, end_s])
        part = self.imu.select(slice(int(first), int(last)))
        accelerometer, gyroscope = np.eye(3) - self.model.errors.imu
        acc, gyro = np.asarray(part.acc) @ accelerometer.T, np.asarray(part.gyro) @ gyroscope.T
        part = replace(part, t_s=np.array(part.t_s), acc=acc, gyro=gyro)
        runs = [rows for rows in split_at_pauses(part) if rows.stop - rows.start >= FEWEST_SAMPLES]
        return tuple(_longer(without_spikes(replace(part.select(rows), mag=None))) for rows in runs)

    def joined(self, forearm: SelfCalibration) -> SelfCalibration:
        """The forearm's model with what is known of the upper arm's IMU."""
        own = self.model

        def with_upper(arm: ArmCalibration, levers: ArmCalibration) -> ArmCalibration:
            joints = UPPER_ARM.as_forearm
            upper_imu = {joints[name]: lever for name, lever in levers.lever_arms.items() if name in joints}
            return replace(arm, upper_imu=upper_imu)

        bias = np.concatenate([np.zeros(3), own.initial.gyroscope_bias])
        return replace(
            forearm,
            estimate=with_upper(forearm.estimate, own.estimate),
            prior=with_upper(forearm.prior, own.prior),
            initial=replace(forearm.initial, biases={UPPER_ARM.name: bias}),
            tissue_m=self.tissue_m,
            upper_clock_offset_s=self.clock.mean_s,
        )


def calibrate_upper_arm(
    recording: Recording,
    forearm: SelfCalibration,
    given: ArmCalibration,
    config: Config,
    workers: Pool,
    store: Store,
) -> tuple[UpperArm | None, str]:
    """Find how an upper-arm IMU sits, and its clock.

    Parameters
    ----------
    recording : Recording
        With the camera's stamps as the forearm's coarse clock moved them.
    forearm : SelfCalibration
        Of the forearm's IMU; its clock is what the answer is on.
    given : ArmCalibration
        Its `upper_imu` is used where it is known beforehand.
    config : Config
    workers : Pool
    store : Store
        Where the moved stamps lie.

    Returns
    -------
    upper : UpperArm or None
        None without such an IMU, or where the motion does not tell how it sits.
    note : str
        A sentence on it, or on why it was left out; "" without such an IMU.
    """
    if recording.upper_imu is None:
        return None, ""
    name = recording.upper_imu.name
    arm = UPPER_ARM.seen_as_forearm(recording.arm)
    as_forearm = replace(recording, imu=recording.upper_imu, arm=arm, truth=None, upper_imu=None)
    known = ArmCalibration(
        side=given.side,
        lever_arms={
            name: given.upper_imu[joint]
            for name, joint in UPPER_ARM.as_forearm.items()
            if joint in given.upper_imu
        },
    )
    try:
        as_forearm, coarse = synchronise_coarsely(as_forearm)
        excerpts = [
            reject_by_camera(excerpt) for excerpt in informative_excerpts(as_forearm, Timeline.of(as_forearm))
        ]
        if not excerpts:
            return None, f"{name} was left out: the camera never saw shoulder and elbow with its samples"
        model = self_calibrate(excerpts, known, config, workers, rounds=ROUNDS)
    except UnoccludeError as error:
        return None, f"{name} was left out: {str(error).removeprefix(f'{recording.name}: ')}"
    if set(UPPER_ARM.as_forearm) - set(model.estimate.lever_arms) or model.mounting_unknown:
        return None, (
            f"{name} was left out: the upper arm hardly moved in view; raise the arm and turn it about there"
        )
    scatter_m = max(noise.sample_m for noise in model.joint_noise.values())
    if scatter_m > WRONG_LIMB_M:
        return None, (
            f"{name} was left out: shoulder and elbow scatter by {100 * scatter_m:.0f} cm about its motion;"
            " look whether it was on this upper arm, and the other IMU on the forearm"
        )
    clock = model.clock.after(coarse)
    t_s = _on_forearm_clock(recording.upper_imu.t_s, clock, forearm.clock, store)
    imu = replace(recording.upper_imu, t_s=t_s)
    for rows in split_at_pauses(imu):
        t_s[rows] = dejitter(np.array(t_s[rows]))
    ahead_ms = 1e3 * (clock.mean_s - forearm.clock.mean_s)
    where = f"{abs(ahead_ms):.1f} ms {'ahead of' if ahead_ms >= 0 else 'behind'}"
    note = f"{name} is used on the upper arm; its clock is {where} the forearm IMU's"
    return UpperArm(imu, model, _tissue(model), clock), note


def _longer(run: ImuStream) -> ImuStream:
    """A run with its first and last samples held a little: clocks known to milliseconds end apart."""
    step = 1.0 / run.rate_hz
    more = np.arange(1, max(round(PADDING_S / step), 1) + 1)
    t_s = np.concatenate([run.t_s[0] - step * more[::-1], run.t_s, run.t_s[-1] + step * more])
    acc, gyro = (
        np.pad(values, ((len(more), len(more)), (0, 0)), mode="edge") for values in (run.acc, run.gyro)
    )
    return replace(run, t_s=t_s, acc=acc, gyro=gyro)


def _on_forearm_clock(t_upper: FloatArray, upper: Clock, forearm: Clock, store: Store) -> FloatArray:
    """Stamps of the upper-arm IMU on the forearm IMU's clock, by way of the camera's."""
    t_s = store.array((len(t_upper),))
    batch = 1 << 16
    for start in range(0, len(t_upper), batch):
        rows = slice(start, start + batch)
        t = np.asarray(t_upper[rows])
        t_camera = t - upper.mean_s
        for _ in range(3):  # the offset is nearly constant: this settles at once
            t_camera = t - upper.at(t_camera)
        t_s[rows] = forearm.to_imu(t_camera)
    return t_s


def _tissue(model: SelfCalibration) -> float:
    """From the part of the residuals that lasts: soft tissue, and what the camera adds of that kind."""
    lasting = [noise.memory_m for noise in model.joint_noise.values()]
    return OPPOSED_ERROR_FACTOR * float(np.clip(max(lasting, default=0.0), LEAST_TISSUE_M, MOST_TISSUE_M))
