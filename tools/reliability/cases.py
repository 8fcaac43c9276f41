"""Set-ups, sound, unusual and wrong, each a function of a sound scene; `CASES` names them all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from smoother.array_types import BoolArray, FloatArray
from smoother.linalg import interpolate, unit
from smoother.recording import JOINTS, JointState
from tools.reliability.body import Motion, slow_noise
from tools.reliability.scene import FOREARM, TRACKED, in_columns

from .motions import EXERCISES, Gaps
from .scene import Scene, View, as_it_is, bursts_lost, evenly_restamped, turned_on_the_arm, worn_imu

ALL_JOINTS = [JOINTS.index(joint) for joint in TRACKED]
ELBOW, WRIST, HAND = FOREARM
#: How long a fault outlasts the gap it began in, s.
FAULT_S = 3.0
#: Exercises in which the arm moves enough in all directions for most faults to matter.
LIVELY = (
    "reaching out",
    "drinking",
    "combing",
    "behind the back",
    "wiping",
    "lifting",
    "wheelchair",
    "daily life",
)
EVERY = tuple(EXERCISES)


@dataclass(frozen=True)
class Case:
    """A set-up."""

    apply: Callable[[Scene], Scene]  # A sound scene to this one
    kind: str = "wrong"  # "sound" must be trusted
    exercises: tuple[str, ...] = LIVELY  # What the person does, one of these
    duration_s: tuple[float, float] = (26.0, 45.0)  # The shortest and the longest
    rate_hz: tuple[float, ...] = (30.0,)  # Of the camera, one of these
    every_s: float = 5.0  # From a gap to the next one, on average

    @property
    def name(self) -> str:
        """In words."""
        return self.apply.__name__.replace("_", " ")


# --- sound and unusual


def sound(scene: Scene) -> Scene:
    """Nothing is wrong."""
    return scene


def sound_at_another_rate(scene: Scene) -> Scene:
    """Nothing is wrong; the camera runs at 15 or 20 Hz."""
    return scene


def sound_guesses_called_inferred(scene: Scene) -> Scene:
    """In gaps the tracker guesses a hanging arm, and marks them as guesses."""
    return scene.stating(scene.film.hidden, FOREARM, _hanging(scene), JointState.INFERRED)


def sound_without_hand(scene: Scene) -> Scene:
    """A tracker that has no hand."""
    return scene.stating(np.ones(len(scene.film.t_s), bool), [HAND], scene.film.true, JointState.NOT_TRACKED)


def sound_clocks_apart(scene: Scene) -> Scene:
    """Both were started by hand, 2 to 6 s apart, and the files count from zero."""
    shift_s = float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(2.0, 6.0))
    return scene.changed(offset_s=shift_s, clocks_unrelated=True)


def sound_with_flickers(scene: Scene) -> Scene:
    """1 % of the samples 10 to 40 cm off, 3 % lost for a frame or two."""
    film, rng = scene.film, scene.rng
    wrong = (rng.uniform(size=film.state.shape) < 0.01) & (film.state == JointState.TRACKED)
    size_m = rng.uniform(0.1, 0.4, (*wrong.shape, 1))
    position = np.where(
        wrong[:, :, None], film.position + size_m * unit(rng.normal(size=film.position.shape)), film.position
    )
    lost = rng.uniform(size=len(film.t_s)) < 0.02
    lost[1:] |= lost[:-1] & (rng.uniform(size=len(lost) - 1) < 0.5)
    state = film.state.copy()
    for column in FOREARM:
        state[lost, column] = JointState.NOT_TRACKED
    return scene.changed(film=replace(film, position=position, state=state))


def sound_clock_drifts(scene: Scene) -> Scene:
    """The camera's clock gains or loses 100 to 500 millionths."""
    ppm = float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(100.0, 500.0))
    return scene.changed(film=replace(scene.film, t_s=scene.film.t_s * (1.0 + 1e-6 * ppm)))


def sound_short(scene: Scene) -> Scene:
    """A trial of 8 to 12 s from one recorder."""
    return scene


def trial_cut_by_hand(scene: Scene) -> Scene:
    """A trial of 8 to 10 s, camera and IMU cut from their recordings by eye, up to 3 s apart."""
    shift_s = float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(1.0, 3.0))
    return scene.changed(offset_s=shift_s, clocks_unrelated=True)


