"""How the IMU sits on the forearm, in closed form from visible motion: the self-calibration's start.

1. Clock offset and forearm direction: for each offset and each direction f on a grid the best rotation
   between the inertial frame and the camera is Wahba's problem, whose loss needs only the tensor
   sum d_K (x) R_E_A; the smallest loss wins. No rest pose and no start value is needed.
2. Lever arms: a joint's camera acceleration minus the IMU's is linear in its lever arm.

A calibration that was given is compared with the closed form without it (`contradictions`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..calibration import ArmCalibration, LeverArm
from ..linalg import around, largest_trace, parabola_vertex, sphere
from ..measurements.alignment import Alignment, acceleration_pairs, align, direction_pairs, pairs
from ..measurements.clock import OFFSET_SIGMA_S
from ..measurements.outliers import reject_by_camera
from ..measurements.segment import Segment, Timeline
from ..recording import FOREARM_JOINTS, JOINTS, Recording
from .excerpts import choose_excerpts, informative_excerpts

#: Clock offsets tried first, s.
OFFSETS_S = np.arange(-0.30, 0.301, 0.02)
#: Frames used for the direction, Hz.
DIRECTION_RATE_HZ = 10.0
#: Heading of the inertial filter is taken as constant over this time, s.
CHUNK_S = 30.0
#: A forearm direction of the camera, rad; frames are correlated, so it is taken large.
DIRECTION_SIGMA_RAD = 0.15
HINT_SIGMA_RAD = np.radians(10.0)
#: A direction whose log-likelihood is less than this below the best one's may be the true one.
NEARLY_AS_LIKELY = 5.0
#: The IMU sits near the wrist: where the wrist's lever arm is expected, as a part of the forearm.
WRIST_PART = 0.2
LEVER_SIGMA_M = 0.06
#: What the closed form is good to, m: prior of the graph that refines it.
CLOSED_FORM_SIGMA_M = 0.04


@dataclass(frozen=True)
class Mounting:
    """Closed-form answer: clock offset of each recording (s), and lever arms for the graph to refine."""

    offset_s: FloatArray
    calibration: ArmCalibration
    direction_spread_rad: float = float("nan")


def find_mounting(
    segments: list[Segment], known: ArmCalibration, offset_sigma_s: float = OFFSET_SIGMA_S
) -> Mounting:
    """Offset, forearm direction and lever arms from the pieces of one or several recordings."""
    count = max(segment.recording for segment in segments) + 1
    along = known.forearm_direction
    both = [_both(segment) for segment in segments]
    offset_s, spread = np.zeros(count), float("nan")
    if any(rows.sum() >= 10 for rows in both):
        offset_s, found, spread = _direction_and_offset(segments, both, count, along, offset_sigma_s)
        along = found if along is None else along
    if along is None and "strap" not in _seen(segments):
        return Mounting(offset_s, _point_levers(segments, known), spread)
    levers = dict(known.lever_arms)
    missing = [
        joint for joint in _seen(segments) if joint not in levers and joint not in ("strap", "shoulder")
    ]
    if missing:
        levers |= _levers(segments, offset_s, along, known, missing)
    return Mounting(offset_s, ArmCalibration(known.side, levers, known.upper_arm, known.R_F_A), spread)


def _seen(segments: list[Segment]) -> list[str]:
    return [
        joint
        for joint in FOREARM_JOINTS
        if sum(segment.with_depth[:, JOINTS.index(joint)].sum() for segment in segments) >= 8
    ]


def _both(segment: Segment) -> BoolArray:
    """Frames of the part looked at in which elbow and wrist are accepted, thinned out."""
    elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
    inside = (segment.frame_t_camera >= segment.start_s) & (segment.frame_t_camera <= segment.end_s)
    apart = (segment.position[:, elbow] != segment.position[:, wrist]).any(axis=1)
    rows = inside & apart & segment.with_depth[:, elbow] & segment.with_depth[:, wrist]
    cell = np.floor(segment.frame_t_camera * DIRECTION_RATE_HZ).astype(int)
    first = np.concatenate(([True], np.diff(cell) > 0))
    return rows & first if len(rows) > 200 else rows


def _direction_and_offset(
    segments: list[Segment],
    both: list[BoolArray],
    count: int,
    known: FloatArray | None,
    offset_sigma_s: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Grid over offsets and directions, refined twice; also how far off those nearly as likely are, rad."""
    directions = sphere(400) if known is None else known[None]
    offsets, choice = OFFSETS_S, np.zeros(count)
    spread = float("nan")
    for step in range(3):
        loss = np.zeros((count, len(offsets), len(directions)))
        for segment, rows in zip(segments, both, strict=True):
            if rows.sum() >= 5:
                tried = choice[segment.recording] + offsets
                loss[segment.recording] += _losses(segment, rows, tried, directions)
        loss += 0.5 * ((offsets + choice[:, None]) / offset_sigma_s)[:, :, None] ** 2
        at = loss.min(axis=1).sum(axis=0)  # each recording has its own offset
        k = int(np.argmin(at))
        best = directions[k]
        if step == 0:
            likely = directions[at < at[k] + NEARLY_AS_LIKELY]
            spread = float(np.arccos(np.clip(likely @ best, -1.0, 1.0)).max())
        choice = choice + [parabola_vertex(offsets, own[:, k]) for own in loss]
        if known is None:
            directions = around(best, (0.25, 0.06, 0.0)[step] * np.linspace(-1.0, 1.0, 9 if step < 2 else 1))
        offsets = np.linspace(-0.03, 0.03, 7)
    return choice, best, spread


