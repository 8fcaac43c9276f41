"""Which bright spot, and which mocap marker, is which marker of the panel: by the L's geometry alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError

from .definition import Panel
from .images import Blobs, View

#: Distances between markers agree with the panel's this well (rms), m or as a share of its size.
FIT_M, FIT_SHARE = 0.005, 0.006
#: All distances may be this much too long or too short together: the depth's error, the focal length's.
SCALE = 0.04
#: Another reading is as good where its misfit is below this many times the best one's, and this much more, m.
AS_GOOD, MORE_M = 3.0, 0.0015
#: Steeper against the line of sight than this a panel is edge-on, degrees between normal and line of sight.
EDGE_ON_DEG = 65.0
#: Spots whose spread across is below this share of that along lie on one line.
ON_ONE_LINE = 0.1
SEE_DEPTH = "check that the camera measures depth there (dull surface, 0.5 to 4 m away, no sunlight)."
TURN_IT = "turn it towards the camera, within 40 degrees of facing it."
_PAIRS = np.array(list(combinations(range(4), 2)))
_ORDERS = np.array(list(permutations(range(4))))


class NotSeen(CalibrationError):
    """The panel was not found in a view."""

    def __init__(self, text: str, final: bool = False):
        super().__init__(text)
        self.final = final
        self.view: View | None = None
        self.blobs: Blobs | None = None

    def add(self, view: View, blobs: Blobs) -> None:
        """Say what was looked at."""
        self.view, self.blobs = view, blobs


class NotIdentified(NotSeen):
    """The four markers could not be identified; a picture of what was seen helps."""


class MirrorImage(NotSeen):
    """The panel's definition is the mirror image of the panel."""


class EdgeOn(NotSeen):
    """The panel is seen too flat."""


class DepthMissing(NotSeen):
    """The camera has no depth where the panel is."""


@dataclass(frozen=True)
class Reading:
    """One way to read four points as the panel's markers."""

    index: tuple[int, ...]  # (4,) which point is which marker
    misfit_m: float  # Rms of the distances' differences, after `scale`
    scale: float  # Distances over the panel's


def identify_spots(
    blobs: Blobs, depth_m: FloatArray, rays: FloatArray, panel: Panel, name: str
) -> tuple[Reading, FloatArray]:
    """The spots that are the panel's markers."""
    if len(blobs) < 4:
        count = ("no bright spot is", "one bright spot is", "two bright spots are", "three bright spots are")
        raise NotIdentified(
            f"{name}: {count[len(blobs)]} visible in the infrared image and the panel has four markers;"
            " check that all four face the camera and nothing covers them."
        )
    sets = np.array(list(combinations(range(len(blobs)), 4)))
    thetas, known = _planes(blobs.pixels[sets], depth_m, rays)
    if not known.any():
        if _on_one_line(blobs):
            raise _edge_on_line(name)
        raise DepthMissing(f"{name}: depth is missing under the panel; {SEE_DEPTH}")
    sets, thetas = sets[known], thetas[known]
    ray = np.concatenate([blobs.rays[sets], np.ones((*sets.shape, 1))], axis=2)
    inverse = np.einsum("skj,sj->sk", ray, thetas)
    places = ray / np.where(inverse > 0.05, inverse, np.nan)[..., None]
    readings = _readings(places, sets, panel.markers_P, SCALE)
    facing = [r for r in readings if _faces(places, sets, r, panel)]
    if not facing and readings:
        raise MirrorImage(
            f"{name}: the markers are the mirror image of the panel's definition; give its markers as seen"
            " from the side of the markers, x along the longer arm and x cross y towards the camera.",
            final=True,
        )
    if not facing:
        raise _none_fits(name, blobs, places)
    best = _clearly_best(
        facing,
        f"{name}: {len(blobs)} bright spots are visible and fit the panel in more than one way; cover"
        " reflections beside the four markers.",
    )
    row = int(np.flatnonzero((np.sort(sets, axis=1) == np.sort(best.index)).all(axis=1))[0])
    where = [int(np.flatnonzero(sets[row] == spot)[0]) for spot in best.index]
    return best, places[row][where]


def identify_markers(markers_E: FloatArray, panel: Panel, name: str) -> Reading:  # markers_E (M, 3) m
    """The mocap markers that are the panel's."""
    if len(markers_E) < 4:
        raise NotIdentified(f"{name}: {len(markers_E)} mocap markers were given and the panel has four.")
    if len(markers_E) > 40:
        raise NotIdentified(f"{name}: {len(markers_E)} markers are too many; give only the panel's four.")
    sets = np.array(list(combinations(range(len(markers_E)), 4)))
    readings = _readings(markers_E[sets], sets, panel.markers_P, 0.02)
    if not readings:
        size = np.ptp(markers_E, axis=0).max() / panel.size_m
        unit = " (they look like millimetres; give metres)" if 200 < size < 5000 else ""
        raise NotIdentified(
            f"{name}: the mocap markers do not have the distances of the panel's definition{unit}; check"
            " that the file belongs to this panel, and measure the panel again."
        )
    return _clearly_best(
        readings,
        f"{name}: the mocap markers fit the panel in more than one way; use a panel whose arms differ in"
        " length, and give only its four markers.",
    )


