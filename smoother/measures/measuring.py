"""`measure`: the measures of a recovery, each with its interval from the drawn motions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..linalg import nearest, rotate_covariance
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from .angles import PERCENTILES
from .definitions import FEWEST_DRAWS, definition_of, interval
from .layout import FOUND, SESSION, Figures, Layout, Place
from .measure import UNKNOWN, Figure, Measure, Measures, MeasureSettings
from .motion import ElbowBend, Motion, grid_of, motion_of

#: A drawn motion takes at least as long to measure as this many camera frames take to recover.
FRAMES_A_DRAW = 200
#: A shoulder turns about its long axis by some 180 degrees; a wider range is one of the angles' definition.
WIDE_ROTATION_DEG = 180.0


def _figures_of(task: tuple[Layout, Motion]) -> dict[Place, Figures]:
    """Everything that is measured of a drawn motion: a job for a worker."""
    layout, motion = task
    return layout.figures(motion)


class DrawnFigures:
    """Every measure of every drawn motion."""

    def __init__(
        self,
        recovery: Recovery,
        layout: Layout,
        motion: Motion,
        processes: int = 1,
        progress: Progress | None = None,
    ) -> None:
        self.count = 0 if recovery.draws is None else len(recovery.draws)
        self._by_place: dict[Place, dict[str, FloatArray]] = {}
        cutoff_hz = layout.settings.smoothing.cutoff_hz

        def drawn_of(k: int) -> Motion:
            return motion_of(drawn_motion(recovery, k), motion.grid, cutoff_hz)

        self.bend = bend = None
        if self.count >= FEWEST_DRAWS:
            self.bend = bend = ElbowBend.of(motion, map(drawn_of, range(FEWEST_DRAWS)))
        self.answer = motion if bend is None else bend.corrected(motion)

        def corrected(k: int) -> Motion:
            if bend is None or recovery.draws is None:
                return drawn_of(k)
            rng = np.random.default_rng([recovery.draws.seed, k, 1])
            return bend.corrected_draw(drawn_of(k), float(rng.uniform()))

        with Pool(processes, FRAMES_A_DRAW * self.count) as workers:
            done = workers.map(_figures_of, ((layout, corrected(k)) for k in range(self.count)))
            for k, by_place in enumerate(done):
                if progress is not None:
                    progress(k / self.count, f"drawn motion {k + 1} of {self.count}")
                for place, figures in by_place.items():
                    of_place = self._by_place.setdefault(place, {})
                    for key, figure in figures.items():
                        if key not in of_place:  # a zone in which no motion before ever was
                            of_place[key] = np.full(self.count, 0.0 if "_zone_" in key else np.nan)
                        of_place[key][k] = figure.value

    def values(self, place: Place, key: str) -> FloatArray:
        """(count,) of a measure; nan where a motion has none."""
        absent = 0.0 if "_zone_" in key else np.nan
        return self._by_place.get(place, {}).get(key, np.full(self.count, absent))

    def zones(self) -> Iterator[str]:
        """Keys of all zones of angles in which any motion ever is."""
        return (key for key in self._by_place.get(SESSION, {}) if "_zone_" in key)


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


@dataclass(frozen=True)
class Measuring:
    """A recovery as it is measured: its layout, and every figure of answer and draws."""

    recovery: Recovery  # What is measured
    motion: Motion  # Its arrays
    layout: Layout  # What is measured when
    answer: dict[Place, Figures]  # The figures of the answer
    drawn: DrawnFigures  # Those of the drawn motions
    # The answer's figures with the share that comes from samples not to be trusted; empty where all are
    untrusted: dict[Place, Figures]

    @classmethod
    def of(
        cls,
        recovery: Recovery,
        settings: MeasureSettings,
        processes: int = 1,
        progress: Progress | None = None,
    ) -> Measuring:
        """Measure a recovery and its draws, these on this many worker processes (0 = one per core)."""
        grid = grid_of(recovery, settings.smoothing)
        motion = motion_of(recovery, grid, settings.smoothing.cutoff_hz)
        layout = Layout.of(motion, settings)
        drawn = DrawnFigures(recovery, layout, motion, processes, progress)
        untrusted = {}
        if len(grid.t_s) and not recovery.trusted.all():
            # a figure's share is of the samples that the motion has as occluded
            wrong = np.asarray(~recovery.trusted[nearest(recovery.t_s, grid.t_s)])
            untrusted = layout.figures(replace(drawn.answer, occluded=wrong))
        return cls(recovery, motion, layout, layout.figures(drawn.answer), drawn, untrusted)

    def rows(self, place: Place) -> list[Measure]:
        """The measures of the session, a movement or a repetition."""
        figures = dict(self.answer[place])
        if place == SESSION:
            figures |= {key: Figure(0.0, 0.0) for key in self.drawn.zones() if key not in figures}
            figures = dict(sorted(figures.items(), key=lambda item: "_zone_" in item[0]))  # zones last
            for angle in self.motion.missing:
                figures |= dict.fromkeys(_keys_of(angle), UNKNOWN)
        return [self._row(place, key, figure) for key, figure in figures.items()]

    def _row(self, place: Place, key: str, figure: Figure) -> Measure:
        scope, number = place
        definition = definition_of(key)
        low, high, sigma = self.interval(place, key, figure.value)
        start_s, end_s = self.times(place)
        untrusted = float(np.nan_to_num(self.untrusted.get(place, {}).get(key, UNKNOWN).share))
        words = "" if np.isfinite(figure.value) else self._why(key)
        # of a recording that is not trusted at all, the verdict says so
        if not words and untrusted > 0.0 and self.recovery.estimates.trusted is not False:
            words = f"Rests to {max(100.0 * untrusted, 1.0):.0f} % on gaps that are not trusted."
        count = self.drawn.count if np.isfinite(low) else 0
        what = (key, definition.name, definition.unit, figure.value, low, high, sigma, figure.share)
        return Measure(*what, scope, number, start_s, end_s, count, words, untrusted)

    def interval(self, place: Place, key: str, value: float) -> tuple[float, float, float]:
        """The 95 % interval about a measure's value, and its standard deviation; nan without draws."""
        is_found = place[0] != "movement" and key in FOUND
        low, high, sigma = interval(value, self.drawn.values(place, key), definition_of(key), is_found)
        if self.drawn.bend is not None and key in ELBOW_ANGLES and np.isfinite(low):
            low = self.drawn.bend.lower(low)
        return low, high, sigma

    def times(self, place: Place) -> tuple[float, float]:
        """From when to when, s; nan where there is no answer."""
        scope, number = place
        if number is not None:
            kind = self.layout.movements if scope == "movement" else self.layout.repetitions
            return kind[number].start_s, kind[number].end_s
        t = self.motion.grid.t_s
        return (float(t[0]), float(t[-1])) if len(t) else (float("nan"), float("nan"))

    def _why(self, key: str) -> str:
        """Why a measure has no value, in a sentence."""
        for angle, reason in self.motion.missing.items():
            if key in _keys_of(angle):
                return reason
        known = [name for name in self.layout.centres_deg if key in _keys_of(name)]
        if known and not np.isfinite(self.layout.centres_deg[known[0]]):
            return "The angle made a full turn: it has no smallest and largest value."
        if known:
            return "The angle is known for less than 0.3 s here."
        return next(words for prefixes, words in _REASONS if key.startswith(prefixes))