def _losses(segment: Segment, rows: BoolArray, offsets: FloatArray, directions: FloatArray) -> FloatArray:
    """Wahba's loss (offsets, directions), in units of the direction's variance."""
    elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
    along = segment.position[rows, wrist] - segment.position[rows, elbow]
    along /= np.linalg.norm(along, axis=1)[:, None]
    t = segment.frame_t_camera[rows]
    chunk = ((t - t[0]) / CHUNK_S).astype(int)
    loss = np.zeros((len(offsets), len(directions)))
    hint = np.outer(segment.down, [0.0, 0.0, -1.0]) * (DIRECTION_SIGMA_RAD / HINT_SIGMA_RAD) ** 2
    R_E_A = segment.attitude.at((offsets[:, None] + t).ravel()).as_matrix().reshape(len(offsets), -1, 9)
    for part in np.unique(chunk):
        member = chunk == part
        # by offset (camera axis, earth axis, sensor axis), then by direction of the sensor
        tensor = (along[member].T @ R_E_A[:, member]).reshape(len(offsets), 3, 3, 3)
        profile = np.moveaxis(tensor @ directions.T, -1, 1) + hint
        loss += member.sum() - largest_trace(profile)
    return loss / DIRECTION_SIGMA_RAD**2


def _levers(
    segments: list[Segment],
    offset_s: FloatArray,
    along: FloatArray | None,
    known: ArmCalibration,
    missing: list[str],
) -> dict[str, LeverArm]:
    """Lever arms of the missing joints: differences between joints directly, the rest from accelerations."""
    reference = next(
        (joint for joint in ("strap", *known.lever_arms) if joint in _seen(segments)),
        "wrist" if "wrist" in missing else missing[0],
    )
    frames = [_aligned(segment, float(offset_s[segment.recording]), along) for segment in segments]
    difference = {joint: _difference(segments, frames, joint, reference) for joint in missing}
    if reference == "strap" or reference in known.lever_arms:
        base = known.lever_arms[reference].position_m if reference in known.lever_arms else np.zeros(3)
        sigma = np.full(3, CLOSED_FORM_SIGMA_M)
    else:
        forearm = np.linalg.norm(difference.get("elbow", np.array([0.25, 0.0, 0.0])))
        expected = np.zeros(3) if along is None else WRIST_PART * forearm * along
        base, sigma = _by_acceleration(segments, frames, offset_s, reference, expected)
        sigma = np.hypot(sigma, CLOSED_FORM_SIGMA_M)
    return {joint: LeverArm(base + difference[joint], sigma) for joint in missing}


