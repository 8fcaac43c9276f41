"""`measure`: the measures of a recovery, each with its interval from the drawn motions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..linalg import nearest, rotate_covariance
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from .definitions import FEWEST_DRAWS, definition_of, definitions, interval
from .figures import (
    Figures,
    angle_figures,
    bone_lengths,
    centre_of,
    centred,
    log_dimensionless_jerk,
    reach_figures,
    spectral_arc_length,
    straightness_figures,
    velocity_peaks,
    voxel_means,
    way_figures,
    zone_figures,
    zone_figures_of,
)
from .measure import UNKNOWN, Figure, Measure, Measures, MeasureSettings, Movement, Scope, share_of
from .motion import ElbowBend, Motion, grid_of, motion_of
from .movements import find_movements, find_repetitions

#: A scope and the number in it.
Place = tuple[Scope, int | None]
SESSION: Place = ("session", None)
#: More places make an alpha shape slow, and no other.
MOST_PLACES = 2000
#: A drawn motion takes at least as long to measure as this many camera frames take to recover.
FRAMES_A_DRAW = 200
#: A shoulder turns about its long axis by some 180 degrees; a wider range is one of the angles' definition.
WIDE_ROTATION_DEG = 180.0


@dataclass(frozen=True)
class Layout:
    """What is measured when: movements, repetitions and known angles as an answer has them.

    The number of movements and means over movements are of those that each drawn motion finds in itself.
    """

    settings: MeasureSettings
    rows: dict[Place, slice]  # Of the session, each movement, each repetition
    times: dict[Place, Movement]  # Of movements and repetitions
    known: dict[str, BoolArray]  # bool (n,): Where an angle is known, by its name
    centres_deg: dict[str, float]  # What an angle lies within half a turn of
    voxel_m: float  # Size of the cubes of which one place counts for the alpha shape

    @classmethod
    def of(cls, motion: Motion, settings: MeasureSettings) -> Layout:
        """As an answer's motion has it."""
        t, voxel_m, hand = motion.grid.t_s, settings.reach.voxel_m, motion.hand_from_shoulder
        hand = hand[np.isfinite(hand).all(axis=1)]
        while len(hand) > MOST_PLACES and len(voxel_means(hand, voxel_m)) > MOST_PLACES:
            voxel_m *= 1.25
        rows: dict[Place, slice] = {SESSION: slice(0, len(t))}
        times: dict[Place, Movement] = {}
        for k, part in enumerate(find_movements(motion.speed, motion.grid, settings.movements)):
            rows["movement", k] = part
            times["movement", k] = Movement(float(t[part.start]), float(t[part.stop - 1]), "movement")
        for k, each in enumerate(find_repetitions(motion, settings.repetitions)):
            first, last = np.searchsorted(t, [each.start_s, each.end_s]).tolist()
            rows["repetition", k], times["repetition", k] = slice(first, last + 1), each
        known = {name: np.isfinite(angle) for name, angle in motion.angles.items()}
        centres_deg = {name: centre_of(angle) for name, angle in motion.angles.items()}
        return cls(settings, rows, times, known, centres_deg, voxel_m)

    def figures(self, motion: Motion) -> dict[Place, Figures]:
        """All figures of a motion on the same grid: of the session, the movements, the repetitions."""
        angles = {
            name: np.where(known, centred(motion.angles[name], self.centres_deg[name]), np.nan)
            for name, known in self.known.items()
            if name in motion.angles
        }
        own = find_movements(motion.speed, motion.grid, self.settings.movements)
        of_own = [self._of_hand(motion, place) for place in own]
        by_place: dict[Place, Figures] = {}
        for place, rows in self.rows.items():
            figures = self._of_angles_and_way(motion, rows, angles)
            if place[0] == "movement":
                figures |= self._of_hand(motion, rows)
            else:
                parts = zip(of_own, own, strict=True)
                inside = [each for each, part in parts if part.start < rows.stop and part.stop > rows.start]
                figures |= self._of_long_time(motion, rows, inside)
            if place == SESSION:
                figures |= self._of_counts(motion, own)
            by_place[place] = {
                key: figures.get(key, UNKNOWN)  # of the angles that there are
                for key, row in definitions().items()
                if place[0] in row.scopes and (not row.angle or row.angle in angles)
            }
        for name, angle in angles.items():
            by_place[SESSION] |= zone_figures(name, angle, motion.occluded)
        return by_place

    def _of_counts(self, motion: Motion, places: list[slice]) -> Figures:
        """What a session has of its movements and repetitions."""
        rate_hz = motion.grid.rate_hz
        seconds = np.array([place.stop - place.start for place in places]) / rate_hz
        rounds = np.array([each.length_s for each in find_repetitions(motion, self.settings.repetitions)])
        mean = float(rounds.mean()) if len(rounds) else np.nan
        spread = 100.0 * float(rounds.std(ddof=1)) / mean if len(rounds) > 2 else np.nan
        values = {
            "movement_count": float(len(places)),
            "movement_time_percent": 100.0 * float(seconds.sum()) / (max(len(motion.grid.t_s), 1) / rate_hz),
            "movement_duration_s": float(seconds.mean()) if len(places) else np.nan,
            "repetition_count": float(len(rounds)),
            "repetition_duration_s": mean,
            "repetition_duration_cv_percent": spread,
        }
        share = share_of(motion.occluded)
        return {key: Figure(value, share) for key, value in values.items()}

    def _of_long_time(self, motion: Motion, rows: slice, movements: list[Figures]) -> Figures:
        """What both a session and a repetition have beyond a movement."""
        lengths, reach = bone_lengths(motion), self.settings.reach
        bones = ("upper_arm", "forearm", *(("hand",) if motion.hand_joint == "hand" else ()))
        arm_m = sum(lengths.get(bone, np.nan) for bone in bones)
        places, occluded = motion.hand_from_shoulder[rows], motion.occluded[rows]
        figures = reach_figures(places, occluded, arm_m, self.voxel_m, reach.alpha_m)
        figures |= zone_figures_of(motion, rows, reach)
        for key, row in definitions().items():
            known = [each[key] for each in movements if key in each and np.isfinite(each[key].value)]
            if row.over_movements and known:
                middle = np.median if row.over_movements == "median" else np.mean
                values, shares = zip(*known, strict=True)
                figures[key] = Figure(float(middle(values)), float(np.mean(shares)))
        return figures

    def _of_angles_and_way(self, motion: Motion, place: slice, angles: dict[str, FloatArray]) -> Figures:
        """Figures common to sessions, movements and repetitions."""
        occluded, rate_hz = motion.occluded[place], motion.grid.rate_hz
        figures: Figures = {}
        for name, angle in angles.items():
            figures |= angle_figures(name, angle[place], occluded, rate_hz)
        parts = [  # the grid's runs within these rows, counted from the first of them
            slice(max(run.start, place.start) - place.start, min(run.stop, place.stop) - place.start)
            for run in motion.grid.runs
        ]
        runs = tuple(part for part in parts if part.stop > part.start)
        return figures | way_figures(motion.hand[place], motion.speed[place], occluded, rate_hz, runs)

    def _of_hand(self, motion: Motion, place: slice) -> Figures:
        """The figures of a movement that sessions have as means."""
        occluded, rate_hz, pace = motion.occluded[place], motion.grid.rate_hz, motion.speed[place]
        settings = self.settings.movements
        peaks = velocity_peaks(pace, rate_hz, settings.peak_rise_m_s, settings.peak_apart_s)
        values = {
            "sparc": spectral_arc_length(pace, rate_hz),
            "ldlj_v": log_dimensionless_jerk(pace, rate_hz),
            "velocity_peaks": float(len(peaks)),
            "duration_s": (len(pace) - 1) / rate_hz,
        }
        share = share_of(occluded)
        figures = {key: Figure(value, share) for key, value in values.items()}
        return figures | straightness_figures(motion.hand[place], pace, occluded, rate_hz)