#: Why a measure has no value, by how its key begins.
_REASONS = (
    (
        ("hand_to_", "hand_behind", "elbow_trunk"),
        "Needs shoulder, elbow and wrist, and the direction of gravity.",
    ),
    (("hand_reach_sphere",), "Needs the arm's length: shoulder, elbow and wrist."),
    (("hand_reach",), "The hand's positions have no volume."),
    (("hand_path_ratio",), "No movement ends more than 5 cm from where it began."),
    (("repetition",), "Too few repetitions."),
    (("",), "There is no movement of the hand to measure."),
)
#: Measures that are a flexion of the elbow, not a difference or a part of the time.
ELBOW_ANGLES = frozenset(
    f"elbow_flexion_{what}_deg" for what in ("min", "max", *(f"p{percentile}" for percentile in PERCENTILES))
)


def _keys_of(angle: str) -> list[str]:
    """Keys of an angle's measures, but for its zones."""
    whats = ("range", "min", "max", *(f"p{percentile}" for percentile in PERCENTILES))
    return [*(f"{angle}_{what}_deg" for what in whats), f"{angle}_peak_speed_deg_s"]


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
    return measures_of(Measuring.of(recovery, settings or MeasureSettings(), processes, progress))


def measures_of(measuring: Measuring) -> Measures:
    """What was measured, as a table of measures."""
    recovery, layout = measuring.recovery, measuring.layout
    rows = [row for place in measuring.answer for row in measuring.rows(place)]
    start_s, end_s = measuring.times(SESSION)
    return Measures(
        *(recovery.side, recovery.body, recovery.name, start_s, end_s, tuple(rows)),
        movements=layout.movements,
        repetitions=layout.repetitions,
        trusted=recovery.estimates.trusted,
        verdict=recovery.estimates.verdict,
        n_draws=measuring.drawn.count,
        notes=tuple(_notes(measuring)),
    )


def _notes(measuring: Measuring) -> list[str]:
    """Notes on all measures of an arm."""
    recovery, motion, notes = measuring.recovery, measuring.motion, []
    if not len(motion.grid.t_s):
        notes.append("There is no answer to measure.")
    if measuring.drawn.count == 0:
        notes.append("There are no intervals: smooth the recording with --draws 64 to have them.")
    elif measuring.drawn.count < FEWEST_DRAWS:
        notes.append(
            f"There are no intervals: {measuring.drawn.count} drawn motions are too few; smooth the recording"
            " with --draws 64."
        )
    if motion.hand_joint != "hand":
        instead = "the IMU" if motion.hand_joint == "imu" else f"the {motion.hand_joint}"
        notes.append(f"The recording has no hand; {instead} is used instead.")
    figures = measuring.answer.get(SESSION, {})
    low, high, _ = measuring.interval(SESSION, "movement_count", figures["movement_count"].value)
    if low < high:
        notes.append(
            f"The drawn motions have {low:.0f} to {high:.0f} movements. Those listed are the result's; their"
            " intervals are over their samples and do not include whether another motion has them."
        )
    figure = figures.get("shoulder_rotation_range_deg")
    turned = float("nan") if figure is None else figure.value
    if turned > WIDE_ROTATION_DEG:
        notes.append(
            f"Shoulder rotation spans {turned:.0f} degrees, more than a shoulder turns: near a hanging or a"
            " raised arm plane and rotation turn about nearly the same axis, and only their sum is defined"
            " (ISB); compare their range over movements at the side or in front."
        )
    if (recovery.trunk is None or not recovery.trunk.by_imu) and motion.R_K_T is not None:
        notes.append(
            "There is no IMU on the trunk: it is assumed upright and facing the camera, for the shoulder's"
            " angles and for where mouth, head and back are."
        )
    return notes
