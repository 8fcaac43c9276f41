"""Where arrays that grow with the recording live: here in memory; `io.disk_room` keeps them in files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Room:
    """Space for what grows with a recording's length, in memory."""

    def array(self, shape: tuple[int, ...], fill: float = np.nan, dtype: DTypeLike = np.float64) -> NDArray:
        """A new array, every value `fill`."""
        return np.full(shape, fill, dtype)

    def keep(self, value: object) -> object:
        """Put a value aside; `take` gives it back for what this returns."""
        return value

    def take(self, kept: Any) -> Any:
        """The value that was put aside; it can be taken once."""
        return kept

    def tidy(self) -> None:
        """Let what was written and read so far leave the memory; arrays stay what they are."""
