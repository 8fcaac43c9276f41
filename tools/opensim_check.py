"""Open exported TRC, MOT and OSIM files in OpenSim, and hold them against each other.

The model has the coordinates that the MOT file names, in the order of MoBL-ARMS, and segments of the lengths
that the TRC file shows. Moved by the MOT file, its elbow and wrist must lie where the TRC file has them.

    python -m venv sim; sim/bin/pip install opensim
    unocclude export out.mcap --format trc -o out.trc; unocclude export out.mcap --format mot -o out.mot
    sim/bin/python tools/opensim_check.py out.trc out.mot --side right

With `--model out.osim` OpenSim's Inverse Kinematics tool moves the exported model by the TRC file, and its
angles are held against those of the MOT file; with `--truth out.mcap` also against the truth in that result.
With `--orientations out.sto` too, OpenSense moves it by the IMUs' orientations (forearm and upper arm).

`--folder` runs what `unocclude export --format opensim` wrote as it is: Scale, Inverse Kinematics, OpenSense.

    sim/bin/python tools/opensim_check.py --folder out_opensim

Needs `opensim` and numpy alone, so that it runs in an environment of its own; `--truth` needs unocclude too.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

#: Coordinates of the chain from the thorax to the forearm, and the axes that they turn about.
CHAIN = (
    ("elv_angle", (0, 1, 0)),
    ("shoulder_elv", (-1, 0, 0)),
    ("elv_back", (0, 1, 0)),
    ("shoulder_rot", (0, 1, 0)),
    ("elbow_flexion", (0, 0, 1)),
)
COMPARED = ("elv_angle", "shoulder_elv", "shoulder_rot", "elbow_flexion", "pro_sup")
#: Of the markers' fit; the tool's own 1e-5 stops degrees short in pro_sup, by a marker 3 cm off the bone.
ACCURACY = 1e-9
#: What a file's decimals leave of an angle and a length, m at an arm's length.
TOLERANCE_M = 1e-5


def main() -> int:
    """Print what was found as JSON; exit code 1 where model and markers differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trc", nargs="?")
    parser.add_argument("mot", nargs="?")
    parser.add_argument("--folder", help="what `export --format opensim` wrote; all of its set-ups are run")
    parser.add_argument("--side", choices=("left", "right"), default="right")
    parser.add_argument("--rows", type=int, default=200, help="how many rows to compare")
    parser.add_argument("--model", help="the exported model, to be moved by inverse kinematics")
    parser.add_argument("--orientations", help="exported orientations, to move the model by OpenSense")
    parser.add_argument("--truth", help="a result with a truth in it, to compare the angles with")
    parser.add_argument("--seconds", type=float, help="how much of the recording to move the model through")
    arguments = parser.parse_args()
    if arguments.folder:
        print(json.dumps(run_folder(Path(arguments.folder).resolve()), indent=2))
        return 0
    if not arguments.mot:
        parser.error("name a TRC and a MOT file, or --folder")
    figures = check(arguments.trc, arguments.mot, arguments.side, arguments.rows)
    if arguments.model:
        times, angles = inverse_kinematics(arguments.model, arguments.trc, arguments.seconds)
        figures["ik_rows"] = len(times)
        figures["ik_minus_mot_deg"] = against(times, angles, *motion_file(arguments.mot))
        if arguments.truth:
            figures["ik_minus_truth_deg"] = against(times, angles, *truth_angles(arguments.truth))
        if arguments.orientations:
            times, angles = opensense(arguments.model, arguments.orientations, arguments.seconds)
            figures["opensense_rows"] = len(times)
            figures["opensense_minus_mot_deg"] = against(times, angles, *motion_file(arguments.mot))
    print(json.dumps(figures, indent=2))
    return 0 if figures["worst_m"] <= TOLERANCE_M else 1