def _figures_of(task: tuple[Layout, Motion]) -> dict[Place, Figures]:
    """Everything that is measured of a drawn motion: a job for a worker."""
    layout, motion = task
    return layout.figures(motion)


def drawn_motion(recovery: Recovery, k: int) -> Recovery:
    """A drawn motion, with the errors that draws leave out: how the IMUs on upper arm and trunk sit."""
    drawn = recovery.drawn(k)
    assert recovery.draws is not None
    rng = np.random.default_rng([recovery.draws.seed, k])
    calibration, upper, trunk = drawn.calibration, recovery.upper, recovery.trunk
    if upper is not None and calibration is not None and calibration.R_U_B is not None:
        off = Rotation.from_rotvec(rng.normal(0.0, upper.mount_sigma_rad)).as_matrix()
        drawn = replace(drawn, calibration=calibration.with_bone_axes("upper_arm", off @ calibration.R_U_B))
    if trunk is not None:
        known = np.flatnonzero(np.isfinite(trunk.quaternion).all(axis=1))
        R_K_T = Rotation.from_quat(trunk.quaternion[known], scalar_first=True)
        own = rotate_covariance(R_K_T.inv().as_matrix(), trunk.covariance[known]) if len(known) else None
        mean = np.zeros(3) if own is None else np.nanmean(np.einsum("nii->ni", own), axis=0)
        turn = Rotation.from_rotvec(rng.normal(0.0, np.sqrt(mean + trunk.mount_sigma_rad**2)))
        quaternion = trunk.quaternion.copy()
        quaternion[known] = (R_K_T * turn).as_quat(scalar_first=True)
        drawn = replace(drawn, trunk=replace(trunk, quaternion=quaternion))
    return drawn


