"""Images of the panel: bright spots, the depth's plane, three regions without markers (JA fig. 1b)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smoother.array_types import BoolArray, FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import robust_sigma
from smoother.runtime.inputs import check_input

from .intrinsics import Intrinsics

#: A larger image is none of a camera; 111 bytes of PNG may state a thousand times as much.
MOST_PIXELS = 1 << 26
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"


def unpacked(
    packed: bytes,
    others: bool = False,
) -> NDArray:  # (height, width) or (height, width, channels)
    """The pixels of a PNG or a JPEG, by OpenCV; of `others` that it knows, too."""
    # What OpenCV itself holds for too large; it looks at it once, when it unpacks its first image.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
    import cv2

    if not (others or packed.startswith((_PNG, _JPEG))):
        raise ValueError("neither PNG nor JPEG")
    place = len(_PNG)  # OpenCV takes memory for as much as a PNG's chunks state
    while packed.startswith(_PNG) and place < len(packed):
        if len(packed) < (place := place + 12 + int.from_bytes(packed[place : place + 4], "big")):
            raise ValueError("the image breaks off")
    try:
        image = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED) if packed else None
    except cv2.error as error:
        raise ValueError(f"it is damaged, or larger than {MOST_PIXELS} pixels") from error
    if image is None:
        raise ValueError("it is damaged")
    return np.asarray(image)


@dataclass(frozen=True)
class View:
    """What the camera saw of the panel in one pose."""

    depth_m: FloatArray  # (height, width) m: z of every pixel, m; nan where the camera has none
    infrared: FloatArray  # (height, width): in the image's own unit
    name: str = "the view"  # What to call it in messages


def read_view(depth_png: str | os.PathLike[str], infrared_png: str | os.PathLike[str]) -> View:
    """Read a depth image (16 bit, mm, 0 where there is none) and its infrared image (8 or 16 bit)."""
    depth = _read(depth_png)
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise CalibrationError(
            f"{depth_png} is not a depth image: it must have one channel of 16 bit, depth in millimetres."
        )
    infrared = _read(infrared_png)
    if infrared.ndim == 3:
        infrared = infrared[..., :3].max(axis=2)
    return view(depth, infrared, Path(depth_png).name)


def view(depth_mm: NDArray, infrared: NDArray, name: str) -> View:
    """A view of images as cameras give them: depth in mm, 0 where there is none."""
    depth = np.asarray(depth_mm, dtype=np.float64)
    known = (depth > 0) & (depth < 65535)  # both ends of the range mean "none"
    return View(np.where(known, 1e-3 * depth, np.nan), np.asarray(infrared, dtype=np.float64), name)


def check_size(seen: View, lens: Intrinsics) -> None:
    """Refuse images that the lens does not belong to."""
    for what, image in (("depth", seen.depth_m), ("infrared", seen.infrared)):
        height, width = image.shape
        if (width, height) != (lens.width, lens.height):
            raise CalibrationError(
                f"{seen.name}: the {what} image has {width} x {height} pixels and the intrinsics are of"
                f" {lens.width} x {lens.height}; give the intrinsics of this camera and mode."
            )


def _read(path: str | os.PathLike[str]) -> NDArray:
    check_input(path, CalibrationError)
    try:
        with open(path, "rb") as file:
            packed = file.read()
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror or error}.") from error
    try:
        return unpacked(packed, others=True)
    except ValueError as error:
        raise CalibrationError(
            f"{path} is not an image that can be read ({error}); PNG is expected."
        ) from error


#: Brightness over the surroundings from which a spot counts, as fractions of the brightest; tried in turn.
LEVELS = (0.5, 0.25, 0.12, 0.06)
#: A spot is at least this many times as bright as its surroundings.
CONTRAST = 1.35
#: Not more spots than this are looked at, the strongest ones.
MOST = 12
#: A spot is no longer than this many times its width, and no larger than this share of the image.
ELONGATION, LARGEST = 3.5, 0.004
#: Window of the median that the surroundings are taken from, as a share of the image's width.
SURROUNDINGS = 0.08
#: The centroid is taken over what is brighter than this share of the spot's height.
FOOT = 0.15
#: A centroid is not known better than this, pixels: shape of the spot, blur, the lens' model.
FLOOR_PX = 0.04


@dataclass(frozen=True)
class Blobs:
    """Bright spots, the strongest first."""

    pixels: FloatArray  # (N, 2): centroids
    rays: FloatArray  # (N, 2): undistorted, x/z and y/z
    sigmas_px: FloatArray  # (N,) pixels: of a centroid, per axis
    radii_px: FloatArray  # (N,) pixels: of a disc of the same area

    def __len__(self) -> int:
        return len(self.pixels)


def find_blobs(infrared: FloatArray, lens: Intrinsics) -> Iterator[Blobs]:  # infrared (height, width)
    """Bright, compact spots at falling thresholds; a level that adds none is passed over."""
    surroundings = _surroundings(infrared)
    over = infrared - surroundings
    noise = float(robust_sigma(over))
    brightest = float(np.percentile(over, 100 * (1 - 5 / over.size)))
    count = -1
    for level in LEVELS:
        threshold = np.maximum(np.maximum(level * brightest, 8 * noise), (CONTRAST - 1) * surroundings)
        found = _spots(infrared, over > threshold, lens)
        if len(found) > count:
            count = len(found)
            yield found


def _surroundings(infrared: FloatArray) -> FloatArray:
    """Running median; taken on a logarithmic scale of 256 steps, which is all that OpenCV's fast one has."""
    import cv2

    low = max(float(np.percentile(infrared, 1)), 1e-4 * float(infrared.max()), 1e-12)
    span = np.log(max(float(infrared.max()) / low, 1.0 + 1e-9))
    steps = np.clip(np.log(np.maximum(infrared, low) / low) / span * 255, 0, 255)
    window = 2 * round(SURROUNDINGS * infrared.shape[1] / 2) + 1
    median = cv2.medianBlur(steps.astype(np.uint8), window)
    return low * np.exp(median.astype(np.float64) / 255 * span)


