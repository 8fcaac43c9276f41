"""`simulate_panel`: images, mocap markers and truth of a panel held before a depth camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...recording import FloatArray
from .config import PanelSimulation
from .lens import Lens
from .placing import place_camera, place_mocap, place_panel
from .render import render
from .scene import Scene, add_distractor, build_scene
from .sensor import depth_image, infrared_image

#: A distractor stays at least this far from the panel's outline, pixels.
_DISTRACTOR_FROM_PANEL_PX = 15.0


@dataclass(frozen=True)
class PanelPose:
    """What camera and mocap see of the panel in one pose, and where it truly is.

    Attributes
    ----------
    depth : (height, width) uint16, mm along the optical axis, 0 = none (float where not quantised).
    infrared : (height, width) uint16.
    marker_names : of the mocap markers, in the order they come in.
    markers : (n, 3) m in {E}, with the mocap's noise, shuffled.
    marker_order : (n,) which marker of the panel's definition each of them is.
    R_K_P, p_K_P : (3, 3) and (3,) m, the panel in the camera.
    marker_pixels : (n, 2) exact pixels of the markers' centres, in the order of the definition.
    """

    depth: NDArray[np.uint16] | FloatArray
    infrared: NDArray[np.uint16]
    marker_names: tuple[str, ...]
    markers: FloatArray
    marker_order: NDArray[np.int64]
    R_K_P: FloatArray
    p_K_P: FloatArray
    marker_pixels: FloatArray


@dataclass(frozen=True)
class SimulatedPanel:
    """Poses of one panel before one camera, and the answer.

    Attributes
    ----------
    config, seed : what they were made of.
    lens : the camera's intrinsics.
    poses : the panel poses.
    R_K_E, t_K_E : the answer of `calibrate panel`, camera from mocap: p_K = R_K_E p_E + t_K_E, m.
    R_W_K : the camera in the world, z up.
    """

    config: PanelSimulation
    seed: int
    lens: Lens
    poses: tuple[PanelPose, ...]
    R_K_E: FloatArray
    t_K_E: FloatArray
    R_W_K: FloatArray


def simulate_panel(config: PanelSimulation, seed: int = 0) -> SimulatedPanel:
    """Hold a panel before a depth camera, in as many poses as the settings say.

    The same settings and seed give the same values. Each pose draws from a stream of its own.

    Raises
    ------
    ValueError
        The panel does not fit into the image at the configured distances.
    """
    streams = np.random.SeedSequence(seed).spawn(config.poses + 1)
    rng = np.random.default_rng(streams[0])
    lens = make_lens(config)
    R_W_K = place_camera(rng)
    R_K_E, t_K_E = place_mocap(R_W_K, rng)
    poses = tuple(
        _pose(config, lens, R_W_K, R_K_E, t_K_E, np.random.default_rng(stream)) for stream in streams[1:]
    )
    return SimulatedPanel(config, seed, lens, poses, R_K_E, t_K_E, R_W_K)


def make_lens(config: PanelSimulation) -> Lens:
    """The camera's intrinsics: the principal point lies some pixels off the middle."""
    return Lens(
        config.width,
        config.height,
        fx=config.focal_px,
        fy=config.focal_px * 1.0008,
        cx=config.width / 2 + 2.3,
        cy=config.height / 2 - 4.1,
        distortion=config.distortion,
    )


def _pose(
    config: PanelSimulation,
    lens: Lens,
    R_W_K: FloatArray,
    R_K_E: FloatArray,
    t_K_E: FloatArray,
    rng: np.random.Generator,
) -> PanelPose:
    R_K_P, p_K_P = place_panel(config, lens, rng)
    scene = build_scene(config, R_K_P, p_K_P, R_W_K.T, rng)
    _distract(scene, lens, config.distractors, rng)
    ideal = render(scene, lens)
    infrared = infrared_image(ideal, config, rng)
    depth = depth_image(ideal, config, rng)
    flat = np.column_stack([config.markers, np.zeros(len(config.markers))])
    true_K = flat @ R_K_P.T + p_K_P
    order = rng.permutation(len(flat))
    noise = config.mocap_noise_m * rng.normal(size=true_K.shape)
    markers = ((true_K - t_K_E) @ R_K_E + noise)[order]
    names = tuple(f"M{number:02d}" for number in rng.permutation(np.arange(1, 1 + len(flat))))
    return PanelPose(depth, infrared, names, markers, order, R_K_P, p_K_P, lens.project(true_K))


def _distract(scene: Scene, lens: Lens, count: int, rng: np.random.Generator) -> None:
    """Put bright balls beside the panel, wherever there is room in the image."""
    import cv2

    from .placing import panel_corners

    outline = lens.project(panel_corners(scene.config) @ scene.R_K_P.T + scene.p_K_P).astype(np.float32)
    rays = lens.rays()
    placed = 0
    for _ in range(1000 * bool(count)):
        row, column = rng.integers(10, lens.height - 10), rng.integers(10, lens.width - 10)
        if cv2.pointPolygonTest(outline, (float(column), float(row)), True) > -_DISTRACTOR_FROM_PANEL_PX:
            continue
        ray = rays[row, column]
        z = float(scene.cast(ray[None]).z[0])
        if np.isfinite(z):
            add_distractor(scene, ray, rng.uniform(1.0, min(z - 0.05, 2.0)))
            placed += 1
        if placed == count:
            return
