"""Where a simulated recording goes, with what a calibration of it should find."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .options import Force, Json, Output, Seed
from .output import check_mcap, check_outputs, say_written, write_json, write_truth


@dataclass(frozen=True)
class SimulatedFile:
    """A simulated recording and its truth, as a group of a command's options.

    Attributes
    ----------
    output : Path
        The recording.
    seed : int
        Of the simulation.
    json_file : Path, optional
        For the figures.
    force : bool
        Overwrite what exists.
    """

    output: Output
    seed: Seed = 0
    json_file: Json = None
    force: Force = False

    @property
    def truth(self) -> Path:
        """What the calibration should find, beside the recording."""
        return self.output.with_name(f"{self.output.stem}_truth.toml")

    def check(self) -> None:
        """Refuse what could not be written in the end."""
        check_mcap(self.output)
        check_outputs(self.force, [self.output, self.truth, self.json_file])

    def write_truth(self, tables: dict[str, Any], **figures: Any) -> None:
        """Write what should be found, in the form of a calibration file; as JSON with further figures."""
        write_truth(self.truth, tables, self.force)
        write_json(self.json_file, {"seed": self.seed, **figures, "truth": tables}, self.force)

    def say_written(self) -> None:
        """Print what was written."""
        say_written(self.output, self.truth, self.json_file)
