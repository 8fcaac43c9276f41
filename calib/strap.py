"""Where the strap is in one image: the dark stretch between elbow and wrist, on the forearm's surface.

The sensor on the forearm over time: what turns the arm's core under the strap into the sensor's place.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration, Length
from smoother.errors import CalibrationError
from smoother.linalg import unit
from smoother.result import Recovery
from smoother.rotation import Rotation

from .file import CalibrationFile
from .forearm import USUAL_RADIUS
from .intrinsics import PlacedCamera
from .motion import forearm_frame


@dataclass(frozen=True)
class Depth:
    """A depth image."""

    z_m: NDArray[np.float64]  # (height, width) m: z of every pixel in the lens's own axes
    camera: PlacedCamera  # That took it

    def at(self, points_K: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the image has where points (n, 3) of {K} fall, and the points' own z, m (nan outside)."""
        pixels, z = self.camera.pixels(points_K)
        inside = np.isfinite(pixels).all(axis=1)
        column = np.where(inside, np.rint(np.nan_to_num(pixels[:, 0])), -1).astype(np.int64)
        row = np.where(inside, np.rint(np.nan_to_num(pixels[:, 1])), -1).astype(np.int64)
        inside &= (column >= 0) & (row >= 0) & (column < self.z_m.shape[1]) & (row < self.z_m.shape[0])
        seen = np.full(len(points_K), np.nan)
        seen[inside] = self.z_m[row[inside], column[inside]]
        return seen, z


#: The surface is looked for this far before and behind the line, m.
BEFORE_M, BEHIND_M, STEP_M = 0.16, 0.10, 0.002
#: The arm's axis by silhouette: stations (parts of the forearm), how many must agree, how far it may be from
#: the joints' line.
STATIONS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.9)
FEWEST_STATIONS = 4
LARGEST_TURN_RAD, LARGEST_SHIFT_M = np.radians(12.0), 0.04
#: Depth at a station is taken over this much of the arm on both sides, m.
STATION_M = 0.012
#: The silhouette ends where the depth jumps by this much, and is so wide at most, m.
JUMP_M, REACH_M = 0.04, 0.07