def _readings(places: FloatArray, sets: FloatArray, markers_P: FloatArray, scale_off: float) -> list[Reading]:
    """All ways to read sets of four places (S, 4, 3) as the panel, the best first."""
    lengths = np.linalg.norm(places[:, _PAIRS[:, 0]] - places[:, _PAIRS[:, 1]], axis=2)  # (S, 6)
    # markers (orders, pairs): the set's point k is taken for marker order[k]
    wanted = np.linalg.norm(markers_P[_ORDERS[:, _PAIRS[:, 0]]] - markers_P[_ORDERS[:, _PAIRS[:, 1]]], axis=2)
    scale = lengths @ wanted.T / (wanted**2).sum(axis=1)  # (S, 24)
    misfit = np.sqrt(np.mean((lengths[:, None] / scale[..., None] - wanted[None]) ** 2, axis=2))
    fits = (misfit < max(FIT_M, FIT_SHARE * wanted.max())) & (np.abs(scale - 1) < scale_off)
    found = []
    for row, order in zip(*np.nonzero(fits), strict=True):
        index = tuple(int(sets[row][k]) for k in np.argsort(_ORDERS[order]))
        found.append(Reading(index, float(misfit[row, order]), float(scale[row, order])))
    return sorted(found, key=lambda reading: reading.misfit_m)


def _clearly_best(readings: list[Reading], otherwise: str) -> Reading:
    best = readings[0]
    if len(readings) > 1 and readings[1].misfit_m < max(AS_GOOD * best.misfit_m, best.misfit_m + MORE_M):
        raise NotIdentified(otherwise, final=True)
    return best


def _faces(places: FloatArray, sets: FloatArray, reading: Reading, panel: Panel) -> bool:
    """Whether x cross y of this reading points towards the camera."""
    row = int(np.flatnonzero((np.sort(sets, axis=1) == np.sort(reading.index)).all(axis=1))[0])
    where = [int(np.flatnonzero(sets[row] == spot)[0]) for spot in reading.index]
    at = places[row][where]
    # least-squares images of the panel's x and y
    axes = np.linalg.lstsq(panel.markers_P - panel.markers_P.mean(axis=0), at - at.mean(axis=0), rcond=None)[
        0
    ]
    return bool(np.cross(axes[0], axes[1]) @ at.mean(axis=0) < 0)


def _planes(corners: FloatArray, depth_m: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Planes (S, 3) of the depth between four spots each, and whether there was enough depth for one."""
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(4), 400)
    weights = weights[weights.max(axis=1) < 0.8][:240]  # away from the markers' own holes
    at = np.rint(np.einsum("nk,skj->snj", weights, corners)).astype(int)
    depth = depth_m[at[..., 1], at[..., 0]]
    full = np.concatenate([rays[at[..., 1], at[..., 0]], np.ones((*depth.shape, 1))], axis=2)
    seen = np.isfinite(depth)
    known = seen.sum(axis=1) >= 30
    inverse = np.where(seen, 1 / depth, 0.0)
    triples = rng.integers(0, depth.shape[1], (60, 3))
    matrices, values = full[:, triples], inverse[:, triples]
    sound = seen[:, triples].all(axis=2) & (np.abs(np.linalg.det(matrices)) > 1e-8)
    matrices = np.where(sound[..., None, None], matrices, np.eye(3))
    tried = np.linalg.solve(matrices, values[..., None])[..., 0]  # (S, T, 3)
    off = np.abs(np.einsum("snj,stj->stn", full, tried) - inverse[:, None])
    off = np.where(seen[:, None], off, np.nan)
    with np.errstate(invalid="ignore"):
        median = np.nanmedian(np.where(known[:, None, None], off, 0.0), axis=2)
    median = np.where(sound, median, np.inf)
    best = np.argmin(median, axis=1)
    rows = np.arange(len(corners))
    theta, limit = tried[rows, best], 3 * 1.4826 * median[rows, best] + 1e-4
    near = seen & (off[rows, best] <= limit[:, None])
    known &= np.isfinite(median[rows, best]) & (near.sum(axis=1) >= 20)
    weight = near[..., None] * full
    normal = np.einsum("snj,snk->sjk", weight, full) + 1e-12 * np.eye(3)
    refined = np.linalg.solve(normal, np.einsum("snj,sn->sj", weight, inverse)[..., None])[..., 0]
    return np.where(known[:, None], refined, theta), known


def _none_fits(name: str, blobs: Blobs, places: FloatArray) -> NotSeen:
    """The message where no four spots fit the panel; `places` (S, 4, 3) of all sets of four."""
    if _on_one_line(blobs):
        return _edge_on_line(name)
    if len(blobs) > 4:
        return NotIdentified(
            f"{name}: of {len(blobs)} bright spots no four have the distances of the panel's definition;"
            " check that all four markers are visible, and cover other reflections."
        )
    centre = places[0].mean(axis=0)
    if np.isfinite(centre).all():
        normal = np.linalg.svd(places[0] - centre)[2][2]
        angle = np.degrees(np.arccos(min(abs(normal @ centre) / np.linalg.norm(centre), 1.0)))
        if angle > EDGE_ON_DEG - 10:
            return EdgeOn(f"{name}: the panel is seen edge-on; {TURN_IT}")
    return NotIdentified(
        f"{name}: the four bright spots do not have the distances of the panel's definition; check that"
        " all four are markers of this panel, and that the panel was measured in metres."
    )


def _on_one_line(blobs: Blobs) -> bool:
    spread = np.linalg.svd(blobs.rays - blobs.rays.mean(axis=0), compute_uv=False)
    return bool(spread[1] < ON_ONE_LINE * spread[0])


def _edge_on_line(name: str) -> EdgeOn:
    return EdgeOn(
        f"{name}: the bright spots lie on one line, as those of a panel that is seen edge-on; {TURN_IT}"
    )
