"""A model of the arm for OpenSim, whose markers are named as those of our TRC files."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...linalg import unit
from ...result import Recovery
from ...runtime.outputs import writing

#: This many samples are as informative as all.
_SAMPLES = 4000


@dataclass(frozen=True)
class ArmMeasures:
    """What a model of an arm is scaled by.

    Attributes
    ----------
    side : str
        "left" or "right"; "" is treated as right.
    upper_m, forearm_m : float, m
        Shoulder to elbow, elbow to wrist.
    places : dict of str to ndarray, shape (3,), m
        Of `hand` and `imu` from the elbow, as a right arm has them: y along the bone towards the elbow, z
        towards the thumb, x = y cross z. What a recovery does not have is left out.
    turns : bool
        The forearm's axes are known, so that its pronation is.
    imus : dict of str to ndarray, shape (3, 3)
        By body (`radius`, `humerus`) the rotation from the axes of its IMU to the body's, as OpenSim has
        them; of those whose mounting is known.
    """

    side: str
    upper_m: float
    forearm_m: float
    places: dict[str, FloatArray]
    turns: bool
    imus: dict[str, FloatArray] = field(default_factory=dict)


def arm_measures(recovery: Recovery) -> ArmMeasures:
    """Measure the arm of a recovery: medians over its samples.

    Parameters
    ----------
    recovery : Recovery
        With shoulder, elbow and wrist.

    Returns
    -------
    ArmMeasures

    Raises
    ------
    UnoccludeError
        A joint is missing, or they are never all there.
    """
    missing = [joint for joint in ("shoulder", "elbow", "wrist") if joint not in recovery.joints]
    if missing:
        raise UnoccludeError(
            f"{recovery.name}: a model of the arm needs shoulder, elbow and wrist, and it has no"
            f" {', no '.join(missing)}; export to csv, trc, c3d or parquet"
        )
    rows = recovery.rows(slice(0, None, max(len(recovery) // _SAMPLES, 1)))
    shoulder, elbow, wrist = (rows.joints[joint] for joint in ("shoulder", "elbow", "wrist"))
    upper, fore = np.linalg.norm(elbow - shoulder, axis=1), np.linalg.norm(wrist - elbow, axis=1)
    if not np.isfinite(upper + fore).any():
        raise UnoccludeError(f"{recovery.name}: shoulder, elbow and wrist are never all there at once")
    places, axes = _forearm(rows)
    imus = {}
    if axes is not None:
        imus["radius"] = _mirror(recovery.side) @ _QUARTER @ axes
    calibration = recovery.calibration
    if recovery.upper is not None and calibration is not None and calibration.R_U_B is not None:
        # of a left arm z, from the medial to the lateral epicondyle, points to the left
        to_body = np.diag([-1.0, 1.0, -1.0]) if recovery.side == "left" else np.eye(3)
        imus["humerus"] = to_body @ calibration.R_U_B
    lengths_m = float(np.nanmedian(upper)), float(np.nanmedian(fore))
    return ArmMeasures(recovery.side, *lengths_m, places, axes is not None, imus)


#: `pro_sup` counts from the thumb up, a quarter turn from the axes in which the places are stated.
_QUARTER = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def _mirror(side: str) -> FloatArray:
    """What makes a right arm one of the side, (3, 3)."""
    return np.diag([1.0, 1.0, -1.0 if side == "left" else 1.0])


def _forearm(rows: Recovery) -> tuple[dict[str, FloatArray], FloatArray | None]:
    """Places from the elbow, and their axes in the IMU's (3, 3); None where its mounting is not known."""
    known = np.isfinite(rows.quaternion).all(axis=1) & np.isfinite(rows.position).all(axis=1)
    if not known.any():
        return {}, None
    R_A_K = Rotation.from_quat(rows.quaternion[known], scalar_first=True).inv()

    def in_imu(values: FloatArray) -> FloatArray:
        return np.asarray(np.nanmedian(R_A_K.apply(values[known] - rows.position[known]), axis=0))

    levers = {joint: in_imu(rows.joints[joint]) for joint in ("elbow", "wrist")}
    if "hand" in rows.joints and np.isfinite(rows.joints["hand"][known]).any():
        levers["hand"] = in_imu(rows.joints["hand"])
    mounting = None if rows.calibration is None else rows.calibration.R_F_A
    y = unit(levers["elbow"] - levers["wrist"])
    if mounting is None:  # the hand lies along the bone; how the IMU lies about it is not known
        along = {"hand": levers["hand"]} if "hand" in levers else {}
        return {name: np.array([0.0, (at - levers["elbow"]) @ y, 0.0]) for name, at in along.items()}, None
    hand_of = -1.0 if rows.side == "left" else 1.0
    thumb = hand_of * np.asarray(mounting)[2]
    x = hand_of * unit(np.cross(y, thumb))
    axes = np.stack([x, y, hand_of * np.cross(x, y)])
    levers["imu"] = np.zeros(3)
    places: dict[str, FloatArray] = {
        name: axes @ (levers[name] - levers["elbow"]) for name in ("hand", "imu") if name in levers
    }
    return places, axes