@dataclass(frozen=True)
class _Forearm:
    """A forearm in view: its line from elbow to wrist, what the depth camera saw, and the colour camera."""

    camera: PlacedCamera
    depth: Depth
    elbow: FloatArray  # (3,) m
    wrist: FloatArray  # (3,) m
    radius_m: float

    @property
    def length(self) -> float:
        """Elbow to wrist, m."""
        return float(np.linalg.norm(self.wrist - self.elbow))

    @property
    def y(self) -> FloatArray:
        """Unit vector (3,) from elbow to wrist."""
        return (self.wrist - self.elbow) / self.length

    def directions(self, surface: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit vectors into the arm (away from the camera) and across it, both at right angles to y."""
        into = surface - self.camera.origin
        into = unit(into - (into @ self.y) * self.y)
        return into, np.cross(self.y, into)

    def on_its_core(self) -> _Forearm | None:
        """Elbow and wrist moved onto the arm's core as its silhouette shows it; None where it does not."""
        elbow, wrist, y = self.elbow, self.wrist, self.y
        parts, points = [], []
        for at in STATIONS:
            surface = self.surface(at, STATION_M)
            if surface is None:
                continue
            into, across = self.directions(surface)
            core = self.core_by_silhouette(surface, across)
            if core is not None:
                points.append(surface + core[0] * across + core[1] * into)
                parts.append(float((points[-1] - elbow) @ y) / self.length)
        if len(parts) < FEWEST_STATIONS:
            return None
        s, core_points = np.array(parts), np.array(points)
        kept = np.ones(len(s), dtype=bool)
        for _ in range(2):
            line = np.polynomial.polynomial.polyfit(s[kept], core_points[kept], 1)
            left = np.linalg.norm(core_points - (line[0] + s[:, None] * line[1]), axis=1)
            kept = left < max(2.5 * float(np.median(left)), 0.003)
            if kept.sum() < FEWEST_STATIONS:
                return None
        along = unit(line[1])
        moved = np.linalg.norm(line[0] + 0.5 * line[1] - 0.5 * (elbow + wrist))
        if along @ y < np.cos(LARGEST_TURN_RAD) or moved > LARGEST_SHIFT_M or np.ptp(s[kept]) < 0.35:
            return None
        ends = [line[0] + ((joint - line[0]) @ along) * along for joint in (elbow, wrist)]
        return replace(self, elbow=ends[0], wrist=ends[1])

    def surface(self, at: float, beside_m: float) -> FloatArray | None:
        """Point (3,) of the surface under a place of the line: its ray meets what the depth camera saw."""
        parts = at + np.linspace(-beside_m, beside_m, 13) / self.length
        line = self.elbow + parts[:, None] * (self.wrist - self.elbow)
        pixels, z_line = self.camera.pixels(line)
        if not np.isfinite(pixels).all():
            return None
        origin, directions = self.camera.origin, self.camera.rays(pixels)
        offsets = np.arange(-BEFORE_M, BEHIND_M, STEP_M)
        z = z_line[:, None] + offsets
        points = origin + z[..., None] * directions[:, None, :]
        seen, own = self.depth.at(points.reshape(-1, 3))
        behind = (own - seen).reshape(z.shape)  # negative before the surface, positive behind it
        found = []
        for row in behind:
            change = np.flatnonzero((row[:-1] < 0) & (row[1:] >= 0))
            if len(change):
                k = int(change[0])
                found.append(offsets[k] + STEP_M * row[k] / (row[k] - row[k + 1]))
        if len(found) < 4:
            return None
        centre = len(parts) // 2
        return np.asarray(origin + (z_line[centre] + float(np.median(found))) * directions[centre])

    def core_by_silhouette(self, surface: FloatArray, across: FloatArray) -> FloatArray | None:
        """How far the core is across from and below the surface, (2,) m; None without clear edges."""
        steps = np.arange(-REACH_M, REACH_M + 1e-9, 0.001)
        seen, own = self.depth.at(surface + steps[:, None] * across)
        missing = ~np.isfinite(seen) & (np.abs(steps) < 0.6 * self.radius_m)
        off = np.flatnonzero(~((np.abs(seen - own) < JUMP_M) | missing))
        centre = len(steps) // 2
        before, after = off[off <= centre], off[off >= centre]
        if not len(before) or not len(after) or before[-1] == 0 or after[0] == len(steps) - 1:
            return None
        ends = steps[[before[-1], after[0]]]
        if not 1.2 * self.radius_m < ends[1] - ends[0] < 3.0 * self.radius_m:
            return None
        middle = 0.5 * float(ends[0] + ends[1])
        return np.array([middle, np.sqrt(max(self.radius_m**2 - middle**2, 0.0))])

    def profile(self, grey: NDArray[np.uint8], part: FloatArray, across: FloatArray) -> FloatArray | None:
        """(n,) median brightness over a band along the line; None where it leaves the image."""
        import cv2

        line = self.elbow + part[:, None] * (self.wrist - self.elbow)
        shifts = np.linspace(-BAND_M, BAND_M, LINES)
        pixels, _ = self.camera.pixels((line[None] + shifts[:, None, None] * unit(across)).reshape(-1, 3))
        inside = (pixels >= 0) & (pixels <= [grey.shape[1] - 1, grey.shape[0] - 1])
        if not inside.all():
            return None
        grid = pixels.reshape(LINES, len(part), 2).astype(np.float32)
        values = cv2.remap(grey, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR)
        return np.asarray(np.median(values.astype(float), axis=0))


#: The strap is looked for between these parts of the way from elbow to wrist.
SEARCH = (0.05, 1.03)
#: Samples along the line, and lines side by side over this half width, m.
SAMPLES, LINES, BAND_M = 400, 5, 0.006
#: A strap is this much darker than the arm (a part of its brightness), and so wide, m.
CONTRAST = 0.3
WIDTHS_M = (0.008, 0.07)
#: The paper's criteria: the strap is no farther from the line, m, and nearer to the wrist than to the elbow.
OFF_LINE_M = 0.05
#: A forearm nearer to the camera's ray than this is not looked at, rad.
NEAR_RAY_RAD = np.radians(25.0)
#: Depth is taken over this much of the arm on both sides of the strap, m.
BESIDE_M = 0.03
#: Standard deviations: of the place along the arm beside half a pixel, of the core by silhouette, m.
ALONG_SIGMA_M = 0.002
SILHOUETTE_SIGMA_M = 0.004


@dataclass(frozen=True)
class Sighting:
    """The strap in one image."""

    reason: str  # Why it was rejected; "" where it was found
    # (3,) m: Arm's core under the strap (origin of {F}) in {K}; nan where rejected
    core: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    # (3, 3) m^2: Of the core in {K}
    covariance: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))
    along: float = float("nan")  # Part of the way from elbow to wrist, of the seen point

    @property
    def found(self) -> bool:
        """Whether the strap was found and accepted."""
        return not self.reason