def shoulder_moves_fast(scene: Scene) -> Scene:
    """The trunk bends forward and back at 0.8 to 1.9 m/s, or walks; the shoulder is seen all the time."""
    state = scene.film.state.copy()
    state[:, 0] = JointState.TRACKED
    return scene.changed(film=replace(scene.film, state=state), judged_joints=("wrist", "shoulder"))


def camera_sways(scene: Scene) -> Scene:
    """A camera that somebody holds: it turns by a degree or two to and fro."""
    fine_s = np.arange(0.0, scene.duration_s + 1.0, 0.02)
    turns = slow_noise(fine_s, 3, np.radians(1.5), 1.5, scene.rng)

    def view(t_s: FloatArray, place: FloatArray) -> FloatArray:
        return Rotation.from_rotvec(interpolate(fine_s, turns, t_s)).apply(place)

    position = scene.film.position.copy()
    for column in ALL_JOINTS:
        position[:, column] = view(scene.film.t_s, position[:, column])
    return scene.changed(film=replace(scene.film, position=position), views=(view,))


# --- wrong pairs


def imu_of_another_session(scene: Scene) -> Scene:
    """The same person and exercise another day: the strap put on anew, other repetitions."""
    other = scene.other_person()
    bones = replace(scene.motion.bones, R_F_A=other.bones.R_F_A, imu_in_forearm=other.bones.imu_in_forearm)
    return _worn_by(scene, replace(other, bones=bones))


def imu_of_another_person(scene: Scene) -> Scene:
    """Somebody else's IMU, who did the same exercise."""
    return _worn_by(scene, scene.other_person())


def imu_of_another_exercise(scene: Scene) -> Scene:
    """Somebody else's IMU, who did something else."""
    return _worn_by(scene, scene.other_person(str(scene.rng.choice(EVERY))))


def imu_of_the_other_wrist(scene: Scene) -> Scene:
    """The left wrist's IMU with the right arm's skeleton."""
    scene = _worn_by(scene, scene.motion, left=True)
    return scene.changed(unpaired=False)


def imu_left_on_the_table(scene: Scene) -> Scene:
    """The sensor was taken off half-way and lies still."""
    imu, rng = scene.imu, scene.rng
    late = imu.t_s > scene.duration_s * rng.uniform(0.35, 0.65)
    acc, gyro = imu.acc.copy(), imu.gyro.copy()
    flat = Rotation.random(random_state=int(rng.integers(2**31))).apply([0.0, 0.0, 9.81])
    acc[late] = flat + rng.normal(0, 0.02, (late.sum(), 3))
    gyro[late] = gyro.mean(axis=0) * 0.1 + rng.normal(0, 0.002, (late.sum(), 3))
    return scene.changed(imu=replace(imu, acc=acc, gyro=gyro))


# --- bodies and names


def other_body_after_a_gap(scene: Scene) -> Scene:
    """Another person takes the body's number in a gap, and keeps it for 3 s."""
    away = replace(scene.motion.camera, person_K=scene.motion.camera.person_K + np.array([0.6, 0.0, 0.2]))
    other = in_columns(scene.other_person().turned(away).joints(scene.film.t_s))
    start_s, end_s = _one_gap(scene)
    wrong = scene.film.between(start_s, end_s + FAULT_S)
    return _faulty(scene.stating(wrong, ALL_JOINTS, other), end_s, end_s + FAULT_S)


def therapists_hand_for_a_while(scene: Scene) -> Scene:
    """After a gap the tracker follows the wrist and hand of a therapist who stands near, for 3 s."""
    near = replace(scene.motion.camera, person_K=scene.motion.camera.person_K + np.array([0.25, 0.1, -0.15]))
    other = in_columns(scene.other_person().turned(near).joints(scene.film.t_s))
    _, end_s = _one_gap(scene)
    wrong = scene.film.between(end_s, end_s + FAULT_S)
    return _faulty(scene.stating(wrong, [WRIST, HAND], other), end_s, end_s + FAULT_S)


def sides_exchanged_after_a_gap(scene: Scene) -> Scene:
    """Left and right exchanged for 3 s from a gap's end on."""
    _, end_s = _one_gap(scene)
    wrong = scene.film.between(end_s, end_s + FAULT_S)
    return _faulty(scene.stating(wrong, ALL_JOINTS, _left(scene)), end_s, end_s + FAULT_S)


