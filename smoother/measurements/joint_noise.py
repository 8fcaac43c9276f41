"""Noise of the camera's joints, as a value."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class JointNoise:
    """Noise of a joint's samples, m an axis.

    `sample_m` is the deviation of one sample; `effective_m` that of a white noise with the same
    long-run variance, which is what a graph of independent samples must be told; `memory_m` the part
    that neighbours share.
    """

    sample_m: float
    effective_m: float
    memory_m: float
