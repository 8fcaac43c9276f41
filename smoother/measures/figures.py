"""Figures of one stretch of a motion: angles, and the hand's path, smoothness, reach and zones.

A function gives the figures that it can; what it leaves out is not known.
"""

from __future__ import annotations

import numpy as np

from ..angles.definitions import wrapped_deg
from ..array_types import BoolArray, FloatArray, IntArray
from ..linalg import runs
from .definitions import PERCENTILES, zone_key
from .measure import Figure, Reach, share_of
from .motion import Motion

Figures = dict[str, Figure]
#: Width of a zone, degrees (Kee and Karwowski's and RULA's tables are coarser; studies differ).
ZONE_DEG = 10
#: An extreme rests on the samples this near to it, degrees; a peak speed on those this near to it, as a part.
NEAR_DEG, NEAR_SHARE = 2.0, 0.05
#: Fewer known samples than this do not determine an angle, s.
SHORTEST_S = 0.3
#: Ends nearer than this make no straight line to compare a path with, m.
NEAREST_ENDS_M = 0.05


def centred(angle: FloatArray, centre_deg: float) -> FloatArray:
    """Angles (n,) brought to within half a turn of their centre, so that a range does not jump at 180."""
    return np.asarray(centre_deg + wrapped_deg(angle - centre_deg))


def centre_of(angle: FloatArray) -> float:
    """What angles (n,) are counted from: half a turn from the middle of the widest empty arc, degrees."""
    known = np.sort(wrapped_deg(angle[np.isfinite(angle)]))
    if not len(known):
        return float("nan")
    arcs = np.diff(known, append=known[0] + 360.0)
    widest = int(np.argmax(arcs))
    if arcs[widest] < ZONE_DEG:
        return float("nan")
    return float(wrapped_deg(np.asarray(known[widest] + 0.5 * arcs[widest] + 180.0)))


def angle_figures(
    name: str,
    angle: FloatArray,  # (n,) deg
    occluded: BoolArray,  # bool (n,)
    rate_hz: float,
) -> Figures:
    """Range, extremes, percentiles and peak speed of an angle over some time."""
    known = np.isfinite(angle)
    if known.sum() < SHORTEST_S * rate_hz:
        return {}
    values, hidden = angle[known], occluded[known]
    low, high = float(values.min()), float(values.max())
    share_low = share_of(hidden, values <= low + NEAR_DEG)
    share_high = share_of(hidden, values >= high - NEAR_DEG)
    figures = {
        f"{name}_range_deg": Figure(high - low, 0.5 * (share_low + share_high)),
        f"{name}_min_deg": Figure(low, share_low),
        f"{name}_max_deg": Figure(high, share_high),
    }
    for percent, value in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True):
        away = np.abs(values - value)
        near = away <= max(NEAR_DEG, float(away.min()))
        figures[f"{name}_p{percent}_deg"] = Figure(float(value), share_of(hidden, near))
    speed = np.full(len(angle), np.nan)  # within runs that are known; the angle may turn over in them
    for run in runs(known):
        if run.stop - run.start >= 3:
            speed[run] = np.abs(np.gradient(np.unwrap(angle[run], period=360.0), 1.0 / rate_hz))
    peak = float(np.nanmax(speed)) if np.isfinite(speed).any() else 0.0
    near = np.nan_to_num(speed) >= (1.0 - NEAR_SHARE) * peak
    return figures | {f"{name}_peak_speed_deg_s": Figure(peak, share_of(occluded, near))}


def zone_figures(
    name: str,
    angle: FloatArray,  # (n,) deg
    occluded: BoolArray,  # bool (n,)
) -> Figures:
    """Percent of the time that an angle is known in which it is in each zone of 10 degrees."""
    known = np.isfinite(angle)
    lower = (np.floor(wrapped_deg(angle[known]) / ZONE_DEG) * ZONE_DEG).astype(int)
    hidden = occluded[known]
    return {
        zone_key(name, int(zone), ZONE_DEG): Figure(
            100.0 * float((lower == zone).mean()), share_of(hidden, lower == zone)
        )
        for zone in np.unique(lower)
    }