def _aligned(segment: Segment, offset_s: float, along: FloatArray | None) -> Alignment:
    """The inertial frame in the camera's, from the forearm's direction (or the strap's acceleration)."""
    frame_t = segment.frame_t_camera + offset_s
    pairs = []
    elbow, wrist, strap = (JOINTS.index(joint) for joint in ("elbow", "wrist", "strap"))
    both = segment.with_depth[:, elbow] & segment.with_depth[:, wrist]
    if along is not None and both.any():
        position = segment.position[both]
        pairs.append(
            direction_pairs(frame_t[both], position[:, elbow], position[:, wrist], segment.attitude, along)
        )
    if segment.with_depth[:, strap].sum() >= 8:
        rows = segment.with_depth[:, strap]
        pairs.append(
            acceleration_pairs(frame_t[rows], segment.position[rows, strap], segment.attitude, segment.signal)
        )
    return align(pairs, segment.start_s, segment.end_s, segment.down)


def _difference(segments: list[Segment], frames: list[Alignment], joint: str, reference: str) -> FloatArray:
    """Mean of (joint - reference) in {A} over frames in which both are seen, (3,) m."""
    if joint == reference:
        return np.zeros(3)
    rows = []
    a, b = JOINTS.index(joint), JOINTS.index(reference)
    for segment, frame in zip(segments, frames, strict=True):
        both = segment.with_depth[:, a] & segment.with_depth[:, b]
        if both.any():
            t = segment.frame_t_camera[both]
            R_K_A = frame.at(t) * segment.attitude.at(t)
            rows.append(R_K_A.inv().apply(segment.position[both, a] - segment.position[both, b]))
    return np.median(np.vstack(rows), axis=0) if rows else np.zeros(3)


def _by_acceleration(
    segments: list[Segment], frames: list[Alignment], offset_s: FloatArray, joint: str, expected: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A joint's lever arm from R_K_E' a_K - a_E = turn lever, with a weak expectation, and its sigma, m."""
    column = JOINTS.index(joint)
    information = np.eye(3) / LEVER_SIGMA_M**2
    vector = information @ expected
    for segment, frame in zip(segments, frames, strict=True):
        rows = segment.with_depth[:, column]
        if rows.sum() < 8:
            continue
        t = segment.frame_t_camera[rows] + offset_s[segment.recording]
        found = acceleration_pairs(t, segment.position[rows, column], segment.attitude, segment.signal)
        if len(found.t) and found.turn is not None:
            right = frame.at(found.t).inv().apply(found.in_K) - found.in_E
            information += np.einsum("n,nab,nac->bc", found.weight, found.turn, found.turn)
            vector += np.einsum("n,nab,na->b", found.weight, found.turn, right)
    covariance = np.linalg.inv(information)
    return covariance @ vector, np.sqrt(np.diag(covariance))


def _point_levers(segments: list[Segment], known: ArmCalibration) -> ArmCalibration:
    """One joint alone: it starts at the IMU, and the graph finds how far off it is."""
    levers = dict(known.lever_arms)
    for joint in _seen(segments):
        if joint not in levers and joint not in ("strap", "shoulder"):
            levers[joint] = LeverArm(np.zeros(3), np.full(3, LEVER_SIGMA_M))
    return ArmCalibration(known.side, levers, known.upper_arm, known.R_F_A)


#: What fits: simulated arms leave at most 11 degrees and 0.1 of the acceleration, wrong set-ups
#: 17 degrees or 0.7 at least.
DIRECTION_DEG, ACCELERATION_SHARE = 15.0, 0.45


@dataclass(frozen=True)
class ClosedForm:
    """What the closed form leaves over."""

    direction_deg: float  # Median angle of the forearm by the camera to that by the IMU
    acceleration_share: float  # Share of a joint's acceleration (its square) that the IMU does not explain
    down: FloatArray  # (3,): direction of gravity in {K}; nan where it is open
    calibration: ArmCalibration  # Lever arms

    @property
    def fits(self) -> bool:
        """Directions and accelerations are those of one motion; never where one of them is open."""
        return self.direction_deg < DIRECTION_DEG and self.acceleration_share < ACCELERATION_SHARE

    @property
    def misfit(self) -> float:
        """One number to compare set-ups by; infinite where there is nothing to compare."""
        parts = self.direction_deg / DIRECTION_DEG, self.acceleration_share / ACCELERATION_SHARE
        misfit = float(np.hypot(*parts))
        return misfit if np.isfinite(misfit) else np.inf

    def down_deg(self, down: FloatArray) -> float:
        """Angle of gravity to where a frame has down, degrees; nan where it is open."""
        cosine = float(self.down @ down / np.linalg.norm(down))
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def closed_form(recording: Recording, given: ArmCalibration | None = None) -> ClosedForm | None:
    """The closed form on a recording's excerpts."""
    excerpts = [
        replace(reject_by_camera(excerpt), down=np.zeros(3))
        for excerpt in informative_excerpts(recording, Timeline.of(recording))
    ]
    if not any(excerpt.accepted.any() for excerpt in excerpts):
        return None
    mounting = find_mounting(excerpts, given or ArmCalibration(side=recording.side))
    angles, unexplained, whole = [np.zeros(0)], 0.0, 0.0
    down = np.zeros(3)
    for excerpt in excerpts:
        frame_t = excerpt.frame_t_camera + mounting.offset_s[0]
        vectors = pairs(excerpt, frame_t, excerpt.accepted, mounting.calibration)
        if not sum(len(each.t) for each in vectors):
            continue
        alignment = align(vectors, excerpt.start_s, excerpt.end_s, np.zeros(3))
        middle = alignment.at(np.array([0.5 * (excerpt.start_s + excerpt.end_s)]))
        down += middle.apply([0.0, 0.0, -1.0])[0]
        for each in vectors:
            residual = each.in_K - alignment.at(each.t).apply(each.in_E)
            if each.turn is None:
                angles.append(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(residual, axis=1), 0.0, 1.0)))
            else:
                unexplained += float(each.weight @ (residual**2).sum(axis=1))
                whole += float(each.weight @ (each.in_K**2).sum(axis=1))
    angle = np.concatenate(angles)
    length = float(np.linalg.norm(down))
    return ClosedForm(
        float(np.degrees(np.median(angle))) if len(angle) else float("nan"),
        unexplained / whole if whole > 0.0 else float("nan"),
        down / length if length > 0.0 else np.full(3, np.nan),
        mounting.calibration,
    )


