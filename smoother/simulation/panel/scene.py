"""What stands before the camera, as triangles, and its images in depth and infrared: without error, and real.

Inside a surface a pixel is one ray. Where surfaces meet, and on markers, a pixel is the mean over a fine
grid of rays: an infrared blob is then true to hundredths of a pixel, and a depth on a rim is a mixture, as
a time-of-flight camera sees it (Kolb and Pece, Range Imaging, 2015). Real ones are as a Kinect v2 makes them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray
from ...linalg import unit
from ...runtime.packages import load_open3d
from .config import PanelSimulation
from .placing import FLOOR_M, RenderLens, panel_corners

_ALBEDO = {"board": 0.55, "marker": 0.0, "hand": 0.7, "clothes": 0.35, "wall": 0.5, "floor": 0.3}
_BOARD_M = 0.006  # thickness
_WALL_M = 3.2
#: A hand keeps this far from every marker, m.
_HAND_FROM_MARKER_M = 0.09


@dataclass(frozen=True)
class Hits:
    """What rays met."""

    z: FloatArray  # (N,) m: depth along the optical axis; inf where there is nothing
    surface: NDArray[np.int64]  # (N,): number of the mesh; -1 where there is nothing
    cosine: FloatArray  # (N,): between the surface's normal and the ray
    albedo: FloatArray  # (N,): diffuse reflectance
    marker: BoolArray  # (N,): True on a retroreflector


@dataclass
class PanelScene:
    """A panel in a room, to cast rays at from the camera's centre."""

    config: PanelSimulation
    R_K_P: FloatArray
    p_K_P: FloatArray
    _caster: Any = None
    _kinds: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._caster = load_open3d().t.geometry.RaycastingScene()

    def add(self, kind: str, mesh: Any) -> None:
        """Add a mesh in {K}; `kind` is a key of the table of reflectances."""
        vertices = np.asarray(mesh.vertices, np.float32)
        self._caster.add_triangles(vertices, np.asarray(mesh.triangles, np.uint32))
        self._kinds.append(kind)

    def cast(self, rays: FloatArray) -> Hits:
        """Cast rays (N, 2), x and y where z is 1, and return what they meet."""
        directions = np.ones((len(rays), 6), np.float32)
        directions[:, :3] = 0.0
        directions[:, 3:5] = rays
        answer = self._caster.cast_rays(load_open3d().core.Tensor(directions))
        z = answer["t_hit"].numpy().astype(float)
        surface = answer["geometry_ids"].numpy().astype(np.int64)
        nothing = ~np.isfinite(z)
        surface[nothing] = -1
        normal = answer["primitive_normals"].numpy().astype(float)
        along = directions[:, 3:].astype(float)
        cosine = np.abs((normal * along).sum(axis=1)) / np.linalg.norm(along, axis=1)
        albedo = np.array([*(_ALBEDO[kind] for kind in self._kinds), 0.0])[surface]
        marker = np.array([*(kind == "marker" for kind in self._kinds), False])[surface]
        board = surface == self._kinds.index("board")
        marker[board] |= self._on_a_disc(rays[board], z[board])
        return Hits(z, surface, cosine, albedo, marker)

    def _on_a_disc(self, rays: FloatArray, z: FloatArray) -> BoolArray:
        """Which hits on the board are on a flat marker: exact circles, not triangles."""
        discs = _shown(self.config) if self.config.marker_shape == "disc" else []
        spots = [*(self.config.markers[i] for i in discs), *self.config.extra_markers]
        on_board = (np.column_stack([rays * z[:, None], z]) - self.p_K_P) @ self.R_K_P
        on_a_disc = np.zeros(len(z), bool)
        for spot in spots:
            away = on_board[:, :2] - spot
            on_a_disc |= (away**2).sum(axis=1) <= (self.config.marker_diameter_m / 2) ** 2
        return on_a_disc & (np.abs(on_board[:, 2]) < 1e-4)


