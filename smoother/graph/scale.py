"""How probable a scale is, where motion alone shows it: one camera without depth.

The optimum of all variables together is not that of the scale alone. Positions that pixels determine are
known to an angle times the distance: in a larger scene there are more of them that fit, by the distance
once for each coordinate that pixels determine. The probability of a scale is the integral over the
positions (Laplace's approximation; Tierney and Kadane, JASA 1986), so its logarithm has a term N
log(scale), where N is how many coordinates these are: the trace of the hat matrix of the keypoints' rows,
of positions, given the arm's constants. Without it slow motion, which hardly shows the scale, seems
nearer and the arm smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from gtsam.symbol_shorthand import G, U

from ..array_types import FloatArray
from ..body import FOREARM
from ..window.problem import Priors
from .build import FactorGroup
from .linear_system import LinearSystem
from .shared_prior import lever_keys
from .solved import SolvedWindow
from .variables import keys_of

#: Where a window begins and how fast: nothing but pixels determines that in any scene.
FREE = 6.0


def coordinates_by_pixels(solved: SolvedWindow) -> float:
    """How many coordinates of positions keypoints determine in a window at its optimum."""
    system, layout = solved.system(), solved.window.priors.layout
    held = [G(0), *([U(0)] if layout.has_upper_arm else []), *lever_keys(layout)]
    total = 0.0
    for group in solved.groups:
        if group.kind != "camera" or group.of == "shoulder" or not len(group.nodes):
            continue
        pose = keys_of(layout.segment_of(group.of)).pose
        keys = [pose + int(node) for node in group.nodes]
        rows = _rows(system, group, keys)
        covariance = system.covariances(keys, held)
        # a pose's columns are turn, then position; turning moves a joint by a lever arm, which grows as well
        total += float(np.einsum("nij,njk,nik->", rows, covariance[:, :, -3:], rows[:, :, -3:]))
    return max(total - FREE, 0.0)


def _rows(system: LinearSystem, group: FactorGroup, keys: Sequence[int]) -> FloatArray:
    """The rows (n, 3, d) of a group's factors by each one's own variable."""
    row, column, value = system.jacobian.entries(group.rows)
    first = np.array([system.columns(key).start for key in keys])
    size = system.columns(keys[0]).stop - first[0]
    factor = row // 3
    own = column - first[factor]
    mine = (own >= 0) & (own < size)
    dense = np.zeros((len(keys), 3, int(size)))
    dense[factor[mine], row[mine] % 3, own[mine]] = value[mine]
    return dense


def with_scale_term(priors: Priors, coordinates: float) -> Priors:
    """The prior on what all share times the forearm's length to the power of `coordinates`."""
    layout, shared = priors.layout, priors.shared
    wrist, elbow = layout.lever("wrist", FOREARM.name), layout.lever("elbow", FOREARM.name)
    apart = shared.mean[wrist] - shared.mean[elbow]
    slope = np.zeros(layout.size)
    slope[wrist] = coordinates * apart / float(apart @ apart)
    slope[elbow] = -slope[wrist]
    return replace(priors, shared=replace(shared, mean=shared.mean + shared.covariance @ slope))
