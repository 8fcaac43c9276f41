"""A marker panel before a depth camera: rendered depth and infrared images, mocap markers, and the answer."""

from .config import PanelSimulation
from .placing import RenderLens
from .simulate import PanelPose, SimulatedPanel, simulate_panel

__all__ = ["PanelPose", "PanelSimulation", "RenderLens", "SimulatedPanel", "simulate_panel"]
