"""Where the strap is in one image: the dark stretch between elbow and wrist, to depth, to the arm's core.

Jatesiktat & Ang, II-I and II-J. The elbow-wrist line is projected into the image; the darkest place of a
moving average along it is the strap, and the middle between its two edges is its place to a fraction of a
pixel. The ray through it meets the surface that the depth camera saw; that point, projected on the
elbow-wrist line, is the origin of the forearm's frame. Beyond the paper: the arm's silhouette in the depth
image and the forearm's radius give the core a second time, without the noise of the joints, and the two are
put together by their variances.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from smoother.array_types import FloatArray

from ..intrinsics import PlacedCamera
from .strap_camera import Depth
from .strap_surface import across_arm, silhouette_axis, silhouette_middle, surface_at

#: The strap is looked for between these parts of the way from elbow to wrist.
SEARCH = (0.05, 1.03)
#: Samples along the line, and lines side by side over this half width, m.
SAMPLES, LINES, BAND_M = 400, 5, 0.006
#: So many dark places are looked at, the darkest first.
CANDIDATES = 6
#: A strap is this much darker than the arm (a part of its brightness), and so wide, m.
CONTRAST = 0.3
WIDTHS_M = (0.008, 0.07)
#: The paper's criteria: the strap is no farther from the line, m, and nearer to the wrist than to the elbow.
OFF_LINE_M = 0.05
#: A forearm nearer to the camera's ray than this is not looked at, rad.
NEAR_RAY_RAD = np.radians(25.0)
#: Depth is taken over so much of the arm on both sides of the strap, m.
BESIDE_M = 0.03
#: Standard deviations: of the place along the arm beside half a pixel, of the core by silhouette, m.
ALONG_SIGMA_M = 0.002
SILHOUETTE_SIGMA_M = 0.004


@dataclass(frozen=True)
class Sighting:
    """The strap in one image.

    Attributes
    ----------
    reason : str
        Why it was rejected; "" where it was found.
    core : ndarray, shape (3,), m
        Arm's core under the strap (origin of {F}) in {K}; nan where rejected.
    covariance : ndarray, shape (3, 3), m^2
        Of the core in {K}.
    surface : ndarray, shape (3,), m
        Seen point of the strap in {K}.
    pixel : ndarray, shape (2,)
        Of the strap in the image.
    along : float
        Part of the way from elbow to wrist, of the seen point.
    in_profile : float
        Part of the way at which the dark place lies in the profile: the strap's surface, as seen from the
        side, is not over the same place of the line.
    contrast, width_m, off_line_m : float
        How dark, how wide, how far from the elbow-wrist line.
    profile : ndarray, shape (SAMPLES,)
        Brightness along the line.
    """

    reason: str
    core: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    covariance: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))
    surface: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    pixel: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    along: float = float("nan")
    in_profile: float = float("nan")
    contrast: float = float("nan")
    width_m: float = float("nan")
    off_line_m: float = float("nan")
    profile: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def found(self) -> bool:
        """Whether the strap was found and accepted."""
        return not self.reason


def find_strap(
    grey: NDArray[np.uint8],
    camera: PlacedCamera,
    depth: Depth,
    elbow: FloatArray,
    wrist: FloatArray,
    *,
    radius_m: float = 0.035,
    strap_width_m: float = 0.03,
    joint_sigma_m: float = 0.008,
) -> Sighting:
    """Find the strap in a grey image.

    Parameters
    ----------
    grey : ndarray, shape (height, width)
        Brightness.
    camera : PlacedCamera
        That took the image.
    depth : Depth
        Depth image of the same moment.
    elbow, wrist : ndarray, shape (3,), m
        In {K}.
    radius_m : float, m
        Core to the strap's surface (r).
    strap_width_m : float, m
        Along the arm.
    joint_sigma_m : float, m
        Of elbow and wrist, an axis.

    Returns
    -------
    Sighting
    """
    length = float(np.linalg.norm(wrist - elbow))
    if not 0.1 < length < 0.5:
        return Sighting("elbow and wrist are not a forearm apart")
    y = (wrist - elbow) / length
    origin = camera.origin
    ray = 0.5 * (elbow + wrist) - origin
    ray /= np.linalg.norm(ray)
    if abs(y @ ray) > np.cos(NEAR_RAY_RAD):
        return Sighting("the forearm points to the camera")
    joints = elbow, wrist
    axis = silhouette_axis(camera, depth, elbow, wrist, radius_m)
    if axis is not None:
        elbow, wrist = axis
        length = float(np.linalg.norm(wrist - elbow))
        y = (wrist - elbow) / length
    part = np.linspace(*SEARCH, SAMPLES)
    profile = _profile(grey, camera, elbow, wrist, part, np.cross(y, ray))
    if profile is None:
        return Sighting("the forearm is not inside the image")
    at, contrast, width = _dark_stretch(profile, part, strap_width_m / length)
    if not np.isfinite(at):
        return Sighting("no dark stretch with two edges", contrast=contrast, profile=profile)
    if contrast < CONTRAST:
        return Sighting("nothing on the forearm is dark enough", contrast=contrast, profile=profile)
    if not WIDTHS_M[0] < width * length < WIDTHS_M[1]:
        return Sighting(
            "the dark stretch is not as wide as a strap",
            contrast=contrast,
            width_m=width * length,
            profile=profile,
        )
    place = elbow + at * (wrist - elbow)
    pixel, _ = camera.pixels(place[None])
    surface = surface_at(camera, depth, elbow, wrist, at, BESIDE_M)
    if surface is None:
        return Sighting(
            "no depth at the strap",
            pixel=pixel[0],
            along=at,
            in_profile=at,
            contrast=contrast,
            profile=profile,
        )
    along = float((surface - elbow) @ y)
    off, reason = _criteria(surface, *joints)
    core, covariance = _core(
        camera, depth, surface, elbow, wrist, along, radius_m, joint_sigma_m, axis is not None
    )
    return Sighting(
        reason,
        core if not reason else np.full(3, np.nan),
        covariance if not reason else np.full((3, 3), np.nan),
        surface,
        pixel[0],
        along / length,
        in_profile=at,
        contrast=contrast,
        width_m=width * length,
        off_line_m=off,
        profile=profile,
    )


def _profile(
    grey: NDArray[np.uint8],
    camera: PlacedCamera,
    elbow: FloatArray,
    wrist: FloatArray,
    part: FloatArray,
    across: FloatArray,
) -> FloatArray | None:
    """(n,) median brightness over a band along the elbow-wrist line; None where it leaves the image."""
    import cv2

    across = across / np.linalg.norm(across)
    line = elbow + part[:, None] * (wrist - elbow)
    shifts = np.linspace(-BAND_M, BAND_M, LINES)
    pixels, _ = camera.pixels((line[None] + shifts[:, None, None] * across).reshape(-1, 3))
    inside = (pixels >= 0) & (pixels <= [grey.shape[1] - 1, grey.shape[0] - 1])
    if not inside.all():
        return None
    grid = pixels.reshape(LINES, len(part), 2).astype(np.float32)
    values = cv2.remap(grey, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR)
    return np.asarray(np.median(values.astype(float), axis=0))


def _dark_stretch(profile: FloatArray, part: FloatArray, width: float) -> tuple[float, float, float]:
    """Middle, contrast and width (parts of the forearm) of the darkest stretch that has two edges.

    Where the arm ends it gets dark as well, but never bright again: such places are passed over. nan, and
    the contrast of the darkest place, where there is none.
    """
    step = part[1] - part[0]
    mean = uniform_filter1d(profile, max(int(width / step), 3), mode="nearest")
    low = np.flatnonzero((mean <= np.roll(mean, 1)) & (mean <= np.roll(mean, -1)))
    bright, inner = float(np.median(profile)), int(0.4 * width / step)
    profile = np.minimum(profile, bright)  # a reflective marker beside the strap must not shift its edge
    first = 0.0
    for k in low[np.argsort(mean[low], kind="stable")][:CANDIDATES].tolist():
        # the strap's own level, not that of its blurred edges
        dark = float(np.percentile(profile[max(k - inner, 0) : k + inner + 1], 30))
        contrast = (bright - dark) / max(bright, 1.0)
        first = max(first, contrast)
        edges = _edges(profile, part, k, 0.5 * (bright + dark))
        if edges is not None and contrast > 0:
            return 0.5 * (edges[0] + edges[1]), contrast, edges[1] - edges[0]
    return float("nan"), first, float("nan")


def _edges(profile: FloatArray, part: FloatArray, k: int, half: float) -> tuple[float, float] | None:
    """Where the brightness crosses `half` on both sides of place k, between samples; None where it does"
    " not.
    """
    left, right = k, k
    while left > 0 and profile[left] < half:
        left -= 1
    while right < len(profile) - 1 and profile[right] < half:
        right += 1
    if profile[left] < half or profile[right] < half or right - left < 2:
        return None

    def crossing(dim: int, light: int) -> float:
        share = (half - profile[dim]) / (profile[light] - profile[dim])
        return float(part[dim] + share * (part[light] - part[dim]))

    return crossing(left + 1, left), crossing(right - 1, right)


def _criteria(surface: FloatArray, elbow: FloatArray, wrist: FloatArray) -> tuple[float, str]:
    """Distance of the seen strap from the joints' line, and why the paper rejects it ("" where it does"
    " not).
    """
    along = np.clip((surface - elbow) @ (wrist - elbow) / np.sum((wrist - elbow) ** 2), 0.0, 1.0)
    off = float(np.linalg.norm(surface - elbow - along * (wrist - elbow)))
    if off > OFF_LINE_M:
        return off, "the strap is more than 5 cm off the elbow-wrist line"
    if np.linalg.norm(surface - elbow) < np.linalg.norm(surface - wrist):
        return off, "the strap is nearer to the elbow than to the wrist"
    return off, ""


def _core(
    camera: PlacedCamera,
    depth: Depth,
    surface: FloatArray,
    elbow: FloatArray,
    wrist: FloatArray,
    along: float,
    radius_m: float,
    joint_sigma_m: float,
    is_axis: bool,
) -> tuple[FloatArray, FloatArray]:
    """The arm's core under the strap, by the line and by the silhouette there, and its covariance.

    Parameters
    ----------
    is_axis : bool
        The line is the silhouette's own (`silhouette_axis`), not the joints'.
    """
    origin = camera.origin
    length = float(np.linalg.norm(wrist - elbow))
    y, part = (wrist - elbow) / length, along / length
    z = float(np.linalg.norm(surface - origin))
    into, across = across_arm(surface, origin, y)
    own = elbow + along * y
    line_sigma = SILHOUETTE_SIGMA_M if is_axis else joint_sigma_m * float(np.hypot(1 - part, part))
    # a line that is turned moves the foot of a surface point along the arm
    turned = radius_m * (SILHOUETTE_SIGMA_M if is_axis else 1.4 * joint_sigma_m) / length
    along_sigma = float(np.hypot(np.hypot(ALONG_SIGMA_M, turned), 0.5 * z / camera.lens.fx))
    weights = np.full(2, line_sigma**-2)  # across, into
    place = np.array([(own - surface) @ across, (own - surface) @ into])
    middle = silhouette_middle(depth, surface, across, into, radius_m)
    if middle is not None:
        deep = float(np.sqrt(max(radius_m**2 - middle**2, 0.0)))
        sigma = np.full(2, SILHOUETTE_SIGMA_M)
        total = weights + sigma**-2
        place = (weights * place + sigma**-2 * np.array([middle, deep])) / total
        weights = total
    core = surface + place[0] * across + place[1] * into
    covariance = (
        along_sigma**2 * np.outer(y, y)
        + np.outer(across, across) / weights[0]
        + np.outer(into, into) / weights[1]
    )
    return core, covariance
