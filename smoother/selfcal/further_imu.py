"""Self-calibration of an IMU on a segment beyond the forearm.

A segment's two joints are to its IMU what elbow and wrist are to the forearm's (shoulder and elbow on the
upper arm). So nothing is new here: the same clocks, closed form and rounds give both joints in its axes, and
its clock against the camera's; with the forearm IMU's clock that is the clock of one IMU against the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..body import FURTHER, BodySegment
from ..calibration import ArmCalibration, SegmentMounting
from ..config import Config
from ..errors import UnoccludeError
from ..measurements.clock import Clock
from ..measurements.outliers import reject_by_camera
from ..measurements.segment import Segment, Timeline, without_spikes
from ..measurements.timestamps import dejitter, split_at_pauses
from ..recording import JOINTS, ImuStream, Recording
from ..runtime.pool import Pool
from ..runtime.store import large_array
from .excerpts import informative_excerpts
from .pairing import pair
from .rounds import self_calibrate
from .self_calibration import SelfCalibration

#: A run's ends are held this much longer, s.
PADDING_S = 0.02
#: Rounds at most: the windows with both IMUs refine all but the clock.
ROUNDS = 3
#: How far the joints are from constant in the IMU's axes, m per axis: no less and no more than this.
LEAST_TISSUE_M, MOST_TISSUE_M = 0.003, 0.04
#: Tissue turns the IMU against the bone, so that both joints, on both sides of it, are off in opposite
#: directions at the same time: as independent errors of sqrt(2) times the size they turn the bone as far.
OPPOSED_ERROR_FACTOR = float(np.sqrt(2.0))
#: Where the joints scatter by more, per axis, the IMU is on another limb: the right one shows 0.016 at
#: most on simulated arms, the forearm's or another person's 0.060.
WRONG_LIMB_M = 0.05
#: An IMU that a joint hangs on must have samples in this share of the recording: elsewhere it has no answer.
LEAST_COVER = 0.5
#: A run of samples shorter than this is not worth a filter.
FEWEST_SAMPLES = 40


@dataclass(frozen=True)
class FurtherImu:
    """Evidence of the visible motion on an IMU on a segment beyond the forearm."""

    segment: BodySegment
    imu: ImuStream  # Its samples, on its own clock
    # Of the segment, whose joints have the names of the forearm's in it (`BodySegment.as_forearm`)
    model: SelfCalibration
    clock: Clock  # Of the camera against it

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
        """The forearm's model with what is known of this IMU."""
        own, name, joints = self.model, self.segment.name, self.segment.as_forearm

        def with_own(arm: ArmCalibration, levers: ArmCalibration) -> ArmCalibration:
            of_joints = {joints[key]: lever for key, lever in levers.lever_arms.items() if key in joints}
            return replace(arm, mountings=arm.mountings | {name: SegmentMounting(of_joints, _tissue(own))})

        noise, sigma_m = dict(forearm.joint_noise), forearm.joint_sigma_m.copy()
        for key, joint in joints.items():
            if joint in self.segment.camera_joints:
                sigma_m[..., JOINTS.index(joint)] = own.joint_sigma_m[..., JOINTS.index(key)]
                noise |= {
                    each.replace(key, joint): found
                    for each, found in own.joint_noise.items()
                    if each.partition("@")[0] == key
                }
        bias = np.concatenate([np.zeros(3), own.initial.gyroscope_bias])
        return replace(
            forearm,
            estimate=with_own(forearm.estimate, own.estimate),
            prior=with_own(forearm.prior, own.prior),
            initial=replace(forearm.initial, biases=forearm.initial.biases | {name: bias}),
            joint_noise=noise,
            joint_sigma_m=sigma_m,
            further_clock_offset_s=forearm.further_clock_offset_s | {name: self.clock.mean_s},
        )

    def on_clock(self, forearm: Clock) -> tuple[FurtherImu, str]:
        """With its samples on the forearm IMU's clock, dejittered, and a sentence on that."""
        t_s = _on_forearm_clock(self.imu.t_s, self.clock, forearm)
        imu = replace(self.imu, t_s=t_s)
        for rows in split_at_pauses(imu):
            t_s[rows] = dejitter(np.array(t_s[rows]))
        ahead_ms = 1e3 * (self.clock.mean_s - forearm.mean_s)
        where = f"{abs(ahead_ms):.1f} ms {'ahead of' if ahead_ms >= 0 else 'behind'}"
        return replace(self, imu=imu), (
            f"{imu.name} is used on the {self.segment.label}; its clock is {where} the forearm IMU's"
        )


def calibrate_further_imus(
    recording: Recording, given: ArmCalibration, config: Config, workers: Pool
) -> tuple[list[FurtherImu], list[str]]:
    """All of a recording's IMUs beyond the forearm that can be used, and why others were left out."""
    further, left_out = [], []
    for segment in FURTHER:
        if segment.name in recording.further_imus:
            found, note = calibrate_further_imu(recording, segment, given, config, workers)
            if found is None:
                left_out.append(note)
            else:
                further.append(found)
    return further, left_out


