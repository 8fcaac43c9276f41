"""Cameras that are wrong as a whole: mirrored, of somebody else, moved, or never looking with the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..array_types import FloatArray
from ..linalg import nearest_rotation
from ..recording import CameraPose
from ..rotation import Rotation
from .placing import Placement, residuals, start, weights
from .rig import Overlap

#: A camera that sees the forearm together with the first one for less than this is not placed, s.
LEAST_S = 3.0
#: Joints that are as far apart as this, m, and as this share of how far they move, are not the same arm's.
OTHER_M, OTHER_SHARE = 0.09, 0.55
#: Mirrored, the two agree this much better, as a share of the distance, where that is more than this, m.
MIRRORED_M, MIRRORED_SHARE = 0.03, 0.6
#: What both saw is placed in parts: the length of a part, s, and the number of parts at most.
PART_S, MOST_PARTS = 8.0, 24
#: A camera was moved where the parts before and after a time differ by this, m and rad, and in sigmas.
MOVED_M, MOVED_RAD, MOVED_SIGMAS = 0.04, np.radians(3.0), 4.0
#: .. and where each part by itself fits to within this, m.
PLACED_M = 0.065


@dataclass(frozen=True)
class Move:
    """A camera that stood elsewhere from a time on."""

    t_s: float  # On the first camera's clock, to some seconds
    between_s: tuple[float, float]  # The middles of the parts before and after
    turned_rad: float  # By how much
    shifted_m: float  # By how much, where it sees the arm
    misfit_m: float  # Median distance of the joints, each part at its own place

    def sentence(self, first: str) -> str:
        """What is said of the camera; `first` is the other one's name."""
        return (
            f"from about {self.t_s:.0f} s on it is {100 * self.shifted_m:.0f} cm and"
            f" {np.degrees(self.turned_rad):.0f} degrees from its earlier place, relative to {first}: one of"
            " the two was moved; cut the recording there"
        )


def never_together(first: str) -> str:
    """Why a camera is not placed that sees too little together with the first one, whose name is given."""
    return (
        f"it sees the forearm for less than {LEAST_S:g} s together with {first}, at no clock offset; put it"
        " where both see the arm, or let both see it for some seconds at the start"
    )


def fault_of(
    found: Sequence[tuple[Placement, Overlap]], best: Placement, first: str
) -> tuple[str, tuple[float, float] | None]:
    """Why a camera cannot be used, in words ("" where it can), and between when one of the two was moved."""
    mirrored_m = min(start(together.mirrored(), each.clock).misfit_m for each, together in found)
    if best.misfit_m > MIRRORED_M and mirrored_m < MIRRORED_SHARE * best.misfit_m:
        return (
            f"its joints fit {first}'s as a mirror image only ({100 * mirrored_m:.0f} cm apart in the"
            f" middle, {100 * best.misfit_m:.0f} cm as they are): it or {first} is mirrored; mirror it"
            " back in the camera's program"
        ), None
    # at a wrong offset parts may lie somewhere by chance, but no better than the whole at its right place
    moves = [
        move
        for each, together in found
        if (move := moved(together, partial(_shift, each))) is not None and move.misfit_m < best.misfit_m
    ]
    if moves:
        move = min(moves, key=lambda each: each.misfit_m)
        return move.sentence(first), move.between_s
    if best.misfit_m > OTHER_M and best.misfit_m > OTHER_SHARE * best.spread_m:
        return (
            f"its joints are {100 * best.misfit_m:.0f} cm from {first}'s for any pose and clock: it saw"
            " another person or the other arm, or is of another session"
        ), None
    return "", None


