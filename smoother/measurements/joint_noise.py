"""Noise of the camera's joints, as a value."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class JointNoise:
    """Noise of a joint's samples, one standard deviation of each axis.

    Attributes
    ----------
    sample_m : float, m
        Of one sample.
    effective_m : float, m
        Of a white noise with the same long-run variance, which a graph of independent samples needs.
    memory_m : float, m
        The part that neighbours share.
    """

    sample_m: float
    effective_m: float
    memory_m: float