def sides_exchanged_from_the_middle(scene: Scene) -> Scene:
    """Left and right exchanged from a moment in the middle to the end."""
    start_s = scene.duration_s * scene.rng.uniform(0.4, 0.65)
    wrong = scene.film.between(start_s, scene.duration_s) & ~scene.film.hidden
    return _faulty(scene.stating(wrong, ALL_JOINTS, _left(scene)), start_s, scene.duration_s)


def sides_exchanged(scene: Scene) -> Scene:
    """The left arm's joints under the right one's names all the time."""
    scene = scene.stating(~scene.film.hidden, ALL_JOINTS, _left(scene))
    return _faulty(scene, 0.0, scene.duration_s)


def elbow_and_wrist_exchanged(scene: Scene) -> Scene:
    """The names of elbow and wrist exchanged; half of the trackers have no hand, which would tell."""
    order = list(range(len(JOINTS)))
    order[ELBOW], order[WRIST] = WRIST, ELBOW
    film = replace(scene.film, position=scene.film.position[:, order], state=scene.film.state[:, order])
    scene = scene.changed(film=film)
    return sound_without_hand(scene) if scene.rng.uniform() < 0.5 else scene


def elbow_and_wrist_exchanged_for_a_while(scene: Scene) -> Scene:
    """The names of elbow and wrist exchanged for 3 s after a gap."""
    _, end_s = _one_gap(scene)
    order = list(range(len(JOINTS)))
    order[ELBOW], order[WRIST] = WRIST, ELBOW
    wrong = scene.film.between(end_s, end_s + FAULT_S)
    return _faulty(scene.stating(wrong, [ELBOW, WRIST], scene.film.true[:, order]), end_s, end_s + FAULT_S)


def frozen_in_sight(scene: Scene) -> Scene:
    """The skeleton stands still for 2 to 3 s while the arm moves in sight."""
    _, end_s = _one_gap(scene)
    start_s = end_s + 0.4
    stop_s = start_s + float(scene.rng.uniform(2.0, 3.0))
    wrong = scene.film.between(start_s, stop_s)
    position = scene.film.position.copy()
    position[wrong] = position[max(int(np.argmax(wrong)) - 1, 0)]
    return _faulty(scene.changed(film=replace(scene.film, position=position)), start_s, stop_s)


# --- guesses called tracked


def drape_seen_nearer(scene: Scene) -> Scene:
    """In gaps the tracker sees the drape over the arm: all of the arm 18 cm nearer to the camera."""
    nearer = scene.film.true * (1.0 - 0.18 / np.linalg.norm(scene.film.true, axis=2, keepdims=True))
    return _guessed(scene, nearer)


def guessed_hanging(scene: Scene) -> Scene:
    """In gaps the arm is stated to hang from its shoulder."""
    return _guessed(scene, _hanging(scene))


def guessed_frozen(scene: Scene) -> Scene:
    """In gaps the joints stay where they were last seen."""
    frozen = scene.film.true.copy()
    for start_s, end_s in scene.gaps:
        rows = np.flatnonzero(scene.film.between(start_s, end_s))
        frozen[rows] = frozen[max(rows[0] - 1, 0)]
    return _guessed(scene, frozen)


def guessed_at_the_hip(scene: Scene) -> Scene:
    """In gaps the hand is stated at the hip, the elbow half-way."""
    return _guessed(scene, _towards(scene, scene.motion.trunk_points(scene.film.t_s)["hip"]))


def guessed_on_the_trunk(scene: Scene) -> Scene:
    """In gaps the hand is stated in front of the belly."""
    return _guessed(scene, _towards(scene, scene.motion.trunk_points(scene.film.t_s)["belly"]))


def guessed_at_the_other_arm(scene: Scene) -> Scene:
    """In gaps the other arm is taken for this one."""
    return _guessed(scene, _left(scene))


def guessed_on_a_line(scene: Scene) -> Scene:
    """In gaps the joints go on a straight line from where they were lost to where they were found."""
    seen, line = ~scene.film.hidden, scene.film.true.copy()
    for column in FOREARM:
        line[:, column] = interpolate(scene.film.t_s[seen], line[seen, column], scene.film.t_s)
    return _guessed(scene, line)