def build_scene(
    config: PanelSimulation,
    R_K_P: FloatArray,
    p_K_P: FloatArray,
    R_K_W: FloatArray,
    rng: np.random.Generator,
) -> PanelScene:
    """The panel, who holds it, and the room; without distractors."""
    scene = PanelScene(config, R_K_P, p_K_P)
    scene.add("board", _in_camera(scene, _board(config)))
    if config.marker_shape == "sphere":
        for index in _shown(config):
            ball = _sphere(
                config.marker_diameter_m / 2, np.append(config.markers[index], config.marker_height_m), 40
            )
            scene.add("marker", _in_camera(scene, ball))
    scene.add("floor", _plane(R_K_W @ [0, 0, 1.0], R_K_W @ [0, 0, FLOOR_M]))
    towards = R_K_W.T @ [0, 0, 1.0]
    wall = R_K_W @ np.array([towards[0], towards[1], 0.0])
    scene.add("wall", _plane(-unit(wall), np.array([0, 0, _WALL_M])))
    if config.hand:
        _add_person(scene, R_K_W, rng)
    return scene


def add_distractor(scene: PanelScene, ray: FloatArray, z: float) -> None:
    """A small retroreflective ball on a ray (2,) at depth z, m; it looks as large and bright as a marker."""
    scene.add("marker", _sphere(0.006 * max(z, 1.2), np.append(ray, 1.0) * z, 12))


def _shown(config: PanelSimulation) -> list[int]:
    return [i for i in range(len(config.markers)) if i not in config.hidden_markers]


def _board(config: PanelSimulation) -> Any:
    """A flat box whose front face is the plane z = 0 of {P}."""
    x0, y0, _ = panel_corners(config)[0]
    x1, y1, _ = panel_corners(config)[2]
    box = load_open3d().geometry.TriangleMesh.create_box(x1 - x0, y1 - y0, _BOARD_M)
    return box.translate([x0, y0, -_BOARD_M])


def _add_person(scene: PanelScene, R_K_W: FloatArray, rng: np.random.Generator) -> None:
    """A hand on the rim, away from the markers; its arm, and a body behind the panel."""
    rim, inward = _grip(scene.config, rng)
    side = np.cross([0, 0, 1.0], inward)
    for step in (-1.5, -0.5, 0.5, 1.5):
        base = rim + 0.018 * step * side + [0, 0, 0.009]
        scene.add("hand", _in_camera(scene, _rod(base - 0.03 * inward, base + 0.045 * inward, 0.008)))
    palm = rim - 0.045 * inward - [0, 0, 0.01]
    scene.add("hand", _in_camera(scene, _sphere(0.04, palm, 16)))
    elbow = palm - 0.25 * inward - [0, 0, 0.15]
    scene.add("clothes", _in_camera(scene, _rod(palm, elbow, 0.035)))
    # The body stands upright behind the panel.
    corners = panel_corners(scene.config) @ scene.R_K_P.T + scene.p_K_P
    middle, up = corners.mean(axis=0), R_K_W @ [0, 0, 1.0]
    back = unit(middle - up * (up @ middle))
    chest = middle + back * (((corners - middle) @ back).max() + 0.17 + rng.uniform(0.08, 0.25))
    scene.add("clothes", _rod(chest - 0.9 * up, chest + 0.25 * up, 0.17))
    scene.add("hand", _sphere(0.11, chest + 0.42 * up, 20))


