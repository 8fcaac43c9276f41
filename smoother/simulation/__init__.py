"""Recordings of our own making: a simulated arm with a depth camera, an IMU and truth."""

from .arm import SimulatedArm, simulate_arm, simulate_both_arms
from .config import ArmSimulation, Preset, SensorErrors
from .mocap import MarkerCapture, MocapSimulation, capture
from .people import PeopleSimulation, SimulatedPeople, simulate_people

__all__ = [
    "ArmSimulation",
    "MarkerCapture",
    "MocapSimulation",
    "PeopleSimulation",
    "Preset",
    "SensorErrors",
    "SimulatedArm",
    "SimulatedPeople",
    "capture",
    "simulate_arm",
    "simulate_both_arms",
    "simulate_people",
]
