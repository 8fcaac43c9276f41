"""A marker panel before a depth camera: images, mocap markers, IMUs and the answer.

What stands before the camera is triangles. Inside a surface a pixel is one ray. Where surfaces meet, and on
markers, a pixel is the mean over a fine grid of rays: an infrared blob is then true to hundredths of a pixel,
and a depth on a rim is a mixture, as a time-of-flight camera sees it (Kolb and Pece, Range Imaging, 2015).
Real images are as a Kinect v2 makes them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator
from scipy.spatial.transform import Rotation

from calib.intrinsics import Intrinsics

from ..array_types import BoolArray, FloatArray
from ..linalg import unit
from ..recording import ImuStream
from ..runtime.packages import load_open3d
from ..units import GRAVITY
from .config import SensorErrors, Settings, setting, size
from .inertial import Held, ideal_imu, measure

Point = tuple[float, float]


def _rising(ends: Point) -> Point:
    if ends[0] > ends[1]:
        raise ValueError("must go from the smaller to the larger value")
    return ends


_Metres = Annotated[float, Field(ge=0.3, le=6)]
_Tilt = Annotated[float, Field(ge=0, le=89)]


class PanelSimulation(Settings):
    """A panel with retroreflective markers before a depth camera like a Kinect v2."""

    poses: int = setting(1, "panel poses", ge=1, le=200)
    markers: tuple[Point, ...] = setting(
        ((0.0, 0.0), (0.2, 0.0), (0.5, 0.0), (0.0, 0.35)),
        "markers on the panel, m in {P}; the origin first",
        min_length=3,
    )
    extent: tuple[Point, Point] = setting(((-0.05, -0.05), (0.55, 0.4)), "corners of the panel, m in {P}")
    marker_shape: Literal["disc", "sphere"] = "disc"
    marker_height_m: float = size(0.0, "centre of a spherical marker above the panel, m", le=0.1)
    marker_diameter_m: float = setting(0.016, "of a marker, m", gt=0.002, le=0.06)

    distance_m: Annotated[tuple[_Metres, _Metres], AfterValidator(_rising)] = setting(
        (1.2, 1.9), "panel's centre to camera, from and to, m"
    )
    tilt_deg: Annotated[tuple[_Tilt, _Tilt], AfterValidator(_rising)] = setting(
        (0.0, 25.0), "panel's normal against the ray to the camera, from and to, degrees"
    )
    roll_deg: Annotated[Point, AfterValidator(_rising)] = setting(
        (0.0, 360.0), "panel's x axis in the image, from and to, degrees"
    )
    hand: bool = setting(True, "a hand holds the panel, a person stands behind it")
    distractors: int = size(0, "bright spots beside the panel in each image", le=10)

    width: int = setting(512, "of the images, pixels", ge=64, le=4096)
    height: int = setting(424, "of the images, pixels", ge=64, le=4096)
    focal_px: float = setting(365.5, "focal length, pixels", gt=50)
    distortion: tuple[float, float, float, float, float] = setting(
        (0.09, -0.27, 0.0006, -0.0004, 0.095), "k1, k2, p1, p2, k3"
    )
    blur_px: float = size(0.5, "sigma of the lens' blur, pixels", le=3)
    marker_gain: float = setting(
        2.5, "a marker's brightness at 1.5 m, in full scales of the infrared image", gt=0
    )
    infrared_noise: float = size(0.02, "sigma, a fraction of the value")
    depth_noise_m: float = size(0.0015, "sigma of a depth at 1.5 m, m; grows with distance and angle")
    depth_offset_m: float = setting(0.0, "added to every depth, m")
    halo_m: float = size(0.01, "depth error beside a marker, m; fades within some pixels")
    flying: float = size(0.3, "fraction of the pixels on rims that show a depth in between", le=1)
    quantised: bool = setting(True, "round depths to whole millimetres")
    mocap_noise_m: float = size(0.0002, "sigma of a mocap marker, m per axis")

    hold_s: float = setting(2.0, "how long each pose is held, s", ge=1, le=60)
    move_s: float = setting(2.5, "from one pose to the next, s", ge=1, le=60)
    sway_deg: float = size(0.05, "rms of the hand's sway in a hold, degrees")
    camera_tilt_deg: float = size(
        0.0, "the camera and its base IMU are tilted anew for each pose, up to", le=60
    )
    imu_mounting_deg: float = size(3.0, "the panel's IMU sits off the panel's axes, degrees", le=180)
    imu_rate_hz: float = setting(100.0, "IMU samples per second", ge=20, le=1000)
    accelerometer_noise: float = size(0.002, "density, m/s^2/sqrt(Hz)")
    gyroscope_noise: float = size(0.0002, "density, rad/s/sqrt(Hz)")
    accelerometer_bias: float = size(0.02, "sigma of the bias, m/s^2 per axis")
    gyroscope_bias: float = size(0.005, "sigma of the bias, rad/s per axis")
    imu_scale: float = size(0.001, "sigma of each axis' scale error")
    magnetometer: bool = setting(False, "both IMUs have a magnetometer")
    magnetometer_noise: float = size(0.4, "sigma of a sample, uT per axis")
    magnetometer_bias: float = size(0.5, "sigma of what iron adds, uT per axis")

    @classmethod
    def ideal(cls, **changes: Any) -> Self:
        """No error at all and no person in the picture: for tests of the geometry."""
        ends = ("_noise", "_noise_m", "_bias", "halo_m", "flying", "sway_deg", "imu_scale")
        none = {name: 0.0 for name in cls.model_fields if name.endswith(ends)}
        return cls(**{**none, "hand": False, **changes})

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        (x0, y0), (x1, y1) = self.extent
        if x0 >= x1 or y0 >= y1:
            raise ValueError("extent must go from the lower to the upper corner")
        if not all(x0 <= x <= x1 and y0 <= y <= y1 for x, y in self.markers):
            raise ValueError("a marker lies outside the panel's extent")
        return self

    @property
    def corners(self) -> FloatArray:
        """Corners of the panel, (4, 3) m in {P}, around its rim."""
        (x0, y0), (x1, y1) = self.extent
        return np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]])


#: The whole panel is at least this far inside the image, pixels.
MARGIN_PX = 6.0
#: Height of the floor, the camera at 0, m.
FLOOR_M = -1.1
#: Tries before a range of poses is given up.
_TRIES = 2000


def place_panel(
    config: PanelSimulation, lens: Intrinsics, R_W_K: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:  # R_K_P (3, 3), p_K_P (3,) m
    """A pose of the panel above the floor in which the camera sees all of it."""
    corners, rays = config.corners, lens.ray_image()
    middle, last = corners.mean(axis=0), np.array([lens.width, lens.height]) - 1 - MARGIN_PX
    for _ in range(_TRIES):
        distance, tilt, roll = (
            rng.uniform(*r) for r in (config.distance_m, config.tilt_deg, config.roll_deg)
        )
        row, column = rng.integers(lens.height), rng.integers(lens.width)
        ray = unit(np.append(rays[row, column], 1.0))
        R_K_P = facing(ray, np.radians(tilt), rng.uniform(0, 2 * np.pi), np.radians(roll))
        p_K_P = distance * ray - R_K_P @ middle
        seen = corners @ R_K_P.T + p_K_P
        if seen[:, 2].min() > 0.2 and (seen @ R_W_K[2]).min() > FLOOR_M + 0.05:
            pixel = lens.pixels(seen)
            if (pixel > MARGIN_PX).all() and (pixel < last).all():
                return R_K_P, p_K_P
    raise ValueError(
        "the panel does not fit into the image at these distances and tilts; hold it farther away, or take a "
        "smaller panel or a shorter focal length"
    )


def facing(ray: FloatArray, tilt: float, towards: float, roll: float) -> FloatArray:
    """R_K_P of a panel on a ray (unit vector) whose z axis is `tilt` off the way back to the camera."""
    right = unit(np.cross(ray, [0.0, -1.0, 0.0]))
    down = np.cross(ray, right)
    facing_back = np.column_stack([right, -down, -ray])  # z to the camera, x right, y up in the image
    axis = np.array([np.cos(towards), np.sin(towards), 0.0])
    tilted = Rotation.from_matrix(facing_back) * Rotation.from_rotvec(tilt * axis)
    return np.asarray((tilted * Rotation.from_euler("z", roll)).as_matrix())


def place_camera(rng: np.random.Generator) -> FloatArray:
    """R_W_K (3, 3) of a camera on a tripod: any heading, some degrees off level. {W}: z up."""
    level = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # optical axes: z forward is y of {W}
    heading = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
    off = Rotation.from_rotvec(np.radians([rng.uniform(-12, 3), 0, 0]))  # about K's x: looks down
    lean = Rotation.from_rotvec(np.radians([0, 0, rng.normal(0, 1.5)]))
    return np.asarray((heading * Rotation.from_matrix(level) * off * lean).as_matrix())


def tilt_camera(R_W_K: FloatArray, most_deg: float, rng: np.random.Generator) -> FloatArray:
    """R_W_K after a turn of the tripod's head: by up to `most_deg` about each of the camera's axes."""
    turn = Rotation.from_rotvec(np.radians(rng.uniform(-most_deg, most_deg, 3)))
    return np.asarray(R_W_K @ turn.as_matrix())


def place_base(rng: np.random.Generator) -> FloatArray:
    """R_K_B (3, 3) of an IMU on top of the camera: any side up, some degrees off."""
    side = Rotation.create_group("O")[int(rng.integers(24))]
    off = Rotation.from_rotvec(np.radians(rng.normal(0, 3, 3)))
    return np.asarray((off * side).as_matrix())


def place_imu(off_deg: float, rng: np.random.Generator) -> FloatArray:
    """R_P_I (3, 3) of an IMU that was lined up with the panel by eye: off by `off_deg` about some axis."""
    axis = unit(rng.normal(size=3))
    return np.asarray(Rotation.from_rotvec(np.radians(off_deg) * axis).as_matrix())


#: Diffuse reflectance by what a surface is of.
_ALBEDO = {"board": 0.55, "marker": 0.0, "hand": 0.7, "clothes": 0.35, "wall": 0.5, "floor": 0.3}
_BOARD_M = 0.006  # thickness
_WALL_M = 3.2
#: A hand keeps this far from every marker, m.
_HAND_FROM_MARKER_M = 0.09
#: A white surface at 1.5 m shows this fraction of the infrared image's full scale.
_DIFFUSE = 0.1
_REFERENCE_M = 1.5


class Hits(NamedTuple):
    """What rays met."""

    z: FloatArray  # (N,) m: depth along the optical axis; inf where there is nothing
    surface: NDArray[np.int64]  # (N,): number of the mesh; -1 where there is nothing
    cosine: FloatArray  # (N,): between the surface's normal and the ray
    marker: BoolArray  # (N,): True on a retroreflector
    infrared: FloatArray  # (N,) full scales; the lamp sits at the camera


class PanelScene:
    """A panel in a room, with who holds it, to cast rays at from the camera's centre."""

    def __init__(
        self,
        config: PanelSimulation,
        R_K_P: FloatArray,
        p_K_P: FloatArray,
        R_K_W: FloatArray,
        rng: np.random.Generator,
    ) -> None:
        self.config, self.R_K_P, self.p_K_P = config, R_K_P, p_K_P
        self.spots = np.array(config.markers)
        self._caster, self._kinds = load_open3d().t.geometry.RaycastingScene(), list[str]()
        (x0, y0), (x1, y1) = config.extent
        box = load_open3d().geometry.TriangleMesh.create_box(x1 - x0, y1 - y0, _BOARD_M)
        self.add("board", box.translate([x0, y0, -_BOARD_M]), on_panel=True)
        for marker in config.markers if config.marker_shape == "sphere" else ():
            centre = np.append(marker, config.marker_height_m)
            self.add("marker", _sphere(config.marker_diameter_m / 2, centre, 40), on_panel=True)
        self.add("floor", _plane(R_K_W @ [0, 0, 1.0], R_K_W @ [0, 0, FLOOR_M]))
        towards = R_K_W.T @ [0, 0, 1.0]
        wall = R_K_W @ np.array([towards[0], towards[1], 0.0])
        self.add("wall", _plane(-unit(wall), np.array([0, 0, _WALL_M])))
        if config.hand:
            self._add_person(R_K_W, rng)

    def add(self, kind: str, mesh: Any, on_panel: bool = False) -> None:
        """Add a mesh in {K}, or in {P}; `kind` is a key of the table of reflectances."""
        if on_panel:
            T_K_P = np.eye(4)
            T_K_P[:3, :3], T_K_P[:3, 3] = self.R_K_P, self.p_K_P
            mesh = mesh.transform(T_K_P)
        vertices = np.asarray(mesh.vertices, np.float32)
        self._caster.add_triangles(vertices, np.asarray(mesh.triangles, np.uint32))
        self._kinds.append(kind)

    def corners(self) -> FloatArray:
        """Corners of the panel, (4, 3) m in {K}."""
        return np.asarray(self.config.corners @ self.R_K_P.T + self.p_K_P)

    def cast(self, rays: FloatArray) -> Hits:
        """Cast rays (N, 2), x and y where z is 1, and return what they meet."""
        directions = np.ones((len(rays), 6), np.float32)
        directions[:, :3] = 0.0
        directions[:, 3:5] = rays
        answer = self._caster.cast_rays(load_open3d().core.Tensor(directions))
        z = answer["t_hit"].numpy().astype(float)
        surface = answer["geometry_ids"].numpy().astype(np.int64)
        surface[~np.isfinite(z)] = -1
        normal = answer["primitive_normals"].numpy().astype(float)
        along = directions[:, 3:].astype(float)
        cosine = np.abs((normal * along).sum(axis=1)) / np.linalg.norm(along, axis=1)
        albedo = np.array([*(_ALBEDO[kind] for kind in self._kinds), 0.0])[surface]
        marker = np.array([*(kind == "marker" for kind in self._kinds), False])[surface]
        board = surface == self._kinds.index("board")
        marker[board] |= self._on_a_disc(rays[board], z[board])
        secant2 = 1 + (rays**2).sum(axis=1)
        fading = (_REFERENCE_M / np.where(np.isfinite(z), z, np.inf)) ** 2 / secant2
        vignette, diffuse = 1 / secant2, _DIFFUSE * albedo * cosine
        infrared = fading * vignette * np.where(marker, self.config.marker_gain, diffuse)
        return Hits(z, surface, cosine, marker, infrared)

    def _on_a_disc(self, rays: FloatArray, z: FloatArray) -> BoolArray:
        """Which hits on the board are on a flat marker: exact circles, not triangles."""
        discs = self.config.markers if self.config.marker_shape == "disc" else ()
        on_board = (np.column_stack([rays * z[:, None], z]) - self.p_K_P) @ self.R_K_P
        on_a_disc = np.zeros(len(z), bool)
        for spot in discs:
            away = on_board[:, :2] - spot
            on_a_disc |= (away**2).sum(axis=1) <= (self.config.marker_diameter_m / 2) ** 2
        return on_a_disc & (np.abs(on_board[:, 2]) < 1e-4)

    def _add_person(self, R_K_W: FloatArray, rng: np.random.Generator) -> None:
        """A hand on the rim, away from the markers; its arm, and a body behind the panel."""
        rim, inward = self._grip(rng)
        side = np.cross([0, 0, 1.0], inward)
        for step in (-1.5, -0.5, 0.5, 1.5):
            base = rim + 0.018 * step * side + [0, 0, 0.009]
            self.add("hand", _rod(base - 0.03 * inward, base + 0.045 * inward, 0.008), on_panel=True)
        palm = rim - 0.045 * inward - [0, 0, 0.01]
        self.add("hand", _sphere(0.04, palm, 16), on_panel=True)
        self.add("clothes", _rod(palm, palm - 0.25 * inward - [0, 0, 0.15], 0.035), on_panel=True)
        # The body stands upright behind the panel.
        corners = self.corners()
        middle, up = corners.mean(axis=0), R_K_W @ [0, 0, 1.0]
        back = unit(middle - up * (up @ middle))
        chest = middle + back * (((corners - middle) @ back).max() + 0.17 + rng.uniform(0.08, 0.25))
        self.add("clothes", _rod(chest - 0.9 * up, chest + 0.25 * up, 0.17))
        self.add("hand", _sphere(0.11, chest + 0.42 * up, 20))

    def _grip(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """A point on the rim far enough from the markers, and the way inwards; both (3,) in {P}."""
        corners, best, farthest = self.config.corners, None, -1.0
        for _ in range(50):
            i = rng.integers(4)
            edge = corners[(i + 1) % 4] - corners[i]
            rim = corners[i] + rng.uniform(0.15, 0.85) * edge
            inward = np.cross([0, 0, 1.0], unit(edge))
            away = np.linalg.norm(self.spots - (rim + 0.02 * inward)[:2], axis=1).min()
            if best is None or away > farthest:
                best, farthest = (rim, inward), away
            if away > _HAND_FROM_MARKER_M:
                break
        assert best is not None
        return best

    def distract(self, lens: Intrinsics, count: int, rng: np.random.Generator) -> None:
        """Put bright balls beside the panel, wherever there is room in the image."""
        import cv2

        outline = lens.pixels(self.corners()).astype(np.float32)
        rays = lens.ray_image()
        placed = 0
        for _ in range(1000 * bool(count)):
            row, column = rng.integers(10, lens.height - 10), rng.integers(10, lens.width - 10)
            if cv2.pointPolygonTest(outline, (float(column), float(row)), True) > -_DISTRACTOR_FROM_PANEL_PX:
                continue
            z = float(self.cast(rays[row, column][None]).z[0])
            if np.isfinite(z):
                # as large and as bright as a marker
                z = rng.uniform(1.0, min(z - 0.05, 2.0))
                self.add("marker", _sphere(0.006 * max(z, 1.2), np.append(rays[row, column], 1.0) * z, 12))
                placed += 1
            if placed == count:
                return


#: A distractor stays at least this far from the panel's outline, pixels.
_DISTRACTOR_FROM_PANEL_PX = 15.0


def _sphere(radius: float, centre: FloatArray, resolution: int) -> Any:
    return load_open3d().geometry.TriangleMesh.create_sphere(radius, resolution).translate(centre)


def _across(z: FloatArray) -> FloatArray:
    return unit(np.cross(z, [1.0, 0, 0] if abs(z[0]) < 0.7 else [0, 1.0, 0]))


def _rod(start: FloatArray, stop: FloatArray, radius: float) -> Any:
    """A cylinder with round ends."""
    along = stop - start
    length = float(np.linalg.norm(along))
    z = along / length
    T, x = np.eye(4), _across(z)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), (start + stop) / 2
    cylinder = load_open3d().geometry.TriangleMesh.create_cylinder(radius, length, resolution=24, split=1)
    return cylinder.transform(T) + _sphere(radius, start, 10) + _sphere(radius, stop, 10)