def check(trc: str, mot: str, side: str, rows: int) -> dict[str, object]:
    """Load both files and compare the model's joints with the markers, m."""
    import opensim

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Warn")
    markers = opensim.TimeSeriesTableVec3(trc)
    motion = opensim.TimeSeriesTable(mot)
    metres = {"mm": 1e-3, "m": 1.0}[markers.getTableMetaDataString("Units")]
    labels = list(motion.getColumnLabels())
    times = np.array(markers.getIndependentColumn())
    common = [k for k, t in enumerate(motion.getIndependentColumn()) if np.abs(times - t).min() < 1e-6]
    worst = 0.0
    compared = 0
    model, state, bodies = None, None, []
    for k in common[:: max(len(common) // rows, 1)]:
        row = int(np.abs(times - motion.getIndependentColumn()[k]).argmin())
        joints = {name: _marker(markers, name, row) * metres for name in ("shoulder", "elbow", "wrist")}
        if not np.isfinite(np.concatenate(list(joints.values()))).all():
            continue
        mirror = np.diag([1.0, 1.0, -1.0 if side == "left" else 1.0])
        upper = mirror @ (joints["elbow"] - joints["shoulder"])
        fore = mirror @ (joints["wrist"] - joints["elbow"])
        if model is None:
            model, bodies = arm_model()
            state = model.initSystem()
        for name, _ in CHAIN:
            column, sign = ("elv_angle", -1.0) if name == "elv_back" else (name, 1.0)
            angle = sign * np.radians(float(motion.getDependentColumn(column)[k]))
            model.updCoordinateSet().get(name).setValue(state, angle, False)
        model.realizePosition(state)
        for body, true in ((bodies[3], upper), (bodies[4], fore)):
            down = body.expressVectorInGround(state, opensim.Vec3(0, -1, 0))
            length = np.linalg.norm(true)
            model_end = length * np.array([down.get(i) for i in range(3)])
            worst = max(worst, float(np.linalg.norm(model_end - true)))
        compared += 1
    return {
        "opensim": opensim.GetVersion(),
        "markers": list(markers.getColumnLabels()),
        "marker_rows": markers.getNumRows(),
        "units": markers.getTableMetaDataString("Units"),
        "coordinates": labels,
        "motion_rows": motion.getNumRows(),
        "in_degrees": motion.getTableMetaDataString("inDegrees"),
        "compared": compared,
        "worst_m": worst if compared else float("inf"),
    }


def inverse_kinematics(model_file: str, trc: str, seconds: float | None = None):
    """Times (n,) and angles (n,) by coordinate, degrees, as OpenSim's own tool finds them."""
    import opensim

    opensim.Logger.removeFileSink()  # no opensim.log where somebody works
    opensim.Logger.setLevelString("Error")
    times = opensim.TimeSeriesTableVec3(trc).getIndependentColumn()
    with tempfile.TemporaryDirectory() as folder:
        output = str(Path(folder) / "ik.mot")
        model = opensim.Model(model_file)
        model.initSystem()
        tool = opensim.InverseKinematicsTool()
        tool.setModel(model)
        tool.setMarkerDataFileName(str(trc))
        tool.setStartTime(times[0])
        tool.setEndTime(times[-1] if seconds is None else min(times[-1], times[0] + seconds))
        tool.setOutputMotionFileName(output)
        tool.setResultsDir(folder)
        tool.set_accuracy(ACCURACY)
        tool.set_report_errors(False)
        tool.run()
        return motion_file(output)


def opensense(model_file: str, sto: str, seconds: float | None = None):
    """Times (n,) and angles (n,) by coordinate, degrees, as OpenSim's tool for IMUs finds them."""
    import opensim

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Error")
    times = opensim.TimeSeriesTableQuaternion(str(sto)).getIndependentColumn()
    with tempfile.TemporaryDirectory() as folder:
        output = "imu_ik.mot"
        tool = opensim.IMUInverseKinematicsTool()
        tool.set_model_file(str(model_file))
        tool.set_orientations_file(str(sto))
        tool.set_sensor_to_opensim_rotations(opensim.Vec3(0.0, 0.0, 0.0))  # y up already
        tool.setStartTime(times[0])
        tool.setEndTime(times[-1] if seconds is None else min(times[-1], times[0] + seconds))
        tool.set_results_directory(folder)
        tool.set_output_motion_file(output)
        tool.set_accuracy(ACCURACY)
        tool.set_report_errors(False)
        tool.run(False)
        return motion_file(str(Path(folder) / output))


def run_folder(folder: Path) -> dict[str, object]:
    """Run the set-ups of an exported folder, and hold what they find against its model and its angles."""
    import opensim

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Error")
    os.chdir(folder)  # the tools take names of files from where they run
    own = motion_file(str(folder / "arm.mot"))
    for values in own[1].values():
        values[own[1]["answered"] < 1] = np.nan  # a straight line there
    figures: dict[str, object] = {"opensim": opensim.GetVersion()}
    figures["scale"] = opensim.ScaleTool(str(folder / "scale.xml")).run()
    exported, scaled = (markers_of(folder / name) for name in ("arm.osim", "scaled.osim"))
    figures["scaled_minus_exported_m"] = {
        name: float(np.linalg.norm(place - exported[name])) for name, place in scaled.items()
    }
    figures["ik"] = opensim.InverseKinematicsTool(str(folder / "ik.xml")).run()
    figures["ik_minus_mot_deg"] = against(*motion_file(str(folder / "ik.mot")), *own)
    # the model that Scale made, by the same set-up
    text = (folder / "ik.xml").read_text(encoding="utf-8")
    text = text.replace("arm.osim", "scaled.osim").replace(">ik.mot<", ">ik_scaled.mot<")
    (folder / "ik_scaled.xml").write_text(text, encoding="utf-8")
    figures["ik_scaled"] = opensim.InverseKinematicsTool(str(folder / "ik_scaled.xml")).run()
    figures["ik_scaled_minus_mot_deg"] = against(*motion_file(str(folder / "ik_scaled.mot")), *own)
    if (folder / "imu_ik.xml").exists():
        figures["imu_ik"] = opensim.IMUInverseKinematicsTool(str(folder / "imu_ik.xml")).run(False)
        figures["imu_ik_minus_mot_deg"] = against(*motion_file(str(folder / "imu_ik.mot")), *own)
    return figures


def markers_of(model_file: Path) -> dict[str, np.ndarray]:
    """Places (3,) of a model's markers on their bodies, m."""
    import opensim

    model = opensim.Model(str(model_file))
    model.initSystem()
    markers = [model.getMarkerSet().get(k) for k in range(model.getMarkerSet().getSize())]
    return {
        marker.getName(): np.array([marker.get_location().get(i) for i in range(3)]) for marker in markers
    }


def motion_file(path: str):
    """Times (n,) and angles (n,) by column of a MOT file."""
    import opensim

    table = opensim.TimeSeriesTable(str(path))
    columns = {name: table.getDependentColumn(name).to_numpy() for name in table.getColumnLabels()}
    return np.array(table.getIndependentColumn()), columns


def truth_angles(result: str):
    """The same of the truth that is in a result; nan near postures that do not define an angle."""
    from smoother.evaluation.truth import read_truth_mcap
    from smoother.io import read_recovery
    from smoother.joint_angles import arm_angles, defined, forearm_axes, wrapped_deg

    recovery = read_recovery(result)[0]
    truth = read_truth_mcap(Path(result), recovery)
    R_F_A = recovery.calibration.R_F_A
    R_K_F = None if R_F_A is None else forearm_axes(truth.quaternion, R_F_A)
    isb = arm_angles(truth.joints, len(truth), R_K_F, recovery.side, recovery.gravity_direction)
    known = defined(isb)
    isb = {name: np.where(known[name], values, np.nan) for name, values in isb.items()}
    return truth.t_s, {
        "elv_angle": isb["shoulder_plane"],
        "shoulder_elv": isb["shoulder_elevation"],
        "shoulder_rot": wrapped_deg(isb["shoulder_rotation"] + isb["shoulder_plane"]),
        "elbow_flexion": isb["elbow_flexion"],
        "pro_sup": isb["pronation"] - 90.0,
    }


def against(times, angles, other_times, others) -> dict[str, dict[str, float]]:
    """Root mean square, 95 % and largest difference of each angle that both have, degrees."""
    near = np.abs(other_times[:, None] - times[None, :]).argmin(axis=0)
    figures = {}
    for name in (name for name in COMPARED if name in angles and name in others):
        difference = (angles[name] - others[name][near] + 180.0) % 360.0 - 180.0
        size = np.abs(difference[np.isfinite(difference)])
        if len(size):
            rms, most = float(np.sqrt(np.mean(size**2))), float(size.max())
            figures[name] = {"rms": rms, "p95": float(np.percentile(size, 95)), "max": most}
    return figures


def arm_model():
    """The chain of MoBL-ARMS, a joint a coordinate; y of each body points up along the bone.

    MoBL-ARMS couples a fifth coordinate, which undoes the plane of elevation, to `elv_angle`.
    """
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


def _marker(table, name: str, row: int) -> np.ndarray:
    value = table.getDependentColumn(name)[row]
    return np.array([value.get(i) for i in range(3)])


if __name__ == "__main__":
    sys.exit(main())