# --- the camera


def mirrored_in_one_plane(scene: Scene) -> Scene:
    """A mirrored skeleton; what the camera sees stays in one upright plane, what it does not see does not."""
    return mirrored(scene)


def mirrored(scene: Scene) -> Scene:
    """Left and right of the camera's coordinates exchanged."""
    mirror = np.array([-1.0, 1.0, 1.0])
    film = replace(scene.film, position=scene.film.position * mirror)
    return scene.changed(film=film, views=(lambda t_s, place: place * mirror,))


def camera_turned_in_a_gap(scene: Scene) -> Scene:
    """The camera is turned by 15 degrees about the vertical while the arm is hidden."""
    sign = float(scene.rng.choice([-1.0, 1.0]))
    turn = Rotation.from_rotvec(np.radians(15.0) * sign * scene.motion.camera.R_K_P[:, 1])
    return _camera_changed(scene, lambda place: turn.apply(place.reshape(-1, 3)).reshape(place.shape))


def camera_moved_in_a_gap(scene: Scene) -> Scene:
    """The camera is moved by 25 cm while the arm is hidden."""
    shift = 0.25 * unit(scene.rng.normal(size=3) * [1.0, 0.3, 1.0])
    return _camera_changed(scene, lambda place: place + shift)


def shoulder_away_for_a_while(scene: Scene) -> Scene:
    """The tracker puts the shoulder 21 cm beside where it is, for 3 s from a gap's end on."""
    start_s, end_s = _one_gap(scene)
    away = scene.film.true + 0.21 * unit(scene.rng.normal(size=3))
    wrong = scene.film.between(start_s, end_s + FAULT_S)
    return _faulty(scene.stating(wrong, [0], away), end_s, end_s + FAULT_S)


def bones_of_another_person(scene: Scene) -> Scene:
    """From a gap's end on the skeleton has the bone lengths of somebody else: a model fitted anew."""
    _, end_s = _one_gap(scene)
    scale = 1.0 + float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(0.18, 0.30))
    true, other = scene.film.true, scene.film.true.copy()
    for column, before in ((ELBOW, 0), (WRIST, ELBOW), (HAND, WRIST)):
        other[:, column] = other[:, before] + scale * (true[:, column] - true[:, before])
    wrong = scene.film.between(end_s, scene.duration_s) & ~scene.film.hidden
    return _faulty(scene.stating(wrong, FOREARM, other), end_s, scene.duration_s)


def skeleton_scaled(scene: Scene) -> Scene:
    """All places 15 to 25 % too near or too far: the depth of another camera model."""
    scale = float(np.exp(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(0.15, 0.25)))
    film = replace(scene.film, position=scale * scene.film.position)
    return scene.changed(film=film, views=(lambda t_s, place: scale * place,))


def skeleton_smoothed_late(scene: Scene) -> Scene:
    """A skeleton that its program smooths over 0.4 s behind."""
    frames = max(round(0.4 * scene.tracker.rate_hz), 2)
    late = uniform_filter1d(scene.film.position, frames, axis=0, origin=(frames - 1) // 2, mode="nearest")
    return scene.changed(film=replace(scene.film, position=late))


def camera_stamps_stretched(scene: Scene) -> Scene:
    """Frames counted at a rate that is 3 to 8 % off: the program states 30 Hz and writes fewer."""
    scale = 1.0 + float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(0.03, 0.08))
    return scene.changed(film=replace(scene.film, t_s=scene.film.t_s * scale))


def frames_lost(scene: Scene) -> Scene:
    """The camera stops for 0.5 to 1.5 s in the middle; stamps are made up evenly over what is left."""
    film = scene.film
    start_s, length_s = scene.duration_s * scene.rng.uniform(0.3, 0.7), float(scene.rng.uniform(0.5, 1.5))
    kept = ~film.between(start_s, start_s + length_s)
    t_s = np.where(film.t_s > start_s, film.t_s - length_s, film.t_s)[kept]
    left = replace(film, t_s=t_s, true=film.true[kept], error=film.error[kept], hidden=film.hidden[kept])
    return scene.changed(film=replace(left, position=film.position[kept], state=film.state[kept]))


# --- the IMU