#: The closed form's direction of the forearm counts where no direction farther off is nearly as likely, rad.
SURE_RAD = np.radians(30.0)
#: Directions that differ by more than this besides what the closed form leaves open contradict, degrees: with
#: the calibration of the recording's own mounting simulated arms stay below 4.
OTHERWISE_DEG = 18.0
#: Lengths between joints that differ by more than this, and by three sigmas, contradict, m: cameras place
#: both ends some centimetres off.
LENGTH_M = 0.08
#: Fewer frames do not determine a length.
FEWEST_FRAMES = 30


def contradictions(segments: Sequence[Segment], given: ArmCalibration) -> Iterator[str]:
    """What of a given calibration this recording contradicts, a sentence each."""
    excerpts, levers = choose_excerpts(list(segments)), given.lever_arms
    if (along := given.forearm_direction) is not None:
        own = find_mounting(excerpts, ArmCalibration(given.side))
        found = own.calibration.forearm_direction
        if found is not None and own.direction_spread_rad < SURE_RAD:
            angle_deg = float(np.degrees(np.arccos(np.clip(found @ along, -1.0, 1.0))))
            if angle_deg > OTHERWISE_DEG + np.degrees(own.direction_spread_rad):
                yield (
                    "the calibration does not fit this recording: the IMU sits"
                    f" {angle_deg:.0f} degrees off the calibration's mounting on the forearm"
                )
    lengths: list[tuple[str, str, str, float, float]] = []
    if given.upper_arm is not None:
        lengths.append(("upper arm", "shoulder", "elbow", given.upper_arm.value_m, given.upper_arm.sigma_m))
    if {"elbow", "wrist"} <= set(levers):
        elbow, wrist = levers["elbow"], levers["wrist"]
        length_m = float(np.linalg.norm(wrist.position_m - elbow.position_m))
        sigma_m = float(np.hypot(elbow.sigma_m, wrist.sigma_m).max())
        lengths.append(("forearm", "elbow", "wrist", length_m, sigma_m))
    for what, first, second, length_m, sigma_m in lengths:
        parts = [each.distances(first, second, each.with_depth) for each in excerpts]
        seen_m = np.concatenate([np.zeros(0), *parts])
        middle_m = float(np.median(seen_m)) if len(seen_m) >= FEWEST_FRAMES else length_m
        if abs(length_m - middle_m) > max(LENGTH_M, 3.0 * sigma_m):
            yield (
                f"the calibration does not fit this recording: its {what} is {100 * length_m:.0f} cm long,"
                f" and the camera sees {100 * middle_m:.0f} cm"
            )
