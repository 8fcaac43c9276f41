"""A scene: a motion, what both sensors make of it, and how an answer is to be held against the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration
from smoother.recording import CameraFrame, ImuStream, JointState, JointTracks, Recording
from tools.reliability.body import Motion
from tools.reliability.sensors import TRACKERS, Film, Tracker, film, plan_gaps

from .motions import Gaps, perform
from .sensors import ImuErrors, ideal_imu, measured

#: True time and places (N, 3) of the body to what the skeleton's coordinates call them.
View = Callable[[FloatArray, FloatArray], FloatArray]


def as_it_is(t_s: FloatArray, place: FloatArray) -> FloatArray:
    """The camera's coordinates as they are."""
    return place


@dataclass(frozen=True)
class Scene:
    """What is smoothed, and what is known of it.

    Attributes
    ----------
    exercise, tracker_name : str
        What the person does, and how well the tracker sees.
    duration_s : float, s
    gaps : Gaps
        When the arm is hidden, true time.
    rng : Generator
        Of the case's draws.
    motion : Motion
        Whose skeleton it is.
    tracker : Tracker
    film : Film
        What the tracker states.
    imu : ImuStream
        On the true time.
    offset_s : float, s
        t_imu = t_camera + offset; the IMU's clock is the true time.
    faulty : Gaps
        Visible times at which the camera states what is not.
    views : tuple of View
        What the truth is called in the camera's coordinates; of several, the nearest one counts.
    sensor_is_worn : bool
        The IMU is this person's own, so its position has a truth.
    unpaired : bool
        The IMU's time has nothing to do with the motion: answers are rated on the camera's clock.
    clocks_unrelated : bool
        The files count from clocks that have nothing in common.
    calibration : ArmCalibration, optional
        Given to `smooth`.
    side : str
        Stated side of the arm.
    camera_frame : CameraFrame, optional
        Stated.
    true_t_s : ndarray, shape (N,), s, optional
        When the IMU's samples were taken, where their stamps are wrong.
    judged_joints : tuple of str
        Whose places are held against the truth, besides the IMU's.
    """

    exercise: str
    tracker_name: str
    duration_s: float
    gaps: Gaps
    rng: np.random.Generator
    motion: Motion
    tracker: Tracker
    film: Film
    imu: ImuStream
    offset_s: float
    faulty: Gaps = ()
    views: tuple[View, ...] = (as_it_is,)
    sensor_is_worn: bool = True
    unpaired: bool = False
    clocks_unrelated: bool = False
    calibration: ArmCalibration | None = None
    side: str = "right"
    camera_frame: CameraFrame | None = CameraFrame.KINECT
    true_t_s: FloatArray | None = None
    judged_joints: tuple[str, ...] = ("wrist",)

    def changed(self, **changes: Any) -> Scene:
        """The scene with other fields."""
        return replace(self, **changes)

    def stating(
        self,
        rows: BoolArray,
        columns: list[int],
        places: FloatArray,
        state: JointState | None = JointState.TRACKED,
    ) -> Scene:
        """The tracker states other places (F, 5, 3) m, its own errors added, in some frames and columns."""
        position, states = self.film.position.copy(), self.film.state.copy()
        for column in columns:
            position[rows, column] = places[rows, column] + self.film.error[rows, column]
            if state is not None:
                states[rows, column] = state
        return self.changed(film=replace(self.film, position=position, state=states))

    def other_person(self, exercise: str | None = None, **changes: Any) -> Motion:
        """Somebody else, moving on their own before the same camera."""
        motion = perform(exercise or self.exercise, self.duration_s, self.rng.spawn(1)[0], self.gaps)
        return replace(motion, camera=self.motion.camera, **changes)

    @property
    def tracks(self) -> JointTracks:
        """The skeleton on the camera's clock; the same jitter of the stamps whatever the case changed."""
        return self.film.tracks(self.offset_s, np.random.default_rng(len(self.film.t_s)))

    def recording(self) -> Recording:
        """What a user gives to `smooth`."""
        stated = {each.name for each in fields(Recording)}
        flag: dict[str, Any] = {"clocks_unrelated": True} if "clocks_unrelated" in stated else {}
        return Recording(
            imu=self.imu,
            arm=self.tracks,
            side=self.side,
            camera_frame=self.camera_frame,
            name=f"{self.exercise}",
            **(flag if self.clocks_unrelated else {}),
        )


#: Sensors from good to ordinary, and rates, Hz.
IMU_RATES_HZ = (50.0, 60.0, 100.0, 120.0)


def draw_scene(
    exercise: str,
    duration_s: float,
    seed: list[int],
    *,
    tracker_name: str | None = None,
    rate_hz: float = 30.0,
    every_s: float = 5.0,
) -> Scene:
    """A sound recording of an exercise.

    Parameters
    ----------
    exercise : str
        Of `motions.EXERCISES` or `SPECIAL`.
    duration_s : float, s
    seed : list of int
        Of everything.
    tracker_name : str, optional
        Of `TRACKERS`; drawn where None.
    rate_hz : float, Hz
        Of the camera.
    every_s : float, s
        From a gap's end to the next one's start, on average.
    """
    plan_rng, motion_rng, camera_rng, imu_rng, case_rng = np.random.default_rng(seed).spawn(5)
    name = tracker_name or str(plan_rng.choice(list(TRACKERS), p=[0.3, 0.5, 0.2]))
    tracker = replace(TRACKERS[name], rate_hz=rate_hz)
    gaps = plan_gaps(duration_s, plan_rng, every_s=every_s)
    motion = perform(exercise, duration_s, motion_rng, gaps)
    imu_rate_hz = float(plan_rng.choice(IMU_RATES_HZ))
    return Scene(
        exercise=exercise,
        tracker_name=name,
        duration_s=duration_s,
        gaps=gaps,
        rng=case_rng,
        motion=motion,
        tracker=tracker,
        film=film(motion, tracker, duration_s, gaps, camera_rng),
        imu=worn_imu(motion, duration_s, imu_rate_hz, imu_rng),
        offset_s=float(plan_rng.uniform(-0.12, 0.12)),
    )


def worn_imu(
    motion: Motion, duration_s: float, rate_hz: float, rng: np.random.Generator, *, left: bool = False
) -> ImuStream:
    """An ordinary IMU on a wrist."""
    quality = rng.uniform(0.5, 1.5)
    errors = ImuErrors(acc_bias=0.05 * quality, gyro_bias=0.008 * quality, scale=0.002 * quality)
    return measured(ideal_imu(motion, duration_s, rate_hz, left=left), errors, rng)
