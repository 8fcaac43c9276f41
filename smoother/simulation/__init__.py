"""Recordings of our own making: a simulated arm or point with a depth camera, an IMU and truth."""

from .arm import SimulatedArm, simulate_arm
from .config import ArmSimulation, PointSimulation, Preset, SensorErrors
from .mocap import MarkerCapture, MocapSimulation, capture
from .point import simulate_point

__all__ = [
    "ArmSimulation",
    "MarkerCapture",
    "MocapSimulation",
    "PointSimulation",
    "Preset",
    "SensorErrors",
    "SimulatedArm",
    "capture",
    "simulate_arm",
    "simulate_point",
]
