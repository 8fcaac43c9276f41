"""How far away one camera without depth has the arm, in words: where motion hardly shows it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..array_types import FloatArray
from ..linalg import unit
from ..measurements.rays import is_alone
from ..recording import FOCAL_CALIBRATED
from ..result import Recovery

#: A distance that is known worse than this deserves a sentence; one worse than the second is not known, m: an
#: error of 10 cm is then within 2.5 sigmas.
CARE_M, UNKNOWN_M = 0.03, 0.04
#: Of the samples, at most about this many are looked at.
MOST_SAMPLES = 5_000


def distance_sigma_m(recovery: Recovery) -> float | None:
    """How well the wrist's distance from the camera is known, m: median sigma, in gaps if there are any."""
    origins = recovery.arm.ray_origin_m
    if origins is None or not is_alone(origins) or "wrist" not in recovery.joints:
        return None
    rows = np.arange(0, len(recovery), max(len(recovery) // MOST_SAMPLES, 1))
    hidden = np.asarray(recovery.occluded)[rows]
    if hidden.any():
        rows = rows[hidden]
    ray: FloatArray = unit(np.asarray(recovery.joints["wrist"][rows]) - origins[0])
    variance = np.einsum("ni,nij,nj->n", ray, np.asarray(recovery.joint_covariance["wrist"][rows]), ray)
    known = variance[np.isfinite(variance)]
    return float(np.sqrt(np.median(known))) if len(known) else None


def distance_unknown(recovery: Recovery) -> Iterator[str]:
    """A distance that motion and the limbs' lengths leave open."""
    sigma_m = distance_sigma_m(recovery)
    if sigma_m is not None and sigma_m > UNKNOWN_M:
        yield _sentence(sigma_m, recovery.arm.focal_share)


def distance_doubtful(recovery: Recovery) -> Iterator[str]:
    """A distance that they hardly show."""
    sigma_m = distance_sigma_m(recovery)
    if sigma_m is not None and CARE_M < sigma_m <= UNKNOWN_M:
        yield _sentence(sigma_m, recovery.arm.focal_share)


def _sentence(sigma_m: float, focal_share: float) -> str:
    lens = "calibrate the lens with its distortion, " if focal_share > FOCAL_CALIBRATED else ""
    return (
        f"the distance from the camera is not determined better than {100 * sigma_m:.0f} cm (one sigma): one"
        f" camera without depth sees a larger arm farther away alike; {lens}move the arm faster in view,"
        " state --body-height, or add a second camera"
    )