def _spots(infrared: FloatArray, mask: NDArray[np.bool_], lens: Intrinsics) -> Blobs:
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    rows = []
    for index in np.argsort(-stats[1:count, cv2.CC_STAT_AREA])[: 20 * MOST] + 1:
        if stats[index, cv2.CC_STAT_AREA] > LARGEST * mask.size:
            continue
        row = _centroid(infrared, stats[index], labels, int(index))
        if row is not None:
            rows.append(row)
    table = np.array(sorted(rows, key=lambda row: -row[4])[:MOST]).reshape(-1, 5)
    return Blobs(table[:, :2], lens.rays(table[:, :2]), *table[:, 2:4].T)


def _centroid(
    infrared: FloatArray, stats: NDArray, labels: NDArray, index: int
) -> tuple[float, float, float, float, float] | None:
    """x, y, sigma, radius (pixels) and height; None where it is not a compact spot inside the image."""
    left, top, width, height, area = (int(value) for value in stats[:5])
    margin = 3 + max(width, height) // 2
    x0, y0 = left - margin, top - margin
    x1, y1 = left + width + margin, top + height + margin
    if left <= 0 or top <= 0 or left + width >= infrared.shape[1] or top + height >= infrared.shape[0]:
        return None  # cut off by the rim: its centre is not known
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, infrared.shape[1]), min(y1, infrared.shape[0])
    window, own = infrared[y0:y1, x0:x1], labels[y0:y1, x0:x1]
    v, u = np.mgrid[y0:y1, x0:x1].astype(np.float64)
    inside = own == index
    centre = np.array([u[inside].mean(), v[inside].mean()])
    reach = max(width, height) / 2 + 2.5
    near = (u - centre[0]) ** 2 + (v - centre[1]) ** 2 <= reach**2
    near &= (own == index) | (own == 0)
    ring = ~near & (own == 0)
    foot = float(np.median(window[ring])) if ring.sum() >= 8 else float(window.min())
    peak = float(window[inside].max())
    over = np.where(near, window - foot - FOOT * (peak - foot), 0.0)
    weight = np.maximum(over, 0.0)
    total = weight.sum()
    x, y = (weight * u).sum() / total, (weight * v).sum() / total
    away = np.stack([(u - x).ravel(), (v - y).ravel()])
    spread = (weight.ravel() * away) @ away.T
    low, high = np.linalg.eigvalsh(spread / total + np.eye(2) / 12)
    if high > ELONGATION**2 * low:
        return None
    # noise of a pixel about 3 % of its value, on the spot's flanks, where the pixel is not saturated
    flank = (weight > 0) & (window < 0.98 * peak)
    lever = (u - x) ** 2 + (v - y) ** 2
    noise = 0.03 * np.sqrt(float((window[flank] ** 2 * lever[flank]).sum()) / 2) / total
    sigma = float(np.hypot(FLOOR_PX, noise))
    radius = float(np.sqrt(max(area, (weight > 0).sum()) / np.pi))
    return float(x), float(y), sigma, radius, peak - foot