def without_joints_of(excerpt: Segment, further: Sequence[FurtherImu]) -> Segment:
    """An excerpt for the forearm, without the joints that belong to a segment with an IMU of its own."""
    columns = [JOINTS.index(joint) for imu in further for joint in imu.segment.camera_joints]
    if not columns:
        return excerpt
    accepted = excerpt.accepted.copy()
    accepted[:, columns] = False
    return replace(excerpt, accepted=accepted)


def joined(
    forearm: SelfCalibration, further: Sequence[FurtherImu]
) -> tuple[SelfCalibration, list[FurtherImu], list[str]]:
    """The forearm's model with the further IMUs, these on the forearm IMU's clock, and a sentence on each."""
    placed, notes = [], []
    for imu in further:
        forearm = imu.joined(forearm)
        moved, note = imu.on_clock(forearm.clock)
        placed.append(moved)
        notes.append(note)
    return forearm, placed, notes


def calibrate_further_imu(
    recording: Recording,
    segment: BodySegment,
    given: ArmCalibration,
    config: Config,
    workers: Pool,
) -> tuple[FurtherImu | None, str]:
    """Find how an IMU sits on a segment beyond the forearm, and its clock."""
    imu = recording.further_imus[segment.name]
    as_forearm = replace(
        recording, imu=imu, arm=segment.seen_as_forearm(recording.arm), truth=None, further_imus={}
    )
    known = given.mountings[segment.name].lever_arms if segment.name in given.mountings else {}
    levers = {name: known[joint] for name, joint in segment.as_forearm.items() if joint in known}
    near, far = (segment.as_forearm[end] for end in ("elbow", "wrist"))
    covers = _sampled_s(imu) / max(_sampled_s(recording.imu), 1e-9)
    if segment.camera_joints and covers < LEAST_COVER:
        return None, (
            f"{imu.name} was left out: it has samples in {100 * covers:.0f} % of the recording only, and"
            f" without them the {far} would have no result"
        )
    try:
        as_forearm, coarse, _ = pair(as_forearm)
        excerpts = [
            reject_by_camera(excerpt) for excerpt in informative_excerpts(as_forearm, Timeline.of(as_forearm))
        ]
        if not excerpts:
            return None, f"{imu.name} was left out: the camera never saw {near} and {far} with its samples"
        model = self_calibrate(
            excerpts, ArmCalibration(side=given.side, lever_arms=levers), config, workers, rounds=ROUNDS
        )
    except UnoccludeError as error:
        return None, f"{imu.name} was left out: {str(error).removeprefix(f'{recording.name}: ')}"
    if set(segment.as_forearm) - set(model.estimate.lever_arms) or model.mounting_unknown:
        return None, f"{imu.name} was left out: the {segment.label} hardly moved in view; {segment.remedy}"
    scatter_m = max(noise.sample_m for noise in model.joint_noise.values())
    if scatter_m > WRONG_LIMB_M:
        return None, (
            f"{imu.name} was left out: {near} and {far} scatter by {100 * scatter_m:.0f} cm about its motion;"
            f" check that it was on this {segment.label}, and the other IMU on the forearm"
        )
    return FurtherImu(segment, imu, model, model.clock.after(coarse)), ""


def _sampled_s(imu: ImuStream) -> float:
    """Time between the pauses, s."""
    return sum(float(imu.t_s[rows.stop - 1] - imu.t_s[rows.start]) for rows in split_at_pauses(imu))


def _longer(run: ImuStream) -> ImuStream:
    """A run with its first and last samples held a little: clocks known to milliseconds end apart."""
    step = 1.0 / run.rate_hz
    more = np.arange(1, max(round(PADDING_S / step), 1) + 1)
    t_s = np.concatenate([run.t_s[0] - step * more[::-1], run.t_s, run.t_s[-1] + step * more])
    acc, gyro = (
        np.pad(values, ((len(more), len(more)), (0, 0)), mode="edge") for values in (run.acc, run.gyro)
    )
    return replace(run, t_s=t_s, acc=acc, gyro=gyro)


def _on_forearm_clock(t_own: FloatArray, own: Clock, forearm: Clock) -> FloatArray:
    """Stamps of an IMU on the forearm IMU's clock, by way of the camera's."""
    t_s = large_array((len(t_own),))
    batch = 1 << 16
    for start in range(0, len(t_own), batch):
        rows = slice(start, start + batch)
        t = np.asarray(t_own[rows])
        t_camera = t - own.mean_s
        for _ in range(3):  # the offset is nearly constant: this settles at once
            t_camera = t - own.at(t_camera)
        t_s[rows] = forearm.to_imu(t_camera)
    return t_s


def _tissue(model: SelfCalibration) -> float:
    """From the part of the residuals that lasts: soft tissue, and what the camera adds of that kind."""
    lasting = [noise.memory_m for noise in model.joint_noise.values()]
    return OPPOSED_ERROR_FACTOR * float(np.clip(max(lasting, default=0.0), LEAST_TISSUE_M, MOST_TISSUE_M))