def moved(
    together: Overlap,
    shift: Callable[[Overlap], tuple[FloatArray, FloatArray, float] | None],
    placed_m: float = PLACED_M,
) -> Move | None:
    """The time that parts the parts' places best, if they differ by more than chance.

    `shift` gives a part's turn and shift (6,) against the whole, their variances, and its misfit.
    """
    count = min(int(len(together) * together.step_s / PART_S), MOST_PARTS)
    edges, t = np.linspace(0, len(together), max(count, 1) + 1).astype(int), together.t
    found = [(part, shift(together.rows(part))) for part in map(slice, edges[:-1], edges[1:])]
    known = [(part, *own) for part, own in found if own is not None]
    if len(known) < 2:
        return None
    parts, *columns = zip(*known, strict=True)
    values, variances, misfit_m = np.array(columns[0]), np.array(columns[1]), float(np.median(columns[2]))
    if misfit_m > placed_m:
        return None  # no place makes it the same arm
    best: Move | None = None
    most = MOVED_SIGMAS
    for cut in range(1, len(parts)):
        before, var_before = _mean(values[:cut], variances[:cut])
        after, var_after = _mean(values[cut:], variances[cut:])
        apart = after - before
        sigmas = float(np.sqrt(np.mean(apart**2 / (var_before + var_after))))
        turned, shifted = float(np.linalg.norm(apart[:3])), float(np.linalg.norm(apart[3:]))
        if sigmas > most and (turned > MOVED_RAD or shifted > MOVED_M):
            at_s = 0.5 * float(t[parts[cut - 1].stop - 1] + t[parts[cut].start])
            first_s, last_s = (float(t[(part.start + part.stop) // 2]) for part in parts[cut - 1 : cut + 1])
            best, most = Move(at_s, (first_s, last_s), turned, shifted, misfit_m), sigmas
    return best


def _mean(values: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of parts (k, 6), each weighted by what it knows, and its variance by their scatter as well."""
    weight = 1.0 / variances
    mean = (weight * values).sum(axis=0) / weight.sum(axis=0)
    by_parts = 1.0 / weight.sum(axis=0)
    if len(values) > 1:
        chi = (weight * (values - mean) ** 2).sum(axis=0) / (len(values) - 1)
        by_parts = by_parts * np.maximum(chi, 1.0)
    return mean, by_parts


def _shift(placement: Placement, together: Overlap) -> tuple[FloatArray, FloatArray, float]:
    """How a part of the moments is turned and shifted against the whole, (6,), its variances, its misfit."""
    R, p = placement.R, placement.p
    for _ in range(5):
        placed = together.other @ R.T + p + placement.offset_m
        residual = np.where(together.both[:, :, None], together.first - placed, np.nan)
        w = weights(residual, together.both)[together.both]
        a, b = together.first[together.both], placed[together.both]
        mean_a, mean_b = (w @ a) / w.sum(), (w @ b) / w.sum()
        turn = nearest_rotation((w[:, None] * (a - mean_a)).T @ (b - mean_b))
        offset = placement.offset_m
        R, p = turn @ R, turn @ (p - mean_b) + mean_a + turn @ offset.mean(axis=0) - offset.mean(axis=0)
    turned = Rotation.from_matrix(R @ placement.R.T).as_rotvec()
    centre = placement.centre_m
    shifted = R @ placement.R.T @ (centre - placement.p) + p - centre
    there = replace(placement, R=R, p=p)
    distance = np.linalg.norm(residuals(there, together)[together.both], axis=1)
    return np.concatenate([turned, shifted]), _variances(there, together), float(np.median(distance))


#: Errors of a skeleton last this long, s: samples within it are treated as one.
MEMORY_S = 1.0


def _variances(placement: Placement, together: Overlap) -> FloatArray:
    """Variances (6,) of a part's turn and shift, by its own scatter."""
    placed = together.other @ placement.R.T + placement.p - placement.centre_m
    point, share = placed[together.both], min(together.step_s / MEMORY_S, 1.0)
    weight = weights(residuals(placement, together), together.both)[together.both] * share
    turn = np.sum(point**2, axis=1)[:, None, None] * np.eye(3) - point[:, :, None] * point[:, None, :]
    information = (turn * weight[:, None, None]).sum(axis=0) + 1e-6 * np.eye(3)
    shift = np.full(3, 1.0 / max(float(weight.sum()), 1e-9))
    return np.concatenate([np.diag(np.linalg.inv(information)), shift])


def moved_from(found: CameraPose, known: CameraPose, points: FloatArray) -> str:  # points (F, 5, 3) m
    """What is said of a camera that does not stand where a calibration says; "" where it does."""
    centre = np.nanmedian(points.reshape(-1, 3), axis=0)
    in_C = found.R_K_C.T @ (centre - found.p_K_C_m)
    shifted_m = float(np.linalg.norm(known.to_first(in_C) - centre))
    turned = float(np.linalg.norm(Rotation.from_matrix(found.R_K_C @ known.R_K_C.T).as_rotvec()))
    turned_most = max(MOVED_RAD, MOVED_SIGMAS * float(np.hypot(found.sigma_rad, known.sigma_rad)))
    shifted_most = max(MOVED_M, MOVED_SIGMAS * float(np.hypot(found.sigma_m, known.sigma_m)))
    if turned < turned_most and shifted_m < shifted_most:
        return ""
    return (
        f"is {100 * shifted_m:.0f} cm and {np.degrees(turned):.0f} degrees from its calibrated place: it"
        " was moved since, and that place was not used; run `calibrate cameras` again"
    )
