"""Recordings of our own making: a simulated arm or point with a depth camera, an IMU and truth."""

from .arm import SimulatedArm, simulate_arm
from .config import ArmSimulation, PointSimulation, Preset, SensorErrors
from .point import simulate_point

__all__ = [
    "ArmSimulation",
    "PointSimulation",
    "Preset",
    "SensorErrors",
    "SimulatedArm",
    "simulate_arm",
    "simulate_point",
]
