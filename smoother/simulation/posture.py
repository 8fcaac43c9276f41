"""The postures that the simulated person moves through, as joint angles of the right arm."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from .body import FLEXION, GIRDLE, POSTURE_SIZE, PRONATION, SHOULDER

# Directions in {T} (x the person's right, y up, z back): shoulder to elbow, elbow to wrist, palm; then the
# shift of the shoulder girdle, m.
_POSTURES: dict[str, tuple[tuple[float, float, float], ...]] = {
    "hang": ((0.12, -0.99, 0.02), (0.05, -0.97, -0.22), (-1.0, 0.0, 0.1), (0.0, 0.0, 0.0)),
    "initial": ((0.88, -0.38, -0.28), (0.05, 0.98, -0.20), (0.0, -0.1, -1.0), (0.0, 0.02, 0.0)),
    "beside_head": ((0.72, 0.62, -0.10), (-0.25, 0.85, 0.20), (-0.1, 0.0, -1.0), (-0.01, 0.04, 0.0)),
    "behind_head": ((0.36, 0.93, 0.02), (-0.90, -0.12, 0.40), (-0.3, 0.0, -1.0), (-0.02, 0.05, 0.01)),
    "on_nape": ((0.30, 0.95, 0.00), (-0.85, -0.36, 0.40), (-0.3, 0.0, -1.0), (-0.02, 0.05, 0.01)),
    "belly": ((0.30, -0.90, -0.28), (-0.88, 0.05, -0.40), (0.2, 0.0, 1.0), (0.0, 0.0, -0.01)),
    "side": ((0.50, -0.80, 0.25), (0.15, -0.98, -0.05), (-0.5, 0.0, 0.8), (0.0, 0.0, 0.01)),
    "behind_back": ((0.33, -0.85, 0.42), (-0.93, -0.20, 0.22), (0.0, -0.2, 1.0), (0.0, -0.01, 0.02)),
    "up_the_back": ((0.42, -0.80, 0.44), (-0.93, 0.12, 0.18), (0.0, -0.2, 1.0), (0.0, 0.0, 0.02)),
    "reach": ((0.35, -0.60, -0.65), (-0.20, 0.15, -0.95), (-0.9, -0.3, 0.0), (0.0, 0.01, -0.01)),
}


def _frames(name: str) -> tuple[Rotation, Rotation]:
    """Rotations `R_T_U` and `R_T_F` of a posture."""
    upper, fore, palm = (np.asarray(v) / np.linalg.norm(v) for v in _POSTURES[name][:3])
    # Flexion turns the forearm towards -x of {U}, so x points away from it.
    x_upper = upper * (fore @ upper) - fore
    x_upper /= np.linalg.norm(x_upper)
    x_fore = fore * (palm @ fore) - palm
    x_fore /= np.linalg.norm(x_fore)
    R_T_U = np.column_stack([x_upper, upper, np.cross(x_upper, upper)])
    R_T_F = np.column_stack([x_fore, fore, np.cross(x_fore, fore)])
    return Rotation.from_matrix(R_T_U), Rotation.from_matrix(R_T_F)


@cache
def reference() -> Rotation:
    """The upper arm's rotation `R_T_U` from which the shoulder's rotation vectors count: the mean posture."""
    return Rotation.concatenate([_frames(name)[0] for name in _POSTURES]).mean()


def posture(name: str) -> FloatArray:
    """The joint angles (8,) of a named posture, columns as in `body`."""
    R_T_U, R_T_F = _frames(name)
    bend = (R_T_U.inv() * R_T_F).as_matrix()
    flexion = np.arctan2(-bend[0, 1], bend[1, 1])
    turn = np.arctan2(-bend[2, 0], bend[2, 2])  # bend = Rz(flexion) Ry(turn)
    out = np.empty(POSTURE_SIZE)
    out[GIRDLE] = _POSTURES[name][3]
    out[SHOULDER] = (reference().inv() * R_T_U).as_rotvec()
    out[FLEXION], out[PRONATION] = flexion, -turn
    return out