def samples_lost(scene: Scene) -> Scene:
    """Samples are lost in bursts, and the stamps made up evenly over what is left."""
    kept = bursts_lost(scene.imu, scene.rng.uniform(0.01, 0.05), 0.5, scene.rng)
    return scene.changed(imu=evenly_restamped(scene.imu, kept), true_t_s=scene.imu.t_s[kept])


def samples_lost_once(scene: Scene) -> Scene:
    """The radio is away for 0.5 to 2 s once; the stamps are made up evenly over what is left."""
    start_s, length_s = scene.duration_s * scene.rng.uniform(0.3, 0.7), scene.rng.uniform(0.5, 2.0)
    kept = (scene.imu.t_s < start_s) | (scene.imu.t_s >= start_s + length_s)
    return scene.changed(imu=evenly_restamped(scene.imu, kept), true_t_s=scene.imu.t_s[kept])


def accelerometer_scale_small(scene: Scene) -> Scene:
    """An accelerometer that states half to three quarters of what it feels."""
    return scene.changed(imu=replace(scene.imu, acc=scene.imu.acc * scene.rng.uniform(0.5, 0.75)))


def accelerometer_scale_nine_tenths(scene: Scene) -> Scene:
    """An accelerometer that states 90 % of what it feels."""
    return scene.changed(imu=replace(scene.imu, acc=0.9 * scene.imu.acc))


def gyroscope_scale(scene: Scene) -> Scene:
    """A gyroscope that states 70 to 85 % of the turning."""
    return scene.changed(imu=replace(scene.imu, gyro=scene.imu.gyro * scene.rng.uniform(0.7, 0.85)))


def axes_of_two_conventions(scene: Scene) -> Scene:
    """The gyroscope's axes are turned by 90 degrees against the accelerometer's."""
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return scene.changed(imu=replace(scene.imu, gyro=scene.imu.gyro @ turn.T))


def strap_put_on_anew(scene: Scene) -> Scene:
    """In a gap the sensor is taken off and put on again, turned by 90 or 180 degrees."""
    start_s, end_s = _one_gap(scene)
    turn = Rotation.from_rotvec(scene.rng.choice([0.5, 1.0]) * np.pi * unit(scene.rng.normal(size=3)))
    late = scene.imu.t_s > 0.5 * (start_s + end_s)
    return scene.changed(imu=turned_on_the_arm(scene.imu, turn.as_matrix(), late))


# --- helpers


def _worn_by(scene: Scene, other: Motion, *, left: bool = False) -> Scene:
    imu = worn_imu(other, scene.duration_s, scene.imu.rate_hz, scene.rng.spawn(1)[0], left=left)
    return scene.changed(imu=imu, sensor_is_worn=False, unpaired=True)


def _faulty(scene: Scene, start_s: float, end_s: float) -> Scene:
    return scene.changed(faulty=(*scene.faulty, (start_s, min(end_s, scene.duration_s))))


def _one_gap(scene: Scene) -> tuple[float, float]:
    """A gap, rather a long one, that leaves 3 s of sight before the end where there is one."""
    fit = [gap for gap in scene.gaps if gap[1] + FAULT_S < scene.duration_s - 1.0] or list(scene.gaps)
    lengths = np.array([end_s - start_s for start_s, end_s in fit])
    return fit[int(scene.rng.choice(len(fit), p=lengths / lengths.sum()))]


def _left(scene: Scene) -> FloatArray:
    return in_columns(scene.motion.joints(scene.film.t_s, left=True))


def _hanging(scene: Scene) -> FloatArray:
    """The arm straight down from its shoulder."""
    down, bones, true = unit(scene.motion.camera.gravity), scene.motion.bones, scene.film.true.copy()
    for column, length_m in ((ELBOW, bones.upper_arm), (WRIST, bones.forearm), (HAND, bones.hand)):
        true[:, column] = true[:, column - 1] + length_m * down
    return true


def _towards(scene: Scene, wrist: FloatArray) -> FloatArray:
    """The wrist at a place (F, 3), the elbow half-way and a little out, the hand beyond."""
    true, bones = scene.film.true.copy(), scene.motion.bones
    down = unit(scene.motion.camera.gravity)
    true[:, ELBOW] = 0.5 * (true[:, 0] + wrist) + 0.06 * down
    true[:, WRIST] = wrist
    true[:, HAND] = wrist + bones.hand * unit(wrist - true[:, ELBOW])
    return true


