"""Recordings with truth, to try what you do with real ones: `unocclude.simulation.simulate_arm`.

from unocclude.simulation import ArmSimulation, simulate_arm

simulated = simulate_arm(ArmSimulation.preset("realistic"), seed=1)
recovery = unocclude.smooth(simulated.recording)
"""

from __future__ import annotations

from smoother.simulation import *  # noqa: F403
from smoother.simulation import __all__ as __all__
