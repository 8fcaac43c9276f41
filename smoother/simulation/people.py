"""Several people before one camera, both arms of each, and a box of unlabelled IMUs.

Every person has measures of their own and two arms that move by a protocol of their own; IMUs are on
forearms, upper arms or the table, on clocks of their own, and the recording's names are of no use. The truth
is kept beside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..recording import CameraFrame, ImuStream, JointTracks
from .camera import debounce, exposures, shoot
from .config import ArmSimulation, Settings, setting, size
from .inertial import Pose, SegmentImuMotion, draw_upper_mount, ideal_imu, measure
from .motion import (
    ArmMotion,
    BodyMeasures,
    Stage,
    TrunkTurn,
    band_noise,
    draw_measures,
    draw_stage,
    draw_wobble,
    perform,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

SIDES: tuple[Literal["right", "left"], ...] = ("right", "left")
#: People stand side by side this far apart, m.
APART_M = 0.9
#: Who moves in time with others is early or late by this, rms, s.
ASTRAY_S = 0.12


class PeopleSimulation(Settings):
    """Who is before the camera, and what they wear; the arms and sensors themselves are an
    `ArmSimulation`.
    """

    people: int = setting(2, "persons before the camera, both arms of each", ge=1, le=6)
    sensors: int = setting(4, "IMUs in the recording", ge=1, le=24)
    on_table: int = size(1, "how many of them are on the table")
    hanging: float = size(0.25, "chance that an arm hangs while others move", le=1)
    in_time: float = size(0.5, "chance that all do the same movements at the same time", le=1)
    clocks_apart_s: float = size(1.0, "each IMU's clock is off by up to this, s, either way")
    tissue_deg: float = size(2.0, "rms of an upper arm's IMU against the bone, degrees")


@dataclass(frozen=True)
class WornImu:
    """An IMU with everything that is known of it."""

    stream: ImuStream  # Its samples, on its own clock; the name does not show where it is
    body: int | None  # Who wears it; None on the table
    joint: str  # "wrist_right", "upper_arm_left", ..; "none" on the table
    clock_offset_s: float  # Its clock minus the true time


@dataclass(frozen=True)
class SimulatedPeople:
    """A recording of several people, and its truth."""

    arms: list[tuple[int, str, JointTracks]]  # Body, side, and the arm as the camera saw it
    worn: list[WornImu]  # In the order of their names
    camera_frame: CameraFrame
    name: str

    @property
    def truth(self) -> dict[str, tuple[int | None, str]]:
        """Body and joint by the IMU's name."""
        return {one.stream.name: (one.body, one.joint) for one in self.worn}


def on_upper_arm(motion: ArmMotion, tissue_deg: float, rng: np.random.Generator) -> Pose:
    """An IMU on an upper arm, on soft tissue."""
    mount, wobble = draw_upper_mount(motion.measures, rng), draw_wobble(motion.performance, tissue_deg, rng)
    spline = make_interp_spline(motion.performance.t_s, wobble, k=5)
    return SegmentImuMotion(motion.upper_arm, mount, spline).imu_pose


def _on_table(rng: np.random.Generator) -> Pose:
    """An IMU at rest on the table."""
    R = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    return lambda t_s: (np.tile(R, (len(t_s), 1, 1)), np.tile([0.6, -0.4, 1.5], (len(t_s), 1)))


def simulate_people(
    people: PeopleSimulation | None = None, arm: ArmSimulation | None = None, seed: int = 0
) -> SimulatedPeople:
    """Simulate people with shuffled, nameless IMUs before one depth camera."""
    people = people or PeopleSimulation()
    arm = arm or ArmSimulation.preset("realistic", protocol="random", duration_s=20.0)
    worn_count = people.sensors - people.on_table
    if not 0 <= worn_count <= 4 * people.people:
        raise ValueError(
            f"{people.people} people have {4 * people.people} places for IMUs; {worn_count} are to be worn"
        )
    rng, noise_rng, imu_rng, stamp_rng = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)
    )
    motions, duration_s, gravity = _motions(people, arm, rng)
    times = exposures(duration_s, arm.frame_rate_hz, stamp_rng)
    imus = list(_worn(people, arm, motions, duration_s, gravity, rng, imu_rng))
    order = rng.permutation(len(imus))
    worn = [
        replace(imus[k], stream=replace(imus[k].stream, name=f"/imu/sensor_{place + 1}"))
        for place, k in enumerate(order)
    ]
    arms = []
    stamp_seed = int(stamp_rng.integers(2**31))
    for (body, side), motion in motions.items():
        hidden = debounce(motion.hidden(times), arm.frame_rate_hz)
        # one camera: all arms have the same frames
        rngs = (noise_rng, noise_rng, np.random.default_rng(stamp_seed))
        tracks, *_ = shoot(arm, times, motion.joints(times), hidden, rngs, "/skeleton")
        arms.append((body, side, tracks))
    return SimulatedPeople(arms, worn, arm.camera_frame, f"simulated people, seed {seed}")