def _guessed(scene: Scene, places: FloatArray) -> Scene:
    """Guesses (F, 5, 3) called tracked: in all gaps of half of the recordings, in one gap of the others."""
    rows: BoolArray = scene.film.hidden
    if scene.rng.uniform() < 0.5:
        rows = rows & scene.film.between(*_one_gap(scene))
    return scene.stating(rows, FOREARM, places)


def _camera_changed(scene: Scene, change: Callable[[FloatArray], FloatArray]) -> Scene:
    """From the middle of a gap on, the camera calls all places something else."""
    start_s, end_s = _one_gap(scene)
    moment_s = 0.5 * (start_s + end_s)
    position = scene.film.position.copy()
    late = scene.film.t_s >= moment_s
    position[late] = change(position[late])

    def switched(at_s: float) -> View:
        def view(t_s: FloatArray, place: FloatArray) -> FloatArray:
            return np.where((t_s >= at_s)[:, None], change(place), place)

        return view

    # While the arm is hidden the moment cannot be known: any within the gap is treated as right.
    views = (switched(start_s), switched(moment_s), switched(end_s))
    return scene.changed(film=replace(scene.film, position=position), views=views)


SOUND: tuple[Case, ...] = (
    Case(sound, "sound", EVERY),
    Case(sound, "sound", ("reaching with tremor", "drinking with tremor", "child reaching", "slow reaching")),
    Case(sound_at_another_rate, "sound", EVERY, rate_hz=(15.0, 20.0)),
    Case(sound_guesses_called_inferred, "sound", EVERY),
    Case(sound_without_hand, "sound", EVERY),
    Case(sound_clocks_apart, "sound", LIVELY, (36.0, 50.0)),
    Case(sound_short, "sound", LIVELY, (8.0, 12.0), every_s=3.0),
    Case(sound_with_flickers, "sound", EVERY),
    Case(sound_clock_drifts, "sound", LIVELY),
)
UNUSUAL: tuple[Case, ...] = (
    Case(trial_cut_by_hand, "unusual", LIVELY, (8.0, 10.0), every_s=3.0),
    Case(shoulder_moves_fast, "unusual", ("bending forward", "walking about")),
    Case(camera_sways, "unusual"),
)
_PAIR_S = (30.0, 50.0)
WRONG: tuple[Case, ...] = (
    Case(imu_of_another_session, exercises=EVERY, duration_s=_PAIR_S),
    Case(other_body_after_a_gap),
    Case(sides_exchanged_after_a_gap),
    Case(drape_seen_nearer),
    Case(mirrored_in_one_plane, exercises=("in one plane",)),
    Case(elbow_and_wrist_exchanged),
    Case(camera_turned_in_a_gap),
    Case(samples_lost),
    Case(accelerometer_scale_small),
    Case(shoulder_away_for_a_while),
    Case(guessed_hanging),
    Case(imu_of_another_person, exercises=EVERY, duration_s=_PAIR_S),
    Case(sides_exchanged_from_the_middle),
    Case(guessed_frozen),
    Case(bones_of_another_person),
    Case(camera_moved_in_a_gap),
    Case(guessed_at_the_hip),
    Case(imu_of_the_other_wrist, exercises=(*EVERY, "bending forward")),
    Case(guessed_on_the_trunk),
    Case(therapists_hand_for_a_while),
    Case(guessed_at_the_other_arm),
    Case(accelerometer_scale_nine_tenths),
    Case(guessed_on_a_line),
    Case(mirrored),
    Case(imu_of_another_exercise, duration_s=_PAIR_S),
    Case(sides_exchanged),
    Case(elbow_and_wrist_exchanged_for_a_while),
    Case(imu_left_on_the_table),
    Case(skeleton_smoothed_late),
    Case(camera_stamps_stretched),
    Case(gyroscope_scale),
    Case(axes_of_two_conventions),
    Case(strap_put_on_anew),
    Case(samples_lost_once),
    Case(frames_lost),
    Case(frozen_in_sight),
    Case(skeleton_scaled),
)
CASES = (*SOUND, *UNUSUAL, *WRONG)

__all__ = ["CASES", "SOUND", "UNUSUAL", "WRONG", "Case", "Gaps", "as_it_is"]