def way_figures(
    hand: FloatArray, speed: FloatArray, occluded: BoolArray, rate_hz: float, runs: tuple[slice, ...]
) -> Figures:
    """Path length, peak and mean speed of the hand over some time."""
    if not np.isfinite(speed).any():
        return {}
    steps = np.zeros(len(hand))
    for run in runs:
        steps[run][1:] = np.nan_to_num(np.linalg.norm(np.diff(hand[run], axis=0), axis=1))
    share = share_of(occluded, steps)
    length, peak = float(steps.sum()), float(np.nanmax(speed))
    near = np.nan_to_num(speed) >= (1.0 - NEAR_SHARE) * peak
    seconds = max(sum(run.stop - run.start - 1 for run in runs), 1) / rate_hz
    return {
        "hand_path_length_m": Figure(length, share),
        "hand_peak_speed_m_s": Figure(peak, share_of(occluded, near)),
        "hand_mean_speed_m_s": Figure(length / seconds, share),
    }


def straightness_figures(hand: FloatArray, speed: FloatArray, occluded: BoolArray, rate_hz: float) -> Figures:
    """Path ratio (Cirstea and Levin, Brain 123:940-953, 2000) and time to peak (Alt Murphy et al. 2011)."""
    if len(hand) < 3 or not np.isfinite(hand).all():
        return {}
    steps = np.linalg.norm(np.diff(hand, axis=0), axis=1)
    straight = float(np.linalg.norm(hand[-1] - hand[0]))
    ratio = float(steps.sum()) / straight if straight >= NEAREST_ENDS_M else float("nan")
    peak = int(np.argmax(speed))
    share = share_of(occluded[max(peak - 2, 0) : peak + 3])
    return {
        "hand_path_ratio": Figure(ratio, share_of(occluded[1:], steps)),
        "hand_time_to_peak_s": Figure(peak / rate_hz, share),
        "hand_time_to_peak_percent": Figure(100.0 * peak / (len(hand) - 1), share),
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


def reach_figures(
    place: FloatArray, occluded: BoolArray, arm_m: float, voxel_m: float, alpha_m: float
) -> Figures:
    """Volume of the hand's places: convex hull, alpha shape, and the hull over a ball of the arm's length.

    Edelsbrunner and Muecke, ACM Trans Graph 13:43-72 (1994); Kurillo et al., Hum Mov Sci 32:1191-1200 (2013).
    """
    from scipy.spatial import ConvexHull, QhullError

    known = np.isfinite(place).all(axis=1)
    points, hidden = place[known], occluded[known]
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # fewer than four places, or all in a plane
        return {}
    share = share_of(hidden[hull.vertices])
    sphere = 4.0 / 3.0 * np.pi * arm_m**3
    places = voxel_means(points, voxel_m)
    return {
        "hand_reach_hull_l": Figure(LITRES * float(hull.volume), share),
        "hand_reach_alpha_l": Figure(LITRES * alpha_volume(places, alpha_m), share),
        "hand_reach_sphere_percent": Figure(100.0 * float(hull.volume) / sphere, share),
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


def zone_figures_of(motion: Motion, rows: slice, settings: Reach) -> Figures:
    """Whether the hand reached mouth, head and back, and how near it came; the elbow's distance."""
    lengths = bone_lengths(motion)
    if not {"upper_arm", "forearm"} <= lengths.keys() or motion.R_K_T is None:
        return {}
    stature = (lengths["upper_arm"] + lengths["forearm"]) / (UPPER_ARM + FOREARM)
    if not np.isfinite(stature):
        return {}
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
    figures = {}
    for key, distance in distances.items():
        if np.isfinite(distance).any():
            least = float(np.nanmin(distance))
            share = share_of(occluded, np.nan_to_num(distance, nan=np.inf) <= max(least, 0.0) + 0.01)
            figures[f"{key}_reached"] = Figure(float(least <= 0.0), share)
            figures[f"{key}_distance_m"] = Figure(max(least, 0.0), share)
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