def find_strap(
    grey: NDArray[np.uint8],  # (height, width)
    camera: PlacedCamera,
    depth: Depth,
    elbow: FloatArray,  # (3,) m
    wrist: FloatArray,  # (3,) m
    *,
    radius_m: float = 0.035,
    strap_width_m: float = 0.03,
    joint_sigma_m: float = 0.008,
) -> Sighting:
    """Find the strap in a grey image."""
    joints = _Forearm(camera, depth, elbow, wrist, radius_m)
    if not 0.1 < joints.length < 0.5:
        return Sighting("elbow and wrist are not a forearm apart")
    ray = unit(0.5 * (elbow + wrist) - camera.origin)
    if abs(joints.y @ ray) > np.cos(NEAR_RAY_RAD):
        return Sighting("the forearm points to the camera")
    by_core = joints.on_its_core()
    arm = by_core or joints
    part = np.linspace(*SEARCH, SAMPLES)
    profile = arm.profile(grey, part, np.cross(arm.y, ray))
    if profile is None:
        return Sighting("the forearm is not inside the image")
    at, contrast, width = _dark_stretch(profile, part, strap_width_m / arm.length)
    if not np.isfinite(at):
        return Sighting("no dark stretch with two edges")
    if contrast < CONTRAST:
        return Sighting("nothing on the forearm is dark enough")
    if not WIDTHS_M[0] < width * arm.length < WIDTHS_M[1]:
        return Sighting("the dark stretch is not as wide as a strap")
    surface = arm.surface(at, BESIDE_M)
    if surface is None:
        return Sighting("no depth at the strap", along=at)
    along = float((surface - arm.elbow) @ arm.y)
    # the paper's criteria, by the joints as the camera has them
    foot = np.clip((surface - elbow) @ (wrist - elbow) / np.sum((wrist - elbow) ** 2), 0.0, 1.0)
    if np.linalg.norm(surface - elbow - foot * (wrist - elbow)) > OFF_LINE_M:
        return Sighting("the strap is more than 5 cm off the elbow-wrist line", along=along / arm.length)
    if np.linalg.norm(surface - elbow) < np.linalg.norm(surface - wrist):
        return Sighting("the strap is nearer to the elbow than to the wrist", along=along / arm.length)
    core, covariance = _core(arm, surface, along, joint_sigma_m, by_core is not None)
    return Sighting("", core, covariance, along / arm.length)


def _dark_stretch(profile: FloatArray, part: FloatArray, width: float) -> tuple[float, float, float]:
    """Middle, contrast and width (parts of the forearm) of the darkest stretch that has two edges."""
    step, bright = part[1] - part[0], float(np.median(profile))
    # a reflective marker beside the strap must not shift its edge
    dark = bright - np.minimum(profile, bright)
    peaks, of_peaks = find_peaks(dark, prominence=1e-9, width=0, rel_height=0.5)
    if not len(peaks):
        return float("nan"), 0.0, float("nan")
    height = of_peaks["prominences"]  # that of noise on a dark stretch is small
    mean = uniform_filter1d(dark, max(int(width / step), 3), mode="nearest")[peaks]
    best = int(np.argmax(np.where(height > 0.5 * height.max(), mean, -1.0)))
    left, right = (float(of_peaks[name][best]) for name in ("left_ips", "right_ips"))
    contrast = float(height[best]) / max(bright, 1.0)
    return float(part[0] + 0.5 * (left + right) * step), contrast, (right - left) * float(step)


