"""What is measured of the hand: its path, its smoothness, its reach, and zones about the trunk."""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from .measure import UNKNOWN, Figure, Reach, share_of
from .motion import Motion

#: Ends nearer than this make no straight line to compare a path with, m.
NEAREST_ENDS_M = 0.05
#: A peak rests on the samples this near to it, as a part of it.
NEAR_SHARE = 0.05


def way_figures(
    hand: FloatArray, speed: FloatArray, occluded: BoolArray, rate_hz: float, runs: tuple[slice, ...]
) -> dict[str, Figure]:
    """Path length, peak and mean speed of the hand over some time."""
    keys = ("hand_path_length_m", "hand_peak_speed_m_s", "hand_mean_speed_m_s")
    if not np.isfinite(speed).any():
        return dict.fromkeys(keys, UNKNOWN)
    steps = np.zeros(len(hand))
    for run in runs:
        steps[run][1:] = np.nan_to_num(np.linalg.norm(np.diff(hand[run], axis=0), axis=1))
    share = share_of(occluded, steps)
    length, peak = float(steps.sum()), float(np.nanmax(speed))
    with np.errstate(invalid="ignore"):
        near = speed >= (1.0 - NEAR_SHARE) * peak
    seconds = max(sum(run.stop - run.start - 1 for run in runs), 1) / rate_hz
    return {
        keys[0]: Figure(length, share),
        keys[1]: Figure(peak, share_of(occluded, near)),
        keys[2]: Figure(length / seconds, share),
    }


def straightness_figures(
    hand: FloatArray, speed: FloatArray, occluded: BoolArray, rate_hz: float
) -> dict[str, Figure]:
    """Path ratio (Cirstea and Levin, Brain 123:940-953, 2000) and time to peak (Alt Murphy et al. 2011)."""
    if len(hand) < 3 or not np.isfinite(hand).all():
        return dict.fromkeys(("hand_path_ratio", "hand_time_to_peak_s", "hand_time_to_peak_percent"), UNKNOWN)
    steps = np.linalg.norm(np.diff(hand, axis=0), axis=1)
    straight = float(np.linalg.norm(hand[-1] - hand[0]))
    ratio = float(steps.sum()) / straight if straight >= NEAREST_ENDS_M else float("nan")
    peak = int(np.argmax(speed))
    near = occluded[max(peak - 2, 0) : peak + 3]
    return {
        "hand_path_ratio": Figure(ratio, share_of(occluded[1:], steps)),
        "hand_time_to_peak_s": Figure(peak / rate_hz, share_of(near)),
        "hand_time_to_peak_percent": Figure(100.0 * peak / (len(hand) - 1), share_of(near)),
    }


#: As published (Balasubramanian et al. 2015): zero padding, highest frequency, threshold of the amplitude.
PAD_LEVEL, CUTOFF_HZ, LEAST_AMPLITUDE = 4, 10.0, 0.05
#: A shorter profile has no spectrum to speak of.
FEWEST_SAMPLES = 8


