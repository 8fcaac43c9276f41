"""Position and orientation figures of `validate` held against evo's (github.com/MichaelGrupp/evo).

evo is not a dependency: install it into an environment of its own (`python -m venv evo; evo/bin/pip install
evo`) and name that environment's Python. Both get the same samples; they must agree to rounding.

    .venv/bin/python tools/evo_check.py recovered.mcap --truth session.mcap --evo-python evo/bin/python
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from smoother.cli.load import camera_frame_of
from smoother.evaluation.reference import read_reference
from smoother.evaluation.validate import sample_errors
from smoother.io import read_recovery

#: Nine decimals are written, so figures may differ by about as much (m, degrees).
ROUNDING_M, ROUNDING_DEG = 1e-8, 1e-5

#: Runs in evo's environment: TUM files in, figures out.
EVO = """
import json, sys
from evo.core import metrics
from evo.tools import file_interface
pair = [file_interface.read_tum_trajectory_file(name) for name in sys.argv[1:3]]
found = {}
for name, relation in (("m", "translation_part"), ("deg", "rotation_angle_deg")):
    ape = metrics.APE(getattr(metrics.PoseRelation, relation))
    ape.process_data(tuple(pair))
    found[name] = {key: float(value) for key, value in ape.get_all_statistics().items()}
print(json.dumps(found))
"""


def main() -> int:
    """Compare; 0 if all figures agree."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("result", type=Path)
    options.add_argument("--truth", type=Path, required=True)
    options.add_argument("--markers", type=Path)
    options.add_argument("--calibration", type=Path)
    options.add_argument("--evo-python", required=True, help="Python of an environment with evo")
    given = options.parse_args()
    recovery = read_recovery(given.result)[0]
    truth, _ = read_reference(
        given.truth,
        recovery,
        markers=given.markers,
        calibration=given.calibration,
        camera_frame=camera_frame_of(given.result),
    )
    errors = sample_errors(recovery, truth)
    worst = True
    for name, chosen in (("all", np.ones(len(recovery), bool)), ("occluded", recovery.occluded)):
        chosen = chosen & np.isfinite(errors.distance_m) & np.isfinite(errors.angle_deg)
        figures = errors.figures(chosen)
        with tempfile.TemporaryDirectory() as folder:
            reference = errors.reference
            files = [Path(folder) / "truth.tum", Path(folder) / "answer.tum"]
            _write_tum(
                files[0], recovery.t_s[chosen], reference.position[chosen], reference.quaternion[chosen]
            )
            _write_tum(files[1], recovery.t_s[chosen], recovery.position[chosen], recovery.quaternion[chosen])
            command = [given.evo_python, "-c", EVO, *map(str, files)]
            evo = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        rows = [
            ("position rms, m", figures.position_rms_m, evo["m"]["rmse"], ROUNDING_M),
            ("position median, m", figures.position_median_m, evo["m"]["median"], ROUNDING_M),
            ("position max, m", figures.position_max_m, evo["m"]["max"], ROUNDING_M),
            ("orientation rms, deg", figures.orientation_rms_deg, evo["deg"]["rmse"], ROUNDING_DEG),
            ("orientation max, deg", figures.orientation_max_deg, evo["deg"]["max"], ROUNDING_DEG),
        ]
        for what, ours, theirs, rounding in rows:
            assert ours is not None
            agrees = abs(ours - theirs) <= rounding
            worst = worst and agrees
            print(f"{name:9} {what:22} {ours:.9f} {theirs:.9f} {'agrees' if agrees else 'DIFFERS'}")
    return 0 if worst else 1


def _write_tum(path: Path, t_s: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
    """The text format of TUM: t x y z qx qy qz qw."""
    table = np.column_stack([t_s, position, np.roll(quaternion, -1, axis=1)])
    np.savetxt(path, table, fmt="%.12f")


if __name__ == "__main__":
    sys.exit(main())
