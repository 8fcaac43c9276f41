"""Open exported TRC and MOT files in OpenSim, and hold them against each other.

The model has the coordinates that the MOT file names, in the order of MoBL-ARMS, and segments of the lengths
that the TRC file shows. Moved by the MOT file, its elbow and wrist must lie where the TRC file has them.

    python -m venv sim; sim/bin/pip install opensim
    unocclude export out.mcap --format trc -o out.trc; unocclude export out.mcap --format mot -o out.mot
    sim/bin/python tools/opensim_check.py out.trc out.mot --side right

Needs `opensim` and numpy alone, so that it runs in an environment of its own.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

#: Coordinates of the chain from the thorax to the forearm, and the axes that they turn about.
CHAIN = (
    ("elv_angle", (0, 1, 0)),
    ("shoulder_elv", (-1, 0, 0)),
    ("elv_back", (0, 1, 0)),
    ("shoulder_rot", (0, 1, 0)),
    ("elbow_flexion", (0, 0, 1)),
)
#: What a file's decimals leave of an angle and a length, m at an arm's length.
TOLERANCE_M = 1e-5


def main() -> int:
    """Print what was found; exit code 1 where model and markers differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trc")
    parser.add_argument("mot")
    parser.add_argument("--side", choices=("left", "right"), default="right")
    parser.add_argument("--rows", type=int, default=200, help="how many rows to compare")
    arguments = parser.parse_args()
    compared, worst_m = check(arguments.trc, arguments.mot, arguments.side, arguments.rows)
    print(f"{compared} rows; the model's joints are {worst_m:g} m from the markers at most")
    return 0 if compared and worst_m <= TOLERANCE_M else 1


def check(trc: str, mot: str, side: str, rows: int) -> tuple[int, float]:
    """Rows of both files that were compared, and how far the model's joints are from the markers, m."""
    import opensim

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Warn")
    markers, motion = opensim.TimeSeriesTableVec3(trc), opensim.TimeSeriesTable(mot)
    metres = {"mm": 1e-3, "m": 1.0}[markers.getTableMetaDataString("Units")]
    times = np.array(markers.getIndependentColumn())
    common = [k for k, t in enumerate(motion.getIndependentColumn()) if np.abs(times - t).min() < 1e-6]
    mirror = np.diag([1.0, 1.0, -1.0 if side == "left" else 1.0])
    (model, bodies), compared, worst_m = arm_model(), 0, 0.0
    state = model.initSystem()
    for k in common[:: max(len(common) // rows, 1)]:
        row = int(np.abs(times - motion.getIndependentColumn()[k]).argmin())
        shoulder, elbow, wrist = (
            _vector(markers.getDependentColumn(name)[row]) * metres for name in ("shoulder", "elbow", "wrist")
        )
        if not np.isfinite([shoulder, elbow, wrist]).all():
            continue
        for name, _ in CHAIN:
            column, sign = ("elv_angle", -1.0) if name == "elv_back" else (name, 1.0)
            angle = sign * np.radians(float(motion.getDependentColumn(column)[k]))
            model.updCoordinateSet().get(name).setValue(state, angle, False)
        model.realizePosition(state)
        for body, bone in ((bodies[3], elbow - shoulder), (bodies[4], wrist - elbow)):
            down = _vector(body.expressVectorInGround(state, opensim.Vec3(0, -1, 0)))
            off = np.linalg.norm(bone) * down - mirror @ bone
            worst_m = max(worst_m, float(np.linalg.norm(off)))
        compared += 1
    return compared, worst_m


def arm_model():
    """The chain of MoBL-ARMS, a joint a coordinate; y of each body points up along the bone."""
    import opensim

    model = opensim.Model()
    bodies = []
    parent = model.getGround()
    for coordinate, axis in CHAIN:
        body = opensim.Body(f"after_{coordinate}", 1.0, opensim.Vec3(0), opensim.Inertia(1, 1, 1, 0, 0, 0))
        model.addBody(body)
        names = opensim.ArrayStr()
        names.append(coordinate)
        transform = opensim.SpatialTransform()
        turn = transform.updTransformAxis(0)
        turn.setCoordinateNames(names)
        turn.setAxis(opensim.Vec3(*axis))
        turn.set_function(opensim.LinearFunction(1.0, 0.0))
        # The two axes that do not move may not lie along the one that does.
        transform.updTransformAxis(1).setAxis(opensim.Vec3(*np.roll(axis, 1).tolist()))
        transform.updTransformAxis(2).setAxis(opensim.Vec3(*np.roll(axis, 2).tolist()))
        joint = opensim.CustomJoint(f"joint_{coordinate}", parent, body, transform)
        model.addJoint(joint)
        bodies.append(body)
        parent = body
    model.finalizeConnections()
    return model, bodies


def _vector(value) -> np.ndarray:
    return np.array([value.get(i) for i in range(3)])


if __name__ == "__main__":
    sys.exit(main())
