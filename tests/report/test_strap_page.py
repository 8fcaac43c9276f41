"""The brightness picture of `import strap`."""

from __future__ import annotations

from base64 import b64decode
from types import SimpleNamespace

import cv2
import numpy as np

from smoother.report.strap import brightness, side_by_side


def test_what_the_camera_did_not_see_stays_empty():
    t = np.array([0.0, 0.1, 0.2, 1.2, 1.3, 1.4])
    table = np.tile(10.0 * np.arange(1, 7), (5, 1))
    (start, end), png = side_by_side(t, table)
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (5, 15, 4)
    np.testing.assert_allclose([start, end], [-0.05, 1.45])
    at = start + (np.arange(15) + 0.5) * (end - start) / 15
    empty = picture[0, :, 3] == 0
    np.testing.assert_array_equal(empty, (at > 0.35) & (at < 1.05))
    np.testing.assert_array_equal(picture[0, [0, 1, 2, 12, 13, 14], 0], 10 * np.arange(1, 7))


def test_dots_lie_on_the_dark_line():
    part = np.linspace(0.05, 1.03, 100)
    profile = np.where(np.abs(part - 0.62) < 0.05, 20.0, 200.0)
    found = SimpleNamespace(
        profiles=[(0.1 * k, profile) for k in range(5)],
        reasons=["", "", "no depth image", "", ""],
        t_s=0.1 * np.arange(5),
        along=np.full(5, 0.8),  # of the seen surface: elsewhere, for a camera from the side
        in_profile=np.full(5, 0.62),
    )
    drawn = brightness(found)
    image, dots = drawn.layout.images[0], drawn.data[0]
    assert len(dots.x) == 4
    grey = cv2.imdecode(np.frombuffer(b64decode(image.source.split(",")[1]), np.uint8), cv2.IMREAD_UNCHANGED)
    share = (image.y - np.asarray(dots.y, float)) / image.sizey  # from the picture's top
    rows = (share * grey.shape[0]).astype(int)
    assert (grey[rows, 0, 0] == 20).all()
