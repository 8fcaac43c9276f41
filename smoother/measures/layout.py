"""What is measured when: movements, repetitions and known angles as the answer has them.

The number of movements and means over movements are of those that each drawn motion finds in itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from .angles import ZONE_DEG, angle_figures, centre_of, centred, zone_figures
from .definitions import zone_key
from .hand import (
    bone_lengths,
    log_dimensionless_jerk,
    reach_figures,
    spectral_arc_length,
    straightness_figures,
    velocity_peaks,
    voxel_means,
    way_figures,
    zone_figures_of,
)
from .measure import UNKNOWN, Figure, MeasureSettings, Movement, Scope, share_of
from .motion import Motion
from .movements import as_movements, find_movements, find_repetitions

#: A scope and the number in it.
Place = tuple[Scope, int | None]
Figures = dict[str, Figure]
SESSION: Place = ("session", None)
#: More places make an alpha shape slow, and no other.
MOST_PLACES = 2000
#: Measures of a movement whose mean over movements describes a longer time; of a ratio it is the median.
_MEANS = ("sparc", "ldlj_v", "velocity_peaks", "hand_time_to_peak_s", "hand_time_to_peak_percent")
_MEDIANS = ("hand_path_ratio",)
#: Those that are means over the movements that a motion finds in itself, and all figures of what it finds.
BY_MOVEMENT = (*_MEANS, *_MEDIANS, "movement_duration_s")
FOUND = (*BY_MOVEMENT, "movement_time_percent", "repetition_duration_s", "repetition_duration_cv_percent")


@dataclass(frozen=True)
class Layout:
    """Where an answer is measured."""

    settings: MeasureSettings  # How
    places: tuple[slice, ...]  # Rows of the movements
    movements: tuple[Movement, ...]  # In times
    rounds: tuple[slice, ...]  # Rows of the repetitions
    repetitions: tuple[Movement, ...]
    known: dict[str, BoolArray]  # bool (n,): Where an angle is known, by its name
    centres_deg: dict[str, float]  # What an angle lies within half a turn of
    voxel_m: float  # Size of the cubes of which one place counts for the alpha shape

    @classmethod
    def of(cls, motion: Motion, settings: MeasureSettings) -> Layout:
        """As an answer's motion has it."""
        places = find_movements(motion.speed, motion.grid, settings.movements)
        repetitions = find_repetitions(motion, settings.repetitions)
        t, voxel_m, hand = motion.grid.t_s, settings.reach.voxel_m, _from_shoulder(motion)
        hand = hand[np.isfinite(hand).all(axis=1)]
        while len(hand) > MOST_PLACES and len(voxel_means(hand, voxel_m)) > MOST_PLACES:
            voxel_m *= 1.25
        rounds = [np.searchsorted(t, [each.start_s, each.end_s]).tolist() for each in repetitions]
        return cls(
            settings,
            tuple(places),
            as_movements(places, motion.grid),
            tuple(slice(first, last + 1) for first, last in rounds),
            repetitions,
            {name: np.isfinite(angle) for name, angle in motion.angles.items()},
            {name: centre_of(angle) for name, angle in motion.angles.items()},
            voxel_m,
        )

    def figures(self, motion: Motion) -> dict[Place, Figures]:
        """All figures of a motion on the same grid: of the session, the movements, the repetitions."""
        angles = {
            name: np.where(known, centred(motion.angles[name], self.centres_deg[name]), np.nan)
            for name, known in self.known.items()
            if name in motion.angles
        }
        speed = motion.speed
        own = find_movements(speed, motion.grid, self.settings.movements)
        of_own = [self._of_hand(motion, place, speed) for place in own]
        by_place: dict[Place, Figures] = {SESSION: self._of_session(motion, angles, speed, own, of_own)}
        for k, place in enumerate(self.places):
            by_place["movement", k] = self._of_movement(motion, place, angles, speed)
        for k, place in enumerate(self.rounds):
            inside = [
                each
                for each, part in zip(of_own, own, strict=True)
                if part.start < place.stop and part.stop > place.start
            ]
            by_place["repetition", k] = self._of_time(motion, place, angles, speed, inside)
        return by_place

    def _of_session(
        self,
        motion: Motion,
        angles: dict[str, FloatArray],
        speed: FloatArray,
        places: list[slice],
        of_movements: list[Figures],
    ) -> Figures:
        grid, occluded = motion.grid, motion.occluded
        everything = slice(0, len(grid.t_s))
        figures = self._of_time(motion, everything, angles, speed, of_movements)
        for name, angle in angles.items():
            for zone, figure in zone_figures(name, angle, occluded).items():
                figures[zone_key(name, zone, ZONE_DEG)] = figure
        seconds = np.array([place.stop - place.start for place in places]) / grid.rate_hz
        whole = max(len(grid.t_s), 1) / grid.rate_hz
        rounds = np.array([each.length_s for each in find_repetitions(motion, self.settings.repetitions)])
        mean = float(rounds.mean()) if len(rounds) else np.nan
        values = {
            "movement_count": float(len(places)),
            "movement_time_percent": 100.0 * float(seconds.sum()) / whole,
            "movement_duration_s": float(seconds.mean()) if len(places) else np.nan,
            "repetition_count": float(len(rounds)),
            "repetition_duration_s": mean,
            "repetition_duration_cv_percent": 100.0 * float(rounds.std(ddof=1)) / mean
            if len(rounds) > 2
            else np.nan,
        }
        share = share_of(occluded)
        return figures | {key: Figure(value, share) for key, value in values.items()}

    def _of_time(
        self,
        motion: Motion,
        place: slice,
        angles: dict[str, FloatArray],
        speed: FloatArray,
        of_movements: list[Figures],
    ) -> Figures:
        """What both a session and a repetition have."""
        occluded, rate = motion.occluded[place], motion.grid.rate_hz
        figures: Figures = {}
        for name, angle in angles.items():
            figures |= angle_figures(name, angle[place], occluded, rate)
        figures |= way_figures(motion.hand[place], speed[place], occluded, rate, _inside(motion, place))
        figures |= self._reach(motion, place)
        figures |= zone_figures_of(motion, place, self.settings.reach)
        for key in (*_MEANS, *_MEDIANS):
            known = [each[key] for each in of_movements if np.isfinite(each[key].value)]
            values, shares = ([figure[k] for figure in known] for k in (0, 1))
            middle = np.median if key in _MEDIANS else np.mean
            figures[key] = Figure(float(middle(values)), float(np.mean(shares))) if known else UNKNOWN
        return figures

    def _of_movement(
        self, motion: Motion, place: slice, angles: dict[str, FloatArray], speed: FloatArray
    ) -> Figures:
        occluded, rate, hand = motion.occluded[place], motion.grid.rate_hz, motion.hand[place]
        figures: Figures = {}
        for name, angle in angles.items():
            figures |= angle_figures(name, angle[place], occluded, rate)
        figures |= way_figures(hand, speed[place], occluded, rate, (slice(0, len(hand)),))
        return figures | self._of_hand(motion, place, speed)

    def _of_hand(self, motion: Motion, place: slice, speed: FloatArray) -> Figures:
        """The figures of a movement that sessions have as means."""
        occluded, rate = motion.occluded[place], motion.grid.rate_hz
        pace, settings = speed[place], self.settings.movements
        peaks = velocity_peaks(pace, rate, settings.peak_rise_m_s, settings.peak_apart_s)
        values = {
            "sparc": spectral_arc_length(pace, rate),
            "ldlj_v": log_dimensionless_jerk(pace, rate),
            "velocity_peaks": float(len(peaks)),
            "duration_s": (len(pace) - 1) / rate,
        }
        share = share_of(occluded)
        figures = {key: Figure(value, share) for key, value in values.items()}
        return straightness_figures(motion.hand[place], pace, occluded, rate) | figures

    def _reach(self, motion: Motion, place: slice) -> Figures:
        reach, lengths = self.settings.reach, bone_lengths(motion)
        bones = ("upper_arm", "forearm", *(("hand",) if motion.hand_joint == "hand" else ()))
        arm_m = sum(lengths.get(bone, np.nan) for bone in bones)
        places = _from_shoulder(motion)[place]
        return reach_figures(places, motion.occluded[place], arm_m, self.voxel_m, reach.alpha_m)


def _from_shoulder(motion: Motion) -> FloatArray:
    """The hand's places (n, 3) from the shoulder, where there is one."""
    return motion.hand - motion.joints["shoulder"] if "shoulder" in motion.joints else motion.hand


def _inside(motion: Motion, place: slice) -> tuple[slice, ...]:
    """The grid's runs within some rows, counted from the first of these."""
    parts = [
        slice(max(run.start, place.start) - place.start, min(run.stop, place.stop) - place.start)
        for run in motion.grid.runs
    ]
    return tuple(part for part in parts if part.stop > part.start)
