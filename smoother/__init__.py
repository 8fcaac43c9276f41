"""unocclude: the arm's motion where the depth camera could not see it."""

from __future__ import annotations

__version__ = "0.1.0"