def _core(
    arm: _Forearm, surface: FloatArray, along: float, joint_sigma_m: float, is_axis: bool
) -> tuple[FloatArray, FloatArray]:
    """The arm's core under the strap, by the line and by the silhouette there, and its covariance."""
    y, part = arm.y, along / arm.length
    z = float(np.linalg.norm(surface - arm.camera.origin))
    into, across = arm.directions(surface)
    own = arm.elbow + along * y
    line_sigma = SILHOUETTE_SIGMA_M if is_axis else joint_sigma_m * float(np.hypot(1 - part, part))
    # a line that is turned moves the foot of a surface point along the arm
    turned = arm.radius_m * (SILHOUETTE_SIGMA_M if is_axis else 1.4 * joint_sigma_m) / arm.length
    along_sigma = float(np.hypot(np.hypot(ALONG_SIGMA_M, turned), 0.5 * z / arm.camera.lens.fx))
    weight = line_sigma**-2
    place = np.array([(own - surface) @ across, (own - surface) @ into])
    by_silhouette = arm.core_by_silhouette(surface, across)
    if by_silhouette is not None:
        total = weight + SILHOUETTE_SIGMA_M**-2
        place = (weight * place + SILHOUETTE_SIGMA_M**-2 * by_silhouette) / total
        weight = total
    core = surface + place[0] * across + place[1] * into
    beside = (np.outer(across, across) + np.outer(into, into)) / weight
    return core, along_sigma**2 * np.outer(y, y) + beside


@dataclass(frozen=True)
class Mounted:
    """The sensor on the forearm over time."""

    t_s: FloatArray  # (N,) s: on the camera's clock, s after `origin_ns`
    R_K_A: FloatArray  # (N, 3, 3): maps a vector from the IMU's axes {A} to the camera's {K}
    origin_ns: int  # Zero of the times
    from_core: FloatArray  # (3,) m: from the forearm's core to the sensor in {A}
    sigma_m: float  # Of that vector, per axis
    along: FloatArray | None  # (3,): unit vector elbow to wrist in {A}, or None
    radius_m: float  # Core to the strap's surface


def held_radius(file: CalibrationFile, side: str) -> Length | None:
    """Core of the forearm to the sensor, r, of the held pose of an arm; None where the file has none."""
    table = file.tables.get("forearm", {})
    own = table.get(side or "any") if isinstance(table, dict) else None
    if not isinstance(own, dict) or not {"r_m", "r_sigma_m"} <= set(own):
        return None
    return Length(float(own["r_m"]), float(own["r_sigma_m"]))


def mounted_on(recovery: Recovery, radius: Length | None = None) -> Mounted:
    """The sensor's orientation over time and its place against the core, from a solved recording."""
    arm: ArmCalibration = recovery.calibration or ArmCalibration()
    frame = forearm_frame(arm)
    if frame is None:
        raise CalibrationError(
            f"{recovery.name}: how the sensor sits on the forearm is not known; elbow and wrist must be"
            " tracked"
        )
    own = radius or USUAL_RADIUS
    weight = own.sigma_m**-2, max(frame.distance_sigma_m, 1e-3) ** -2
    distance = (weight[0] * own.value_m + weight[1] * frame.distance_m) / sum(weight)
    roll = min(frame.roll_sigma_rad, 1.0)
    return Mounted(
        t_s=recovery.t_s - recovery.clock_offset_s,
        R_K_A=Rotation.from_quat(recovery.quaternion, scalar_first=True).as_matrix(),
        origin_ns=recovery.origin_ns,
        from_core=distance * frame.away,
        sigma_m=float(np.hypot(sum(weight) ** -0.5, distance * roll) / np.sqrt(2)),
        along=frame.direction,
        radius_m=float(np.clip(distance, 0.02, 0.06)) if radius is None else radius.value_m,
    )
