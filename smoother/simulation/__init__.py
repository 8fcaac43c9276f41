"""Recordings of our own making: a simulated arm or point with a depth camera, an IMU and truth."""

from .arm import SimulatedArm, simulate_arm, simulate_both_arms, simulate_point
from .config import ArmSimulation, PointSimulation, Preset, SensorErrors
from .mocap import MarkerCapture, MocapSimulation, capture
from .people import PeopleSimulation, SimulatedPeople, simulate_people

__all__ = [
    "ArmSimulation",
    "MarkerCapture",
    "MocapSimulation",
    "PeopleSimulation",
    "PointSimulation",
    "Preset",
    "SensorErrors",
    "SimulatedArm",
    "SimulatedPeople",
    "capture",
    "simulate_arm",
    "simulate_both_arms",
    "simulate_people",
    "simulate_point",
]