def _motions(
    people: PeopleSimulation, arm: ArmSimulation, rng: np.random.Generator
) -> tuple[dict[tuple[int, str], ArmMotion], float, FloatArray]:
    """Every arm's motion by body and side, how long all of them last, and gravity in {K}."""
    stage = draw_stage(arm.distance_m, arm.camera_frame, rng)
    in_time = rng.random() < people.in_time
    shared_seed = int(rng.integers(2**31))
    motions: dict[tuple[int, str], ArmMotion] = {}
    durations = []
    for body in range(people.people):
        measures = draw_measures(rng)
        aside = stage.R_K_T @ [APART_M * (body - 0.5 * (people.people - 1)), 0.0, rng.normal(0, 0.1)]
        place = Stage(stage.R_K_T, stage.origin_K + aside)
        moving = rng.random(len(SIDES)) >= people.hanging
        sway: FloatArray | None = None
        for side, moves in zip(SIDES, moving, strict=True):
            config = arm.model_copy(update={"side": side} | ({} if moves else {"protocol": "hang"}))
            # who moves in time follows one leader, each in their own way: the same seed, other measures
            own = np.random.default_rng(shared_seed) if in_time and moves else rng
            performance = perform(config, own)
            if sway is None:
                sway = performance.sway
            n = min(len(sway), len(performance.sway))
            mirrored = sway[:n] * ([-1.0, 1.0, 1.0] if side == "left" else [1.0, 1.0, 1.0])
            performance = replace(
                performance,
                t_s=performance.t_s[:n],
                posture=varied(performance.posture[:n], performance.t_s[:n], rng),
                sway=mirrored,
            )
            wobble = draw_wobble(performance, arm.wobble_deg, rng)
            own_measures, still = mounted_anew(measures, rng), TrunkTurn(performance, 0.0, rng)
            motions[body, side] = ArmMotion(performance, own_measures, place, wobble, side, still)
            durations.append(min(performance.duration_s, float(performance.t_s[-1]) - 0.4))
    return motions, min(durations), stage.gravity


def varied(posture: FloatArray, t_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """The same movements by another person: other sizes, and now earlier, now later by `ASTRAY_S` rms."""
    size = 1 + rng.normal(0, 0.1, posture.shape[1])
    astray = ASTRAY_S * band_noise(t_s, 0.03, 0.3, 1, rng)[:, 0]
    moved = make_interp_spline(t_s, posture, k=5)(np.clip(t_s + astray, t_s[0], t_s[-1]))
    mean = posture.mean(axis=0)
    return np.asarray(mean + size * (moved - mean))


def mounted_anew(measures: BodyMeasures, rng: np.random.Generator) -> BodyMeasures:
    """The same person's other arm: the strap is put on anew."""
    other = draw_measures(rng)
    return replace(
        measures,
        strap_to_wrist=other.strap_to_wrist,
        imu_in_forearm=other.imu_in_forearm,
        R_F_A=other.R_F_A,
    )


def _worn(
    people: PeopleSimulation,
    arm: ArmSimulation,
    motions: dict[tuple[int, str], ArmMotion],
    duration_s: float,
    gravity: FloatArray,
    rng: np.random.Generator,
    imu_rng: np.random.Generator,
) -> Iterator[WornImu]:
    """The IMUs before they are shuffled."""
    places = [(body, side, segment) for body, side in motions for segment in ("wrist", "upper_arm")]
    count = people.sensors - people.on_table
    chosen = [places[k] for k in rng.choice(len(places), count, replace=False)]
    for place in [*chosen, *[None] * people.on_table]:
        offset = rng.uniform(-1, 1) * people.clocks_apart_s
        imu_pose = _on_table(rng)
        if place is not None:
            motion = motions[place[:2]]
            is_wrist = place[2] == "wrist"
            imu_pose = motion.imu_pose if is_wrist else on_upper_arm(motion, people.tissue_deg, rng)
        ideal = ideal_imu(imu_pose, duration_s, arm.imu_rate_hz, gravity)
        stream, _ = measure(ideal, arm, imu_rng)
        joint = "none" if place is None else f"{place[2]}_{place[1]}"
        yield WornImu(
            replace(stream, t_s=stream.t_s + offset), None if place is None else place[0], joint, offset
        )