def spectral_arc_length(speed: FloatArray, rate_hz: float) -> float:  # speed (n,) m/s
    """SPARC: minus the length of the speed's normalised amplitude spectrum as a curve; 0 = smoothest.

    Balasubramanian, Melendez-Calderon, Roby-Brami, Burdet, J NeuroEng Rehabil 12:112 (2015), equation 9.
    """
    if len(speed) < FEWEST_SAMPLES or not np.isfinite(speed).all() or not speed.any():
        return float("nan")
    size = int(2 ** (np.ceil(np.log2(len(speed))) + PAD_LEVEL))
    frequency = np.arange(size // 2 + 1) * rate_hz / size
    amplitude = np.abs(np.fft.rfft(speed, size))
    amplitude /= amplitude.max()
    inside = np.flatnonzero((frequency <= CUTOFF_HZ) & (amplitude >= LEAST_AMPLITUDE))
    first, last = inside[0], inside[-1]
    if last == first:
        return float("nan")
    steps = np.diff(frequency[first : last + 1]) / (frequency[last] - frequency[first])
    return float(-np.hypot(steps, np.diff(amplitude[first : last + 1])).sum())


def log_dimensionless_jerk(speed: FloatArray, rate_hz: float) -> float:  # speed (n,) m/s
    """LDLJ-V, -ln(T^3 / v_peak^2 * integral of v''^2): Balasubramanian et al. 2015, equations 4 and 5."""
    if len(speed) < FEWEST_SAMPLES or not np.isfinite(speed).all():
        return float("nan")
    jerk = np.diff(speed, 2) * rate_hz**2
    squared = float((jerk**2).sum()) / rate_hz
    peak = float(np.abs(speed).max())
    if squared <= 0.0 or peak <= 0.0:
        return float("nan")
    return float(-np.log((len(speed) / rate_hz) ** 3 / peak**2 * squared))


def velocity_peaks(
    speed: FloatArray,  # (n,) m/s
    rate_hz: float,
    rise_m_s: float,
    apart_s: float,
) -> IntArray:  # int (k,)
    """Rows of the maxima of a speed that stand out (Alt Murphy et al., Neurorehabil 25:71-80, 2011)."""
    from scipy.signal import find_peaks

    apart = max(round(apart_s * rate_hz), 1)
    edged = np.concatenate([[0.0], np.nan_to_num(speed), [0.0]])  # a maximum at an end is one, too
    peaks, _ = find_peaks(edged, prominence=rise_m_s, distance=apart)
    return np.asarray(peaks - 1, dtype=np.int64)


LITRES = 1000.0
REACH_KEYS = ("hand_reach_hull_l", "hand_reach_alpha_l", "hand_reach_sphere_percent")


def reach_figures(
    place: FloatArray, occluded: BoolArray, arm_m: float, voxel_m: float, alpha_m: float
) -> dict[str, Figure]:
    """Volume of the hand's places: convex hull, alpha shape, and the hull over a ball of the arm's length.

    Edelsbrunner and Muecke, ACM Trans Graph 13:43-72 (1994); Kurillo et al., Hum Mov Sci 32:1191-1200 (2013).
    """
    from scipy.spatial import ConvexHull, QhullError

    known = np.isfinite(place).all(axis=1)
    points, hidden = place[known], occluded[known]
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # fewer than four places, or all in a plane
        return dict.fromkeys(REACH_KEYS, UNKNOWN)
    share = share_of(hidden[hull.vertices])
    sphere = 4.0 / 3.0 * np.pi * arm_m**3
    places = voxel_means(points, voxel_m)
    return {
        REACH_KEYS[0]: Figure(LITRES * float(hull.volume), share),
        REACH_KEYS[1]: Figure(LITRES * alpha_volume(places, alpha_m), share),
        REACH_KEYS[2]: Figure(100.0 * float(hull.volume) / sphere, share),
    }


def alpha_volume(points: FloatArray, alpha_m: float) -> float:  # points (n, 3) m
    """Volume of the alpha shape: the Delaunay tetrahedra that a ball of that radius holds."""
    from scipy.spatial import Delaunay, QhullError

    try:
        corners = points[Delaunay(points).simplices]
    except (QhullError, ValueError):
        return float("nan")
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    six_volumes = np.abs(np.einsum("ni,ni->n", a, bc))
    solid = six_volumes > 1e-15
    # the centre of the ball through all corners is (|a|^2 b x c + |b|^2 c x a + |c|^2 a x b) / (2 a . b x c)
    squares = ((edge**2).sum(axis=1)[:, None] for edge in (a, b, c))
    centre = sum(square * normal for square, normal in zip(squares, (bc, ca, ab), strict=True))[solid]
    inside = np.linalg.norm(centre, axis=1) <= 2.0 * alpha_m * six_volumes[solid]
    return float(six_volumes[solid][inside].sum() / 6.0)


def voxel_means(points: FloatArray, voxel_m: float) -> FloatArray:
    """The mean of the points (n, 3) in each cube of that size, (k, 3)."""
    cubes = np.floor(points / voxel_m).astype(np.int64)
    order = np.lexsort(cubes.T[::-1])  # np.unique of rows takes ten times as long
    cube = np.empty(len(points), np.int64)
    cube[order] = np.cumsum((np.diff(cubes[order], axis=0, prepend=cubes[order[:1]]) != 0).any(axis=1))
    count = np.bincount(cube)
    return np.stack([np.bincount(cube, points[:, axis]) / count for axis in range(3)], axis=1)


# A skeleton of one arm has neither head nor the other shoulder. They are placed from the shoulder by the
# proportions of the body (Drillis and Contini 1966, as in Winter, Biomechanics and Motor Control of Human
# Movement, 2009, figure 4.1), the stature by the lengths of upper arm and forearm (0.186 and 0.146 of it).
# Lengths as parts of the stature, in the thorax's axes (x forward, y up, z to the right arm's side):
UPPER_ARM, FOREARM = 0.186, 0.146
#: From the shoulder to the midline, and its height below the mouth (between chin 0.870 and eye 0.936 less
#: the acromion's 0.818) and below the head's middle (half way from chin to crown).
HALF_BREADTH, MOUTH_UP, HEAD_UP = 0.129, 0.075, 0.117
#: The mouth before the shoulders; the head's half axes (forward, up, sideways).
MOUTH_AHEAD = 0.06
HEAD_AXES = (0.055, 0.065, 0.044)
#: Behind the back counts from the shoulder down, and this far beyond the midline's other side at most.
ZONE_KEYS = ("hand_to_mouth", "hand_to_head", "hand_behind_back")


def zone_figures_of(motion: Motion, rows: slice, settings: Reach) -> dict[str, Figure]:
    """Whether the hand reached mouth, head and back, and how near it came; the elbow's distance."""
    figures = {f"{key}_{what}": UNKNOWN for key in ZONE_KEYS for what in ("reached", "distance_m")}
    figures |= {f"elbow_trunk_distance_{what}_m": UNKNOWN for what in ("max", "mean")}
    lengths = bone_lengths(motion)
    if not {"upper_arm", "forearm"} <= lengths.keys() or motion.R_K_T is None:
        return figures
    stature = (lengths["upper_arm"] + lengths["forearm"]) / (UPPER_ARM + FOREARM)
    if not np.isfinite(stature):
        return figures
    shoulder, elbow = motion.joints["shoulder"], motion.joints["elbow"]
    hand_T, elbow_T = motion.in_trunk(motion.hand - shoulder), motion.in_trunk(elbow - shoulder)
    assert hand_T is not None and elbow_T is not None
    hand_T, elbow_T, occluded = hand_T[rows], elbow_T[rows], motion.occluded[rows]
    mouth = stature * np.array([MOUTH_AHEAD, MOUTH_UP, -HALF_BREADTH])
    distances = {
        "hand_to_mouth": np.linalg.norm(hand_T - mouth, axis=1) - settings.mouth_m,
        "hand_to_head": head_distance(hand_T, stature) - settings.head_m,
        "hand_behind_back": back_distance(hand_T, stature, settings.behind_m),
    }
    for key, distance in distances.items():
        figures |= _reached(key, distance, occluded)
    middle = np.array([0.0, -HALF_BREADTH * stature])
    away = np.linalg.norm(elbow_T[:, [0, 2]] - middle, axis=1)
    known = np.isfinite(away)
    if known.any():
        far = known & (np.nan_to_num(away) >= 0.98 * np.nanmax(away))
        figures["elbow_trunk_distance_max_m"] = Figure(float(np.nanmax(away)), share_of(occluded, far))
        figures["elbow_trunk_distance_mean_m"] = Figure(float(np.nanmean(away)), share_of(occluded[known]))
    return figures


def bone_lengths(motion: Motion) -> dict[str, float]:
    """Median lengths of upper arm, forearm and from wrist to hand, m; what is not known is left out."""
    ends = {"upper_arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"), "hand": ("wrist", "hand")}
    return {
        bone: float(np.nanmedian(np.linalg.norm(motion.joints[a] - motion.joints[b], axis=1)))
        for bone, (a, b) in ends.items()
        if a in motion.joints and b in motion.joints
    }


