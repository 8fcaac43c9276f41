"""The sigmas that baselines state, against their errors: bounded from both sides by what was measured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_scenes import arm, scene_of

from smoother.array_types import FloatArray
from smoother.baselines.gaussian_process import gaussian_process
from smoother.baselines.kalman import kalman, multirate_kalman
from smoother.baselines.rts import rts
from smoother.baselines.scene import Baseline
from smoother.baselines.ukf import ukf

#: NEES per degree of freedom over the arms of seeds 0 to 3 with gaps of a second: while the arm is visible,
#: in gaps, and of the orientation where the method states its covariance. 1 is consistent, less is
#: under-confident.
MEASURED: dict[Baseline, tuple[float, float, float | None]] = {
    rts: (0.65, 0.52, 0.34),
    ukf: (0.78, 0.38, 0.34),
    kalman: (1.86, 2.21, None),
    multirate_kalman: (1.25, 2.41, None),
    gaussian_process: (1.02, 0.55, None),
}
#: Sigmas that are all wrong by a quarter change NEES by more than this.
FACTOR = 1.5


def nees(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normalised squared errors (k,) per degree of freedom of errors (k, 3) (Bar-Shalom et al. 2001, 5.4)."""
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0]) / 3.0


@pytest.mark.parametrize("baseline", MEASURED, ids=lambda baseline: baseline.__name__)
def test_sigmas_go_with_the_errors(baseline: Baseline):
    visible, occluded, attitude = [], [], []
    for seed in range(4):
        made = arm("white", seed, occlusion_lengths_s=(1.0,))
        scene, truth = scene_of(made, tilt_deg=1.0), made.recording.truth
        path = baseline(scene)
        assert truth is not None and path.covariance is not None
        answered = np.isfinite(path.position).all(axis=1)
        error = path.position - truth.position
        for rows, squares in ((answered & ~scene.occluded, visible), (answered & scene.occluded, occluded)):
            squares.append(nees(error[rows], path.covariance[rows]))
        if path.attitude_covariance is not None:
            true = Rotation.from_quat(truth.quaternion, scalar_first=True)
            turn = (Rotation.from_matrix(path.R_K_A) * true.inv()).as_rotvec()
            attitude.append(nees(turn[answered], path.attitude_covariance[answered]))
    for squares, measured in zip((visible, occluded, attitude), MEASURED[baseline], strict=True):
        if measured is None:
            assert not squares
        else:
            assert measured / FACTOR < np.concatenate(squares).mean() < measured * FACTOR