def drawn_spots(infrared: FloatArray, blobs: Blobs) -> bytes:  # infrared (height, width)
    """PNG of the infrared image with every bright spot ringed, enlarged to about 1,000 pixels of width."""
    import cv2

    factor = -(-1024 // infrared.shape[1])
    top = max(float(np.percentile(infrared, 98)) * 4, 1e-9)  # both the room and the spots are to be seen
    grey = (255 * np.clip(infrared / top, 0, 1) ** 0.6).astype(np.uint8)
    image = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    rings = [
        cv2.KeyPoint(factor * (u + 0.5) - 0.5, factor * (v + 0.5) - 0.5, 2 * factor * (radius + 3))
        for (u, v), radius in zip(blobs.pixels.tolist(), blobs.radii_px.tolist(), strict=True)
    ]
    picture = cv2.drawKeypoints(
        image, rings, image, (0, 170, 255), cv2.DRAW_MATCHES_FLAGS_DRAW_RICH_KEYPOINTS
    )
    _, packed = cv2.imencode(".png", picture)
    return bytes(packed.tobytes())


#: How far from one line markers may lie and still be an arm of the L, m.
ON_A_LINE_M = 0.01


@dataclass(frozen=True)
class Panel:
    """A flat panel with four markers in the shape of an L."""

    markers_P: FloatArray  # (4, 2) m: the first is the corner of the L, the origin
    extent_P: FloatArray  # (2, 2) m: lower and upper corner of the panel
    height_m: float = 0.0  # Of the markers' centres above the panel; 0 for flat ones

    @property
    def size_m(self) -> float:
        """Largest distance between two markers."""
        return float(np.linalg.norm(self.markers_P[:, None] - self.markers_P[None], axis=2).max())

    def arms(self) -> tuple[FloatArray, FloatArray]:
        """Markers (n, 2) of the arm along x and of the arm along y, the corner in both."""
        away = np.abs(self.markers_P - self.markers_P[0])
        return self.markers_P[away[:, 1] < ON_A_LINE_M], self.markers_P[away[:, 0] < ON_A_LINE_M]


@dataclass(frozen=True)
class Frame:
    """Axes of the panel (columns of `R`) and its origin, seen from another frame, m."""

    R: FloatArray
    origin: FloatArray

    def after(self, other: Frame) -> Frame:
        """The transform that takes `other`'s frame to this one's (JA eq 4 and 5)."""
        R = self.R @ other.R.T
        return Frame(R, self.origin - R @ other.origin)


#: A pixel farther from the plane than this many sigmas is not used.
OUTLIER = 3.5
#: Nothing nearer to the plane than this is an outlier, m: a camera counts in millimetres.
LEAST_OUTLIER_M = 0.004
#: A start is tried on this many triples of pixels.
TRIPLES = 200
#: Fewer pixels than this, or than this share of those given, make no plane.
FEWEST, LEAST_SHARE = 60, 0.3
#: No depth camera scatters more than this share of the depth.
LARGEST_NOISE = 0.02
#: Step of the depth's offset for the derivatives, m.
STEP_M = 0.01


@dataclass(frozen=True)
class Plane:
    """A plane in the camera frame {K}."""

    theta: FloatArray  # (3,): 1/m; points fulfil theta . p = 1
    covariance: FloatArray  # (3, 3): of theta, widened for a bent depth
    offset_rate: FloatArray  # (3,)
    offset_curve: FloatArray  # (3,)
    inliers: BoolArray  # bool (N,): pixels that were used
    noise_m: float  # Standard deviation of a pixel's depth

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,), towards the camera."""
        return -self.theta / np.linalg.norm(self.theta)

    def at_offset(self, offset_m: float) -> FloatArray:
        """`theta` if every depth is too long by `offset_m`."""
        return self.theta + offset_m * (self.offset_rate + offset_m * self.offset_curve)


def on_plane(theta: FloatArray, rays: FloatArray) -> FloatArray:
    """Where rays (..., 2) meet the plane theta . p = 1, (..., 3)."""
    full = np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1)
    return full / (full @ theta)[..., None]


def fit_plane(
    pixels: FloatArray,  # (N, 2)
    rays: FloatArray,  # (N, 2)
    depth_m: FloatArray,  # (N,) m
    what: str = "the view",
) -> Plane:
    """Fit a plane to depth pixels, most of which lie on it."""
    if len(depth_m) < FEWEST:
        raise CalibrationError(
            f"{what}: depth is missing under the panel ({len(depth_m)} pixels have one); see that the camera"
            " measures depth there (dull surface, 0.5 to 4 m away, no sunlight)."
        )
    full = np.column_stack([rays, np.ones(len(rays))])
    theta = robust_plane(rays, depth_m)
    inliers = np.ones(len(depth_m), dtype=bool)
    for _ in range(6):
        residuals = depth_m - 1 / (full @ theta)
        noise = float(robust_sigma(residuals[inliers] - np.median(residuals[inliers])))
        within = np.abs(residuals) <= max(OUTLIER * noise, LEAST_OUTLIER_M)
        within &= ~_beside(~within, pixels)
        rough = noise > LARGEST_NOISE * float(np.median(depth_m))
        if rough or within.sum() < max(FEWEST, LEAST_SHARE * len(within)):
            raise CalibrationError(
                f"{what}: the depth under the panel is not a plane ({within.sum()} of {len(within)} pixels"
                f" agree to {1e3 * noise:.0f} mm); check that nothing is in front of it."
            )
        theta = _least_squares(full[within], depth_m[within], theta)
        if (within == inliers).all():
            break
        inliers = within
    residuals = depth_m - 1 / (full @ theta)
    noise = float(np.std(residuals[inliers], ddof=3))
    jacobian = full[inliers] * depth_m[inliers, None] ** 2  # of the depth after theta, without its sign
    covariance = np.asarray(np.linalg.inv(jacobian.T @ jacobian), np.float64)
    covariance *= max(noise, 2e-4) ** 2
    covariance += _tilt_by_warp(jacobian, rays[inliers], _warp(rays[inliers], residuals[inliers], noise))
    low, high = (_least_squares(full[inliers], depth_m[inliers] - step, theta) for step in (-STEP_M, STEP_M))
    return Plane(
        theta=theta,
        covariance=covariance,
        offset_rate=(high - low) / (2 * STEP_M),
        offset_curve=(high + low - 2 * theta) / (2 * STEP_M**2),
        inliers=inliers,
        noise_m=noise,
    )


def robust_plane(rays: FloatArray, depth_m: FloatArray) -> FloatArray:
    """The plane (3,) of pixels half of which may be off it: least median of squares, then their inliers."""
    rng = np.random.default_rng(0)
    full, inverse = np.column_stack([rays, np.ones(len(rays))]), 1 / depth_m
    triples = rng.integers(0, len(full), (TRIPLES, 3))
    matrices = full[triples]
    usable = np.abs(np.linalg.det(matrices)) > 1e-9
    if not usable.any():
        return np.asarray(np.linalg.lstsq(full, inverse, rcond=None)[0], np.float64)
    thetas = np.linalg.solve(matrices[usable], inverse[triples[usable]][..., None])[..., 0]
    some = rng.permutation(len(full))[:1500]
    misfit = np.median(np.abs(full[some] @ thetas.T - inverse[some, None]), axis=0)
    best = int(np.argmin(misfit))
    near = np.abs(full @ thetas[best] - inverse) <= 3 * 1.4826 * misfit[best] + 1e-4
    return np.asarray(np.linalg.lstsq(full[near], inverse[near], rcond=None)[0], np.float64)


def _least_squares(full: FloatArray, depth_m: FloatArray, start: FloatArray) -> FloatArray:
    """Least squares of the depth itself, by Gauss and Newton from a start that is near."""
    theta = start
    for _ in range(4):
        depth = 1 / (full @ theta)
        step = np.linalg.lstsq(full * depth[:, None] ** 2, depth - depth_m, rcond=None)[0]
        theta = theta + step
        if np.abs(step).max() < 1e-12:
            break
    return np.asarray(theta, dtype=np.float64)


def _beside(bad: BoolArray, pixels: FloatArray) -> BoolArray:
    """Pixels next to a patch of outliers: the rim of a hand, or flying pixels, pulls them along."""
    import cv2

    whole = np.rint(pixels).astype(int)
    corner = whole.min(axis=0) - 2
    image = np.zeros(whole.max(axis=0)[::-1] - corner[::-1] + 3, np.uint8)
    at = (whole[:, 1] - corner[1], whole[:, 0] - corner[0])
    image[at] = bad
    patches = cv2.morphologyEx(image, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return np.asarray(cv2.dilate(patches, np.ones((5, 5), np.uint8))[at] > 0)


def _warp(rays: FloatArray, residuals: FloatArray, noise_m: float) -> float:
    """Rms of the surface of second and third order in the residuals, less what noise gives it."""
    x, y = _unit(rays).T
    terms = np.column_stack([x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])
    plane = np.column_stack([np.ones(len(x)), x, y])
    terms -= plane @ np.linalg.lstsq(plane, terms, rcond=None)[0]
    bent = terms @ np.linalg.lstsq(terms, residuals, rcond=None)[0]
    return float(np.sqrt(max(np.mean(bent**2) - terms.shape[1] * noise_m**2 / len(x), 0.0)))


def _tilt_by_warp(jacobian: FloatArray, rays: FloatArray, warp_m: float) -> FloatArray:
    """Covariance of theta if the camera shifts and tilts a plane by as much as it bends it."""
    shapes = np.column_stack([np.ones(len(rays)), _unit(rays)])
    moved = warp_m * np.linalg.lstsq(jacobian, shapes, rcond=None)[0]
    return np.asarray(moved @ moved.T, dtype=np.float64)


def _unit(rays: FloatArray) -> FloatArray:
    """Coordinates with mean 0 and, along their principal axes, rms 1."""
    centred = rays - rays.mean(axis=0)
    _, values, axes = np.linalg.svd(centred, full_matrices=False)
    return np.asarray(centred @ axes.T / np.maximum(values / np.sqrt(len(rays)), 1e-12))


#: Left out along the rim, where pixels are mixed with what lies behind: pixels.
RIM_PX = 3.0
#: Left out about a bright spot, beyond its own radius: its light disturbs the depth there, pixels.
ABOUT_SPOT_PX = 5.0
#: Half the width of the strips along the arms, m, as far as the panel reaches to both sides.
STRIP_M = 0.03


class Regions(NamedTuple):
    """Depth pixels of the panel."""

    pixels: FloatArray  # (N, 2): whole pixels of the plane group
    rays: FloatArray  # (N, 2): theirs, undistorted
    depth_m: FloatArray  # (N,) m: theirs
    panel_P: FloatArray  # (N, 2) m: Where they are on the panel by the first pose
    covered: float  # Share of the panel's usable pixels that have a depth
    cell_m: float  # Two pixels on the panel


def panel_regions(
    depth_m: FloatArray,  # (height, width) m
    lens: Intrinsics,
    blobs: Blobs,
    panel: Panel,
    frame: Frame,
) -> Regions:
    """Choose the panel's depth pixels, away from its rim and from every bright spot."""
    (xmin, ymin), (xmax, ymax) = panel.extent_P
    corners = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]])
    at = lens.pixels(np.clip(frame.origin + corners @ frame.R[:, :2].T, [-9, -9, 0.1], None))
    left, top = np.clip(np.floor(at.min(axis=0)), 0, [lens.width, lens.height]).astype(int)
    right, bottom = np.clip(np.ceil(at.max(axis=0)) + 1, 0, [lens.width, lens.height]).astype(int)
    v, u = (part.ravel() for part in np.mgrid[top:bottom, left:right])
    flat, normal = lens.ray_image()[v, u], frame.R[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = on_plane(normal / (normal @ frame.origin), flat)
    xy = (meets - frame.origin) @ frame.R[:, :2]
    xy[~(meets[:, 2] > 0)] = np.inf
    # metres that a pixel covers on the panel, in its worse direction
    middle = frame.origin + frame.R[:, :2] @ panel.extent_P.mean(axis=0)
    distance = float(np.linalg.norm(middle))
    pixel_m = distance / lens.focal_px / max(abs(normal @ middle) / distance, 0.2)
    low, high = panel.extent_P + RIM_PX * pixel_m * np.array([[1.0], [-1.0]])
    inside, pixels = ((xy > low) & (xy < high)).all(axis=1), np.column_stack([u, v]).astype(np.float64)
    for centre, radius in zip(blobs.pixels, blobs.radii_px, strict=True):
        inside &= np.hypot(*(pixels - centre).T) > radius + ABOUT_SPOT_PX
    depth = depth_m[v, u]
    seen = inside & np.isfinite(depth)
    covered = float(seen.sum() / max(inside.sum(), 1))
    return Regions(pixels[seen], flat[seen], depth[seen], xy[seen], covered, 2 * pixel_m)


def strip(panel_P: FloatArray, panel: Panel, axis: int, cell_m: float) -> BoolArray:
    """Pixels (N,) along an arm of the L, from first to last marker, alike to both sides of its line."""
    arm, across = panel.arms()[axis], 1 - axis
    middle = float(panel.markers_P[0, across])
    margin = min(middle - panel.extent_P[0, across], panel.extent_P[1, across] - middle)
    low, high = float(arm[:, axis].min()), float(arm[:, axis].max())
    if high - low < 0.02:  # no arm in this direction: take the panel's whole length
        low, high = float(panel.extent_P[0, axis]), float(panel.extent_P[1, axis])
    along, away = panel_P[:, axis], panel_P[:, across] - middle
    chosen = (np.abs(away) <= min(STRIP_M, max(margin, 0.01))) & (along >= low) & (along <= high)
    cells = np.floor(np.column_stack([along, away])[chosen] / cell_m).astype(int).tolist()
    held = set(map(tuple, cells))
    chosen[chosen] = [(a, -1 - b) in held for a, b in cells]
    return np.asarray(chosen)