#: `data/arm.osim`: a right arm of an adult's lengths, the IMU on the back of the wrist.
GENERIC = ArmMeasures(
    side="right",
    upper_m=0.30,
    forearm_m=0.25,
    places={"hand": np.array([0.0, -0.33, 0.0]), "imu": np.array([-0.03, -0.20, 0.0])},
    turns=True,
)
_HALF_TURN = 3.141592653589793
_RADII_M = {"humerus": 0.035, "radius": 0.027}


def write_osim(
    measures: ArmMeasures, path: str | os.PathLike[str], name: str = "arm", force: bool = False
) -> None:
    """Write the model.

    Parameters
    ----------
    measures : ArmMeasures
        What it is scaled by.
    path : path-like
        The file to write.
    name : str
        Of the model.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    with writing(path, force) as temporary:
        temporary.write_text(osim_text(measures, name), encoding="utf-8", newline="\n")


def osim_text(
    measures: ArmMeasures, name: str = "arm", free: Collection[str] = (), camera: bool = False
) -> str:
    """The model as OpenSim 4 reads it.

    A base that moves freely (its turns locked: an arm does not show the thorax), the shoulder with the
    coordinates of MoBL-ARMS (Saul et al., Comput Methods Biomech Biomed Engin 18:1445, 2015; the fourth,
    `elv_back`, undoes the plane of elevation), a hinge at the elbow, and the forearm turning about its
    bone. Axes as OpenSim has them: x forward, y up, z to the right. A left arm is the mirror image of a
    right one with the same angles. Masses are of a gram: the model is for motion, not for forces.

    Parameters
    ----------
    measures : ArmMeasures
        Lengths and places.
    name : str
        Of the model.
    free : collection of str
        Markers whose places OpenSim's Scale may change.
    camera : bool
        With a marker `camera` at the ground's origin.

    Returns
    -------
    text : str
    """
    mirror = np.array([1.0, 1.0, -1.0 if measures.side == "left" else 1.0])
    # The axis of a turn is mirrored with its sense, so that the same angle is the same posture.
    x, y, z = (-mirror * axis if mirror[2] < 0 else axis for axis in np.eye(3))
    elbow = np.array([0.0, -measures.upper_m, 0.0])
    wrist = np.array([0.0, -measures.forearm_m, 0.0])
    bodies = [
        _body("shoulder_base", 0.0),
        _body("shoulder_plane", 0.0),
        _body("shoulder_elevation", 0.0),
        _body("humerus", measures.upper_m, measures.imus.get("humerus")),
        _body("ulna", 0.0),
        _body("radius", measures.forearm_m, measures.imus.get("radius")),
    ]
    joints = [
        _base(),
        _joint(
            "plane", "shoulder_base", "shoulder_plane", [("elv_angle", y, (-_HALF_TURN, _HALF_TURN), 0.0)]
        ),
        _joint(
            "elevation",
            "shoulder_plane",
            "shoulder_elevation",
            [
                ("shoulder_elv", -x, (0.0, _HALF_TURN), 0.5),
                ("elv_back", y, (-_HALF_TURN, _HALF_TURN), 0.0),
            ],
        ),
        _joint(
            "rotation",
            "shoulder_elevation",
            "humerus",
            [("shoulder_rot", y, (-_HALF_TURN, _HALF_TURN), 0.0)],
        ),
        _joint("elbow", "humerus", "ulna", [("elbow_flexion", z, (0.0, _HALF_TURN), 1.2)], elbow),
        _joint(
            "forearm",
            "ulna",
            "radius",
            [("pro_sup", y, (-_HALF_TURN, _HALF_TURN), 0.0)],
            locked=not measures.turns,
        ),
    ]
    markers = [
        _marker("shoulder", "shoulder_base", np.zeros(3)),
        _marker("elbow", "humerus", elbow),
        _marker("wrist", "radius", wrist),
    ]
    markers += [
        _marker(marker, "radius", mirror * (_QUARTER @ place), marker not in free)
        for marker, place in measures.places.items()
    ]
    if camera:
        markers.append(_marker("camera", "", np.zeros(3)))
    return _MODEL.format(
        name=_escaped(name), bodies="".join(bodies), joints="".join(joints), markers="".join(markers)
    )


_MODEL = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000">
<Model name="{name}">
<Ground name="ground" />
<gravity>0 -9.80665 0</gravity>
<length_units>meters</length_units>
<force_units>N</force_units>
<BodySet name="bodyset"><objects>
{bodies}</objects></BodySet>
<JointSet name="jointset"><objects>
{joints}</objects></JointSet>
<ConstraintSet name="constraintset"><objects>
<CoordinateCouplerConstraint name="elv_back_follows">
<coupled_coordinates_function>
<LinearFunction><coefficients>-1 0</coefficients></LinearFunction>
</coupled_coordinates_function>
<independent_coordinate_names>elv_angle</independent_coordinate_names>
<dependent_coordinate_name>elv_back</dependent_coordinate_name>
</CoordinateCouplerConstraint>
</objects></ConstraintSet>
<MarkerSet name="markerset"><objects>
{markers}</objects></MarkerSet>
</Model>
</OpenSimDocument>
"""


