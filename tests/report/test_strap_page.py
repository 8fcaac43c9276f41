"""The brightness picture of `import strap`."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from smoother.report.strap import brightness


def test_what_the_camera_did_not_see_stays_empty():
    t = np.array([0.0, 0.1, 0.2, 1.2, 1.3, 1.4])
    found = SimpleNamespace(
        profiles=[(time, np.full(5, 10.0 * k)) for k, time in enumerate(t)],
        reasons=[""] * 6,
        t_s=t,
        along=np.full(6, 0.7),
    )
    drawn = brightness(found).data[0]
    x, z = np.array(drawn.x, dtype=float), np.array(drawn.z, dtype=float)
    np.testing.assert_allclose(x, [0, 0.1, 0.2, 0.3, 1.1, 1.2, 1.3, 1.4])
    np.testing.assert_array_equal(np.isnan(z).all(axis=0), (x > 0.25) & (x < 1.15))
    np.testing.assert_array_equal(z[0, ~np.isnan(z[0])], 10.0 * np.arange(6))
