"""A simulated arm's recording with rendered colour and depth images."""

from __future__ import annotations

from pathlib import Path

from smoother.io.rig.strap import write_strap_recording
from smoother.simulation.arm import SimulatedArm
from smoother.simulation.strap import COLOUR, DEPTH, DEPTH_LATER_S, strap_images


def with_images(simulated: SimulatedArm, path: Path, every: int = 3, seed: int = 0) -> None:
    """Write the recording, and images of its arm at every so many frames (the strap at the IMU's place)."""
    times = simulated.recording.arm.t_s[::every]
    images = list(strap_images(simulated, times, seed))
    write_strap_recording(path, simulated.recording, images, times, (COLOUR, DEPTH), DEPTH_LATER_S)