def head_distance(hand_T: FloatArray, stature: float) -> FloatArray:
    """From the hand (n, 3) to the head's surface, an ellipsoid, m; along the line to its middle."""
    middle = stature * np.array([0.0, HEAD_UP, -HALF_BREADTH])
    away = hand_T - middle
    scaled = np.linalg.norm(away / (stature * np.array(HEAD_AXES)), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(away, axis=1) * np.maximum(1.0 - 1.0 / scaled, 0.0))


def back_distance(hand_T: FloatArray, stature: float, behind_m: float) -> FloatArray:
    """How far the hand (n, 3) is from the room behind the back, m; 0 or less inside."""
    breadth = HALF_BREADTH * stature
    outside = np.stack(
        [
            hand_T[:, 0] + behind_m,
            hand_T[:, 1],
            np.abs(hand_T[:, 2] + breadth) - breadth,
        ],
        axis=1,
    )
    apart = np.linalg.norm(np.maximum(outside, 0.0), axis=1)
    return np.asarray(np.where(apart > 0.0, apart, outside.max(axis=1)))


def _reached(key: str, distance: FloatArray, occluded: BoolArray) -> dict[str, Figure]:
    """Whether a distance (n,) gets to zero, and the least of it."""
    if not np.isfinite(distance).any():
        return {}
    least = float(np.nanmin(distance))
    share = share_of(occluded, np.nan_to_num(distance, nan=np.inf) <= max(least, 0.0) + 0.01)
    reached = Figure(float(least <= 0.0), share)
    return {f"{key}_reached": reached, f"{key}_distance_m": Figure(max(least, 0.0), share)}