def _body(name: str, length_m: float, R_imu: FloatArray | None = None) -> str:
    """A body of a gram; a cylinder along its bone, and the frame of its IMU, where it has one."""
    parts = ""
    if length_m:
        parts = (
            f'<PhysicalOffsetFrame name="{name}_middle"><attached_geometry>'
            f'<Cylinder name="{name}_bone"><socket_frame>..</socket_frame>'
            f"<radius>{_RADII_M[name]:g}</radius><half_height>{length_m / 2:.6f}</half_height></Cylinder>"
            f"</attached_geometry><socket_parent>..</socket_parent>"
            f"<translation>0 {-length_m / 2:.6f} 0</translation></PhysicalOffsetFrame>"
        )
    if R_imu is not None:
        angles = Rotation.from_matrix(R_imu).as_euler("XYZ")
        parts += (
            f'<PhysicalOffsetFrame name="{name}_imu"><socket_parent>..</socket_parent>'
            f"<translation>0 {-length_m:.6f} 0</translation><orientation>{_numbers(angles)}</orientation>"
            "</PhysicalOffsetFrame>"
        )
    drawn = f"<components>{parts}</components>\n" if parts else ""
    return (
        f'<Body name="{name}">\n{drawn}<mass>0.001</mass><mass_center>0 0 0</mass_center>'
        "<inertia>1e-06 1e-06 1e-06 0 0 0</inertia>\n</Body>\n"
    )


def _base() -> str:
    """The shoulder's place in the room, with turns that stay upright unless somebody unlocks them."""
    coordinates = [
        _coordinate(f"base_r{axis}", (-_HALF_TURN, _HALF_TURN), 0.0, locked=True) for axis in "xyz"
    ]
    coordinates += [_coordinate(f"base_t{axis}", (-10.0, 10.0), 0.0) for axis in "xyz"]
    return (
        '<FreeJoint name="base">\n<socket_parent_frame>/ground</socket_parent_frame>'
        "<socket_child_frame>/bodyset/shoulder_base</socket_child_frame>\n"
        f"<coordinates>\n{''.join(coordinates)}</coordinates>\n</FreeJoint>\n"
    )


Turn = tuple[str, FloatArray, tuple[float, float], float]


def _joint(
    name: str, parent: str, child: str, turns: list[Turn], at: FloatArray | None = None, locked: bool = False
) -> str:
    """A joint that turns about one axis or two, at a place (3,) of its parent, m."""
    coordinates = "".join(_coordinate(turn, span, start, locked) for turn, _, span, start in turns)
    axes = [axis for _, axis, _, _ in turns]
    # The axes that do not move may not lie along those that do.
    axes += [axis for axis in np.eye(3) if all(abs(axis @ other) < 0.5 for other in axes)]
    parts = []
    for number in range(3):
        moving = (
            f"<coordinates>{turns[number][0]}</coordinates>" if number < len(turns) else "<coordinates />"
        )
        still = "<Constant><value>0</value></Constant>"
        function = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
        parts.append(
            f'<TransformAxis name="rotation{number + 1}">{moving}<axis>{_numbers(axes[number])}</axis>'
            f"{function if number < len(turns) else still}</TransformAxis>\n"
        )
    parent_frame, frames = f"/bodyset/{parent}", ""
    if at is not None:
        parent_frame = f"{parent}_offset"
        frames = (
            f'<frames><PhysicalOffsetFrame name="{parent_frame}"><socket_parent>/bodyset/{parent}'
            f"</socket_parent><translation>{_numbers(at)}</translation></PhysicalOffsetFrame></frames>\n"
        )
    return (
        f'<CustomJoint name="{name}">\n<socket_parent_frame>{parent_frame}</socket_parent_frame>'
        f"<socket_child_frame>/bodyset/{child}</socket_child_frame>\n"
        f"<coordinates>\n{coordinates}</coordinates>\n{frames}"
        f"<SpatialTransform>\n{''.join(parts)}</SpatialTransform>\n</CustomJoint>\n"
    )


def _coordinate(name: str, span: tuple[float, float], start: float, locked: bool = False) -> str:
    # Bent one way only: the same posture is not met a second time with other angles.
    clamped = name in ("shoulder_elv", "elbow_flexion")
    return (
        f'<Coordinate name="{name}"><default_value>{start:g}</default_value>'
        f"<range>{span[0]:.9g} {span[1]:.9g}</range><clamped>{str(clamped).lower()}</clamped>"
        f"<locked>{str(locked).lower()}</locked></Coordinate>\n"
    )


def _marker(name: str, body: str, place: FloatArray, fixed: bool = True) -> str:
    frame = f"/bodyset/{body}" if body else "/ground"
    return (
        f'<Marker name="{name}"><socket_parent_frame>{frame}</socket_parent_frame>'
        f"<location>{_numbers(place)}</location><fixed>{str(fixed).lower()}</fixed></Marker>\n"
    )


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:.9g}" for value in np.asarray(values) + 0.0)


def _escaped(text: str) -> str:
    from xml.sax.saxutils import quoteattr

    return quoteattr(text)[1:-1]