def _plane(normal: FloatArray, through: FloatArray, size: float = 30.0) -> Any:
    """Two triangles, wide enough to fill every image."""
    o3d = load_open3d()
    x = _across(normal)
    y = np.cross(normal, x)
    corners = np.array([through + size * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(corners), o3d.utility.Vector3iVector([[0, 1, 2], [0, 2, 3]])
    )


#: Rays per axis in a pixel where surfaces meet.
FINE = 10


class IdealImages(NamedTuple):
    """What a perfect sensor would measure; all of shape (height, width)."""

    z: FloatArray  # m: depth; inf where nothing reflects
    spread: FloatArray  # m: standard deviation of the depths that meet in a pixel
    infrared: FloatArray  # In full scales of the sensor; beyond 1 where it saturates
    cosine: FloatArray  # Between normal and ray
    marker: FloatArray  # Share of the pixel that a marker fills


def render(scene: PanelScene, lens: Intrinsics) -> IdealImages:
    """Cast a ray through every pixel, and many through those where surfaces meet."""
    rays = lens.ray_image()
    hits = scene.cast(rays.reshape(-1, 2))
    z, infrared = hits.z.copy(), hits.infrared
    spread, marker = np.zeros(len(z)), hits.marker.astype(float)
    mixed = np.flatnonzero(_mixed(scene, lens, hits))
    fine = scene.cast(_fine_rays(rays, mixed).reshape(-1, 2))
    bright = fine.infrared.reshape(len(mixed), -1)
    infrared[mixed] = bright.mean(axis=1)
    marker[mixed] = fine.marker.reshape(len(mixed), -1).mean(axis=1)
    # What is brighter counts for more in the mixture; a marker's own glare is held down by the sensor.
    weight = np.minimum(bright, 1.0) + 1e-9
    depth = np.minimum(fine.z, 50.0).reshape(len(mixed), -1)
    mean = (weight * depth).sum(axis=1) / weight.sum(axis=1)
    z[mixed] = np.where(mean < 49, mean, np.inf)
    spread[mixed] = np.sqrt((weight * (depth - mean[:, None]) ** 2).sum(axis=1) / weight.sum(axis=1))
    parts = (z, spread, infrared, hits.cosine, marker)
    return IdealImages(*(part.reshape(lens.height, lens.width) for part in parts))


def _mixed(scene: PanelScene, lens: Intrinsics, hits: Hits) -> BoolArray:
    """Pixels (N,) that may hold more than one surface, or an edge of a marker."""
    import cv2

    shape = (lens.height, lens.width)
    kinds = hits.surface.reshape(shape).astype(np.float32) + 1
    around = np.ones((3, 3), np.uint8)
    edges = cv2.dilate(kinds, around) != cv2.erode(kinds, around)
    centres = np.column_stack([scene.spots, np.zeros(len(scene.spots))]) @ scene.R_K_P.T + scene.p_K_P
    near = hits.marker.reshape(shape).astype(np.uint8)
    for (u, v), z in zip(lens.pixels(centres), centres[:, 2], strict=True):
        reach = int(np.ceil(0.6 * scene.config.marker_diameter_m * max(lens.fx, lens.fy) / z)) + 2
        row, column = round(v), round(u)
        near[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1] = 1
    return np.asarray((edges | (cv2.dilate(near, around) > 0)).ravel())


def _fine_rays(rays: FloatArray, pixels: np.ndarray) -> FloatArray:
    """Rays (n, FINE^2, 2) on a grid in each pixel, by the first derivatives of the lens' rays."""
    row, column = np.divmod(pixels, rays.shape[1])
    by_row, by_column = np.gradient(rays, axis=0), np.gradient(rays, axis=1)
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    v, u = (grid.ravel()[None, :, None] for grid in np.meshgrid(offset, offset, indexing="ij"))
    centre = rays[row, column][:, None, :]
    return np.asarray(centre + v * by_row[row, column][:, None, :] + u * by_column[row, column][:, None, :])


FULL_SCALE = 65535
#: Depths are had from here to there, m.
RANGE_M = (0.4, 4.5)
#: Depths farther apart than this in one pixel make it a rim, m.
_RIM_M = 0.008
_FADES_PX = 1.5  # of the depth error beside a marker
_DARK = 0.0008  # noise of a dark pixel, full scales


def photograph(
    ideal: IdealImages, config: PanelSimulation, rng: np.random.Generator
) -> tuple[NDArray[np.uint16] | FloatArray, NDArray[np.uint16]]:
    """Depth, mm, 0 where there is none (float where it is not quantised), and infrared, clipped."""
    import cv2

    blurred = ideal.infrared
    if config.blur_px > 0:
        blurred = np.asarray(cv2.GaussianBlur(blurred, (0, 0), config.blur_px))
    noise, light = rng.normal(size=blurred.shape), blurred
    if config.infrared_noise > 0:
        light = light + noise * (config.infrared_noise * np.minimum(light, 1.0) + _DARK)
    infrared = np.rint(np.clip(light, 0, 1) * FULL_SCALE).astype(np.uint16)

    noise, luck = rng.normal(size=ideal.z.shape), rng.random(ideal.z.shape)
    seen = np.isfinite(ideal.z)
    z = np.where(seen, ideal.z, 0.0)
    sigma = config.depth_noise_m * (z / _REFERENCE_M) ** 2 / np.maximum(ideal.cosine, 0.15)
    valid = seen & ~((ideal.spread > _RIM_M) & (luck > config.flying))
    # pixels without depth, and how near (1 to 0) the others are to a marker
    no_depth = (blurred >= 1.0) | (ideal.marker > 0.02)
    away = cv2.distanceTransform((~no_depth).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    beside = np.where(no_depth, 0.0, np.exp(-(away - 1.0) / _FADES_PX))
    if config.halo_m > 0:
        z = z + config.halo_m * beside
        no_depth |= (beside > 0.6) & (luck < 0.5)
    z = z + sigma * noise + config.depth_offset_m
    valid &= ~no_depth & (z > RANGE_M[0]) & (z < RANGE_M[1])
    depth = np.where(valid, z * 1000, 0.0)
    return np.rint(depth).astype(np.uint16) if config.quantised else depth, infrared


#: The earth's field in {W}, uT: 60 degrees below the horizon, x to the north.
FIELD_W = np.array([24.0, 0.0, -41.6])


def imu_stream(
    name: str, body: Held, R_body_imu: FloatArray, config: PanelSimulation, rng: np.random.Generator
) -> ImuStream:
    """Samples of an IMU on a body, in the IMU's axes, over the whole session."""
    on_body = replace(body, R_W=body.R_W @ R_body_imu)
    ideal = ideal_imu(on_body.imu_pose, body.duration_s, config.imu_rate_hz, np.array([0, 0, -GRAVITY]))
    shared = SensorErrors.model_fields.keys() & PanelSimulation.model_fields.keys()
    errors = SensorErrors.preset("clean", **{name: getattr(config, name) for name in shared})
    stream, _ = measure(ideal, errors, rng)
    mag = None
    if config.magnetometer:
        R, _ = on_body.imu_pose(ideal.t_s)
        mag = np.einsum("nji,j->ni", R, FIELD_W) + config.magnetometer_bias * rng.normal(size=3)
        mag = mag + config.magnetometer_noise * rng.normal(size=mag.shape)
    return ImuStream(name, stream.t_s, stream.acc, stream.gyro, mag)


@dataclass(frozen=True)
class PanelPose:
    """What camera and mocap see of the panel in one pose, and where it truly is."""

    t_s: float  # Time of the images, in the middle of the hold; the clock is the IMUs'
    # (height, width) mm: Along the optical axis, 0 = none (float where not quantised)
    depth: NDArray[np.uint16] | FloatArray
    infrared: NDArray[np.uint16]  # (height, width)
    marker_names: tuple[str, ...]  # Of the mocap markers, in the order they come in
    markers: FloatArray  # (n, 3) m: in {E}, with the mocap's noise, shuffled
    marker_order: NDArray[np.int64]  # (n,): which marker of the panel's definition each of them is
    R_K_P: FloatArray  # (3, 3): the panel in the camera
    p_K_P: FloatArray  # (3,) m
    marker_pixels: FloatArray  # (n, 2): exact pixels of the markers' centres, in the definition's order
    R_W_K: FloatArray  # (3, 3): the camera in the world, z up


@dataclass(frozen=True)
class SimulatedPanel:
    """Poses of one panel before one camera, and the answer."""

    config: PanelSimulation
    seed: int
    lens: Intrinsics
    poses: tuple[PanelPose, ...]
    imu_panel: ImuStream  # The IMU on the panel and the one on the camera, over the whole session
    imu_base: ImuStream
    R_K_E: FloatArray  # (3, 3): the answer of `calibrate panel`, camera from mocap
    t_K_E: FloatArray  # (3,) m
    R_K_B: FloatArray  # (3, 3): the answer of `calibrate world`: camera from base IMU, panel from its IMU
    R_P_I: FloatArray


def simulate_panel(config: PanelSimulation, seed: int = 0) -> SimulatedPanel:
    """Hold a panel before a depth camera, in as many poses as the settings say."""
    streams = np.random.SeedSequence(seed).spawn(config.poses + 2)
    rng = np.random.default_rng(streams[0])
    lens = Intrinsics(
        config.width,
        config.height,
        fx=config.focal_px,
        fy=config.focal_px * 1.0008,
        cx=config.width / 2 + 2.3,  # some pixels off the middle
        cy=config.height / 2 - 4.1,
        distortion=config.distortion,
    )
    R_W_K = place_camera(rng)
    # the mocap's origin on the floor, z up to a degree, any heading
    R_W_E = Rotation.from_rotvec(np.radians([rng.normal(0, 0.5), rng.normal(0, 0.5), 0]))
    R_W_E = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)) * R_W_E
    origin_W = R_W_K @ np.array([rng.uniform(-1, 1), 0, rng.uniform(1, 3)])
    origin_W[2] = FLOOR_M
    R_K_E, t_K_E = R_W_K.T @ R_W_E.as_matrix(), R_W_K.T @ origin_W
    mocap_W, poses = (R_W_K @ R_K_E, R_W_K @ t_K_E), []
    for number, stream in enumerate(streams[1:-1]):
        own = np.random.default_rng(stream)
        tilted = tilt_camera(R_W_K, config.camera_tilt_deg, own) if number else R_W_K
        poses.append(_pose(config, lens, number, tilted, mocap_W, own))
    rng = np.random.default_rng(streams[-1])
    R_K_B, R_P_I = place_base(rng), place_imu(config.imu_mounting_deg, rng)

    # the panel, a point near its middle, and the camera from pose to pose
    cameras, R_K_P = (np.array([getattr(pose, name) for pose in poses]) for name in ("R_W_K", "R_K_P"))
    middle = config.corners.mean(axis=0) + np.array([0.05, 0.03, -0.01])
    p_K = np.array([pose.R_K_P @ middle + pose.p_K_P for pose in poses])
    p_W, times = np.einsum("nij,nj->ni", cameras, p_K), (config.hold_s, config.move_s)
    panel = Held(cameras @ R_K_P, p_W, *times, config.sway_deg, seed)
    imu_panel = imu_stream("panel", panel, R_P_I, config, rng)
    imu_base = imu_stream("base", Held(cameras, np.zeros((len(poses), 3)), *times), R_K_B, config, rng)
    return SimulatedPanel(config, seed, lens, tuple(poses), imu_panel, imu_base, R_K_E, t_K_E, R_K_B, R_P_I)


def _pose(
    config: PanelSimulation,
    lens: Intrinsics,
    number: int,
    R_W_K: FloatArray,
    mocap_W: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
) -> PanelPose:
    R_K_P, p_K_P = place_panel(config, lens, R_W_K, rng)
    scene = PanelScene(config, R_K_P, p_K_P, R_W_K.T, rng)
    scene.distract(lens, config.distractors, rng)
    depth, infrared = photograph(render(scene, lens), config, rng)
    height = config.marker_height_m if config.marker_shape == "sphere" else 0.0
    true_K = np.column_stack([config.markers, np.full(len(config.markers), height)]) @ R_K_P.T + p_K_P
    order = rng.permutation(len(true_K))
    noise = config.mocap_noise_m * rng.normal(size=true_K.shape)
    R_W_E, t_W_E = mocap_W
    markers = ((true_K @ R_W_K.T - t_W_E) @ R_W_E + noise)[order]
    names = tuple(f"M{number:02d}" for number in rng.permutation(np.arange(1, 1 + len(true_K))))
    t_s = (number + 0.5) * config.hold_s + number * config.move_s
    pixels = lens.pixels(true_K)
    return PanelPose(t_s, depth, infrared, names, markers, order, R_K_P, p_K_P, pixels, R_W_K)
