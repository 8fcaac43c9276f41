"""What a depth camera's skeleton states of an arm: stamps, noise, and what it does where it cannot see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import gammainc

from ..array_types import BoolArray, FloatArray
from ..linalg import unit
from ..recording import JOINTS, JointState, JointTracks
from .config import SensorErrors


@dataclass
class Footage:
    """Frames in the making: truth first, then spoilt step by step.

    Attributes
    ----------
    t_s : ndarray, shape (F,), s
        True times of exposure.
    position : ndarray, shape (F, 5, 3), m
        In {K}, joints in the order of `JOINTS`.
    state : ndarray, shape (F, 5)
        `JointState` values.
    """

    t_s: FloatArray
    position: FloatArray
    state: np.ndarray


def exposures(duration_s: float, rate_hz: float, rng: np.random.Generator) -> FloatArray:
    """True times (F,) of the frames: a steady rate from a random phase."""
    return np.asarray(np.arange(rng.uniform(0, 1) / rate_hz, duration_s, 1.0 / rate_hz))


def film(t_s: FloatArray, joints: dict[str, FloatArray]) -> Footage:
    """Error-free frames with every given joint (F, 3) tracked and the others absent."""
    position = np.full((len(t_s), len(JOINTS), 3), np.nan)
    state = np.full((len(t_s), len(JOINTS)), JointState.NOT_TRACKED, dtype=np.int8)
    for joint, track in joints.items():
        position[:, JOINTS.index(joint)] = track
        state[:, JOINTS.index(joint)] = JointState.TRACKED
    return Footage(t_s, position, state)


def correlated_noise(
    frames: int, size: int, sigma: float | FloatArray, tau_s: float, step_s: float, rng: np.random.Generator
) -> FloatArray:
    """Noise (frames, size) with standard deviation `sigma` and autocorrelation exp(-lag / tau_s)."""
    memory = np.exp(-step_s / tau_s)
    drive = rng.normal(size=(frames, size)) * np.sqrt(1 - memory**2)
    drive[0] /= np.sqrt(1 - memory**2)  # stationary from the first frame on
    return np.asarray(sigma * lfilter([1.0], [1.0, -memory], drive, axis=0))


def add_noise(footage: Footage, errors: SensorErrors, rng: np.random.Generator) -> dict[str, Any]:
    """Add bias, correlated, white and depth noise to every joint; returns the biases (5, 3) m in {K}."""
    frames, joints, _ = footage.position.shape
    true = footage.position.copy()
    drawn = rng.normal(size=(joints, 3))
    bias = errors.joint_bias_m * drawn
    if errors.joint_off_m:
        # A normal vector's length is independent of its direction: its quantile gives the size.
        least, most = min(errors.joint_off_m), max(errors.joint_off_m)
        size = least + (most - least) * gammainc(1.5, 0.5 * (drawn**2).sum(axis=1, keepdims=True))
        bias += size * unit(drawn)
    footage.position += bias
    slow = np.zeros(joints)
    slow[: len(errors.joint_slow_m)] = errors.joint_slow_m
    footage.position += correlated_noise(
        frames,
        joints * 3,
        np.repeat(np.hypot(errors.noise_correlated_m, slow / np.sqrt(3)), 3),
        errors.noise_correlated_s,
        1.0 / errors.frame_rate_hz,
        rng,
    ).reshape(true.shape)
    footage.position += errors.noise_m * rng.normal(size=true.shape)
    distance = np.linalg.norm(true, axis=2, keepdims=True)
    along_ray = errors.noise_depth_m * (distance / 2.0) ** 2 * rng.normal(size=distance.shape)
    footage.position += along_ray * true / distance
    return {"joint_bias": {name: bias[k] for k, name in enumerate(JOINTS)}}


def add_outliers(footage: Footage, errors: SensorErrors, rng: np.random.Generator) -> BoolArray:
    """Displace a fraction of the tracked samples in a random direction; returns which (F, 5)."""
    wrong = rng.uniform(size=footage.state.shape) < errors.outliers
    wrong &= footage.state == JointState.TRACKED
    direction = unit(rng.normal(size=footage.position.shape))
    footage.position[wrong] += errors.outlier_m * direction[wrong]
    return wrong


def deliver(
    footage: Footage, name: str, errors: SensorErrors, rng: np.random.Generator
) -> tuple[JointTracks, BoolArray]:
    """Stamp the frames on the camera's clock and drop some; returns the tracks and which frames remain (F,).

    A stamp is the true time plus the latency plus jitter; jitter never changes the order of frames.
    """
    jitter = errors.frame_jitter_s * rng.normal(size=len(footage.t_s))
    limit = 0.45 / errors.frame_rate_hz
    stamp = footage.t_s + errors.latency_s + np.clip(jitter, -limit, limit)
    delivered = rng.uniform(size=len(stamp)) >= errors.dropped_frames
    position = footage.position.copy()
    position[footage.state == JointState.NOT_TRACKED] = np.nan
    return JointTracks(name, stamp[delivered], position[delivered], footage.state[delivered]), delivered