class Measuring:
    """A recovery as it is measured: its layout, and every figure of answer and draws.

    The drawn motions are measured on this many worker processes (0 = one per core).
    """

    def __init__(
        self,
        recovery: Recovery,
        settings: MeasureSettings,
        processes: int = 1,
        progress: Progress | None = None,
    ) -> None:
        grid, cutoff_hz = grid_of(recovery, settings.smoothing), settings.smoothing.cutoff_hz
        self.recovery, self.count = recovery, 0 if recovery.draws is None else len(recovery.draws)
        self.motion = motion = motion_of(recovery, grid, cutoff_hz)
        self.layout = layout = Layout.of(motion, settings)

        def drawn_of(k: int) -> Motion:
            return motion_of(drawn_motion(recovery, k), grid, cutoff_hz)

        bend = None
        if self.count >= FEWEST_DRAWS:
            bend = ElbowBend.of(motion, map(drawn_of, range(FEWEST_DRAWS)))
        self.bend = bend

        def corrected(k: int) -> Motion:
            if bend is None or recovery.draws is None:
                return drawn_of(k)
            rng = np.random.default_rng([recovery.draws.seed, k, 1])
            return bend.corrected(drawn_of(k), float(rng.uniform()), is_drawn=True)

        answer = motion if bend is None else bend.corrected(motion)
        self.answer = layout.figures(answer)
        # The answer's figures with the share that comes from samples not to be trusted; empty where all are
        self.untrusted: dict[Place, Figures] = {}
        if len(grid.t_s) and not recovery.trusted.all():
            # a figure's share is of the samples that the motion has as occluded
            wrong = np.asarray(~recovery.trusted[nearest(recovery.t_s, grid.t_s)])
            self.untrusted = layout.figures(replace(answer, occluded=wrong))
        self._drawn: dict[tuple[Place, str], FloatArray] = {}
        with Pool(processes, FRAMES_A_DRAW * self.count) as workers:
            done = workers.map(_figures_of, ((layout, corrected(k)) for k in range(self.count)))
            for k, by_place in enumerate(done):
                if progress is not None:
                    progress(k / self.count, f"drawn motion {k + 1} of {self.count}")
                for place, figures in by_place.items():
                    for key, figure in figures.items():
                        self._drawn.setdefault((place, key), self.drawn(place, key))[k] = figure.value

    def drawn(self, place: Place, key: str) -> FloatArray:
        """A measure of the drawn motions, (count,); nan, or no time in a zone, where one has none."""
        found = self._drawn.get((place, key))
        return np.full(self.count, 0.0 if "_zone_" in key else np.nan) if found is None else found

    def rows(self, place: Place) -> list[Measure]:
        """The measures of the session, a movement or a repetition."""
        figures = dict(self.answer[place])
        if place == SESSION:
            zones = (key for of, key in self._drawn if of == place and "_zone_" in key)
            figures |= {key: Figure(0.0, 0.0) for key in zones if key not in figures}
            missing = {key: row for key, row in definitions().items() if row.angle in self.motion.missing}
            figures |= dict.fromkeys(missing, UNKNOWN)
        return [self._row(place, key, figure) for key, figure in figures.items()]

    def _row(self, place: Place, key: str, figure: Figure) -> Measure:
        definition = definition_of(key)
        low, high, sigma = self.interval(place, key, figure.value)
        untrusted = float(np.nan_to_num(self.untrusted.get(place, {}).get(key, UNKNOWN).share))
        words = "" if np.isfinite(figure.value) else self._why(key)
        # of a recording that is not trusted at all, the verdict says so
        if not words and untrusted > 0.0 and self.recovery.estimates.trusted is not False:
            words = f"Rests to {max(100.0 * untrusted, 1.0):.0f} % on gaps that are not trusted."
        count = self.count if np.isfinite(low) else 0
        what = (key, definition.name, definition.unit, figure.value, low, high, sigma, figure.share)
        return Measure(*what, *place, *self.times(place), count, words, untrusted)

    def interval(self, place: Place, key: str, value: float) -> tuple[float, float, float]:
        """The 95 % interval about a measure's value, and its standard deviation; nan without draws."""
        definition = definition_of(key)
        is_found = place[0] != "movement" and definition.is_found
        low, high, sigma = interval(value, self.drawn(place, key), definition, is_found)
        is_flexion = definition.angle == "elbow_flexion" and definition.high == 180.0  # no range, no speed
        if self.bend is not None and is_flexion and np.isfinite(low):
            low = self.bend.lower(low)
        return low, high, sigma

    def times(self, place: Place) -> tuple[float, float]:
        """From when to when, s; nan where there is no answer."""
        if (own := self.layout.times.get(place)) is not None:
            return own.start_s, own.end_s
        t = self.motion.grid.t_s
        return (float(t[0]), float(t[-1])) if len(t) else (float("nan"), float("nan"))

    def _why(self, key: str) -> str:
        """Why a measure has no value, in a sentence."""
        definition = definition_of(key)
        if not definition.angle:
            return definition.why_not
        if definition.angle in self.motion.missing:
            return self.motion.missing[definition.angle]
        if not np.isfinite(self.layout.centres_deg[definition.angle]):
            return "The angle made a full turn: it has no smallest and largest value."
        return "The angle is known for less than 0.3 s here."

    def measures(self) -> Measures:
        """What was measured, as a table of measures."""
        recovery, times = self.recovery, self.layout.times.values()
        rows = [row for place in self.answer for row in self.rows(place)]
        return Measures(
            *(recovery.side, recovery.body, recovery.name, *self.times(SESSION), tuple(rows)),
            movements=tuple(each for each in times if each.kind == "movement"),
            repetitions=tuple(each for each in times if each.kind == "repetition"),
            trusted=recovery.estimates.trusted,
            verdict=recovery.estimates.verdict,
            n_draws=self.count,
            notes=tuple(self._notes()),
        )

    def _notes(self) -> list[str]:
        """Notes on all measures of an arm."""
        recovery, motion, notes = self.recovery, self.motion, []
        if not len(motion.grid.t_s):
            notes.append("There is no answer to measure.")
        if self.count < FEWEST_DRAWS:
            notes.append(
                f"There are no intervals: {self.count} drawn motions are too few; smooth the recording"
                " with --draws 64."
            )
        if motion.hand_joint != "hand":
            instead = "the IMU" if motion.hand_joint == "imu" else f"the {motion.hand_joint}"
            notes.append(f"The recording has no hand; {instead} is used instead.")
        session = self.answer[SESSION]
        low, high, _ = self.interval(SESSION, "movement_count", session["movement_count"].value)
        if low < high:
            notes.append(
                f"The drawn motions have {low:.0f} to {high:.0f} movements. Those listed are the result's;"
                " their intervals are over their samples and do not include whether another motion has them."
            )
        turned = session.get("shoulder_rotation_range_deg", UNKNOWN).value
        if turned > WIDE_ROTATION_DEG:
            notes.append(
                f"Shoulder rotation spans {turned:.0f} degrees, more than a shoulder turns: near a hanging or"
                " a raised arm plane and rotation turn about nearly the same axis, and only their sum is"
                " defined (ISB); compare their range over movements at the side or in front."
            )
        if (recovery.trunk is None or not recovery.trunk.by_imu) and motion.R_K_T is not None:
            notes.append(
                "There is no IMU on the trunk: it is assumed upright and facing the camera, for the"
                " shoulder's angles and for where mouth, head and back are."
            )
        return notes


def measure(
    recovery: Recovery,
    settings: MeasureSettings | None = None,
    processes: int = 1,
    progress: Progress | None = None,
) -> Measures:
    """Measure a recovered motion: joints, hand, smoothness, movements, repetitions.

    Parameters
    ----------
    recovery : Recovery
        With draws (`smooth(.., draws=64)`) for the intervals; without them there are none.
    settings : MeasureSettings, optional
        Thresholds and sizes.
    processes : int
        Worker processes for the drawn motions, 0 = one per core; the measures are the same with any number.
    progress : callable, optional
        Called with the share done (0 to 1) and its label.

    Returns
    -------
    measures : Measures
        Of the session, each movement and each repetition; formulas and sources in docs/measures.md.
    """
    return Measuring(recovery, settings or MeasureSettings(), processes, progress).measures()
