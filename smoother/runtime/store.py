"""Where arrays that grow with the recording live: here in memory; `disk_store` keeps them in files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Store:
    """Space for what grows with a recording's length, in memory."""

    def array(self, shape: tuple[int, ...], fill: float = np.nan, dtype: DTypeLike = np.float64) -> NDArray:
        """A new array, every value `fill`."""
        return np.full(shape, fill, dtype)

    def put(self, value: object) -> object:
        """Put a value aside; `pop` gives it back for what this returns."""
        return value

    def pop(self, kept: Any) -> Any:
        """The value that was put aside; it can be taken once."""
        return kept