def _grip(config: PanelSimulation, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """A point on the rim far enough from the markers, and the way inwards; both (3,) in {P}."""
    corners = panel_corners(config)
    spots = np.array([*config.markers, *config.extra_markers])
    best, farthest = (corners[2], np.array([-1.0, 0, 0])), -1.0
    for _ in range(50):
        i = rng.integers(4)
        edge = corners[(i + 1) % 4] - corners[i]
        rim = corners[i] + rng.uniform(0.15, 0.85) * edge
        inward = np.cross([0, 0, 1.0], unit(edge))
        away = np.linalg.norm(spots - (rim + 0.02 * inward)[:2], axis=1).min()
        if away > farthest:
            best, farthest = (rim, inward), away
        if away > _HAND_FROM_MARKER_M:
            break
    return best


def _in_camera(scene: PanelScene, mesh: Any) -> Any:
    """A mesh in {P} brought to {K}."""
    T_K_P = np.eye(4)
    T_K_P[:3, :3], T_K_P[:3, 3] = scene.R_K_P, scene.p_K_P
    return mesh.transform(T_K_P)


def _sphere(radius: float, centre: FloatArray, resolution: int) -> Any:
    return load_open3d().geometry.TriangleMesh.create_sphere(radius, resolution).translate(centre)


def _rod(start: FloatArray, stop: FloatArray, radius: float) -> Any:
    """A cylinder with round ends."""
    o3d = load_open3d()
    along = stop - start
    length = float(np.linalg.norm(along))
    z = along / length
    x = unit(np.cross(z, [1.0, 0, 0] if abs(z[0]) < 0.7 else [0, 1.0, 0]))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), (start + stop) / 2
    rod = o3d.geometry.TriangleMesh.create_cylinder(radius, length, resolution=24, split=1).transform(T)
    return rod + _sphere(radius, start, 10) + _sphere(radius, stop, 10)


def _plane(normal: FloatArray, through: FloatArray, size: float = 30.0) -> Any:
    """Two triangles, wide enough to fill every image."""
    o3d = load_open3d()
    x = unit(np.cross(normal, [1.0, 0, 0] if abs(normal[0]) < 0.7 else [0, 1.0, 0]))
    y = np.cross(normal, x)
    corners = np.array([through + size * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(corners), o3d.utility.Vector3iVector([[0, 1, 2], [0, 2, 3]])
    )


#: Rays per axis in a pixel where surfaces meet.
FINE = 10
#: A white surface at 1.5 m shows this fraction of the infrared image's full scale.
_DIFFUSE = 0.1
_REFERENCE_M = 1.5


@dataclass(frozen=True)
class IdealImages:
    """What a perfect sensor would measure; all of shape (height, width)."""

    z: FloatArray  # m: depth; inf where nothing reflects
    spread: FloatArray  # m: standard deviation of the depths that meet in a pixel
    infrared: FloatArray  # In full scales of the sensor; beyond 1 where it saturates
    cosine: FloatArray  # Between normal and ray
    marker: FloatArray  # Share of the pixel that a marker fills


def render(scene: PanelScene, lens: RenderLens) -> IdealImages:
    """Cast a ray through every pixel, and many through those where surfaces meet."""
    rays = lens.all_rays()
    hits = scene.cast(rays.reshape(-1, 2))
    z, infrared = hits.z.copy(), _shade(scene, rays.reshape(-1, 2), hits)
    spread, marker = np.zeros(len(z)), hits.marker.astype(float)
    mixed = np.flatnonzero(_mixed(scene, lens, hits))
    inside = _fine_rays(rays, mixed)
    fine = scene.cast(inside.reshape(-1, 2))
    bright = _shade(scene, inside.reshape(-1, 2), fine).reshape(len(mixed), -1)
    infrared[mixed] = bright.mean(axis=1)
    marker[mixed] = fine.marker.reshape(len(mixed), -1).mean(axis=1)
    # What is brighter counts for more in the mixture; a marker's own glare is held down by the sensor.
    weight = np.minimum(bright, 1.0) + 1e-9
    depth = np.minimum(fine.z, 50.0).reshape(len(mixed), -1)
    mean = (weight * depth).sum(axis=1) / weight.sum(axis=1)
    z[mixed] = np.where(mean < 49, mean, np.inf)
    spread[mixed] = np.sqrt((weight * (depth - mean[:, None]) ** 2).sum(axis=1) / weight.sum(axis=1))
    shape = (lens.height, lens.width)
    return IdealImages(*(part.reshape(shape) for part in (z, spread, infrared, hits.cosine, marker)))


def _shade(scene: PanelScene, rays: FloatArray, hits: Hits) -> FloatArray:
    """Infrared brightness (N,) in full scales; the lamp sits at the camera."""
    secant2 = 1 + (rays**2).sum(axis=1)
    fading = (_REFERENCE_M / np.where(np.isfinite(hits.z), hits.z, np.inf)) ** 2 / secant2
    vignette = 1 / secant2
    diffuse = _DIFFUSE * hits.albedo * hits.cosine
    return fading * vignette * np.where(hits.marker, scene.config.marker_gain, diffuse)


def _mixed(scene: PanelScene, lens: RenderLens, hits: Hits) -> BoolArray:
    """Pixels (N,) that may hold more than one surface, or an edge of a marker."""
    import cv2

    shape = (lens.height, lens.width)
    kinds = hits.surface.reshape(shape).astype(np.float32) + 1
    around = np.ones((3, 3), np.uint8)
    edges = cv2.dilate(kinds, around) != cv2.erode(kinds, around)
    size = scene.config.marker_diameter_m
    spots = np.array([*scene.config.markers, *scene.config.extra_markers])
    centres = np.column_stack([spots, np.zeros(len(spots))]) @ scene.R_K_P.T + scene.p_K_P
    near = hits.marker.reshape(shape).astype(np.uint8)
    for (u, v), z in zip(lens.project(centres), centres[:, 2], strict=True):
        reach = int(np.ceil(0.6 * size * max(lens.fx, lens.fy) / z)) + 2
        row, column = round(v), round(u)
        near[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1] = 1
    return np.asarray((edges | (cv2.dilate(near, around) > 0)).ravel())


def _fine_rays(rays: FloatArray, pixels: np.ndarray) -> FloatArray:
    """Rays (n, FINE^2, 2) on a grid in each pixel, by the first derivatives of the lens' rays."""
    width = rays.shape[1]
    row, column = np.divmod(pixels, width)
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


def infrared_image(
    ideal: IdealImages, config: PanelSimulation, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """The infrared image: blurred by the lens, clipped at full scale."""
    light = _blurred(ideal.infrared, config.blur_px)
    noise = rng.normal(size=light.shape)
    if config.infrared_noise > 0:
        light = light + noise * (config.infrared_noise * np.minimum(light, 1.0) + _DARK)
    return np.rint(np.clip(light, 0, 1) * FULL_SCALE).astype(np.uint16)


def depth_image(
    ideal: IdealImages, config: PanelSimulation, rng: np.random.Generator
) -> NDArray[np.uint16] | FloatArray:
    """The depth image, mm, 0 where there is none (float where the simulation does not quantise)."""
    noise, luck = rng.normal(size=ideal.z.shape), rng.random(ideal.z.shape)
    seen = np.isfinite(ideal.z)
    z = np.where(seen, ideal.z, 0.0)
    sigma = config.depth_noise_m * (z / _REFERENCE_M) ** 2 / np.maximum(ideal.cosine, 0.15)
    rim = ideal.spread > _RIM_M
    valid = seen & ~(rim & (luck > config.flying))
    glare = _blurred(ideal.infrared, config.blur_px)
    no_depth, beside = _around_markers(glare, ideal.marker)
    if config.halo_m > 0:
        z = z + config.halo_m * beside
        no_depth |= (beside > 0.6) & (luck < 0.5)
    z = z + sigma * noise + config.depth_offset_m
    valid &= ~no_depth & (z > RANGE_M[0]) & (z < RANGE_M[1])
    millimetres = np.where(valid, z * 1000, 0.0)
    return np.rint(millimetres).astype(np.uint16) if config.quantised else millimetres


def _around_markers(glare: FloatArray, marker: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Pixels without depth, and how near (1 to 0) the others are to a marker."""
    import cv2

    no_depth = (glare >= 1.0) | (marker > 0.02)
    away = cv2.distanceTransform((~no_depth).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return no_depth, np.where(no_depth, 0.0, np.exp(-(away - 1.0) / _FADES_PX))


def _blurred(image: FloatArray, sigma_px: float) -> FloatArray:
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px)) if sigma_px > 0 else image
