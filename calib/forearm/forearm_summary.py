"""The forearm's axes in the IMU by a held pose and by motion: where they agree, and what broke if not."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from smoother.calibration import ArmCalibration, Length

from ..file import CalibrationFile
from ..protocol import Answer, Verdict
from .forearm_frame import forearm_frame
from .held_pose import PLACED_SIGMA_RAD, ForearmCalibration

#: Farther apart than this many sigmas is treated as disagreement.
AGREE = 2.5
#: The pose asked for: arms about across the camera's ray, the sensor still, rad and rad/s.
CORONAL_RAD = np.radians(35.0)
RESTLESS_RAD_S = 0.12

#: What to look at when a measure of the pose and of the motion contradict each other.
_BROKEN = {
    "upper arm": "shoulder or elbow is placed differently in the pose than in motion (a sleeve, a shrugged"
    " shoulder)",
    "forearm": "the camera places elbow or wrist differently in the pose than in motion (the arm pointed"
    " to the camera)",
    "strap to wrist": "the strap slid along the arm between the pose and the motion, or its place was"
    " measured wrongly",
    "strap to elbow": "the strap slid along the arm between the pose and the motion, or its place was"
    " measured wrongly",
    "radius": "the forearm is not straight, or the strap was found beside the arm",
    "direction": "the sensor turned on the arm between the pose and the motion, or the arm was not still"
    " in the pose",
    "roll": "the palm did not face the camera in the pose, or the sensor does not sit on the back of the"
    " wrist",
}


@dataclass(frozen=True)
class Compared:
    """One measure by the pose and by the motion."""

    name: str  # What it is, and the unit of the numbers
    unit: str  # What it is, and the unit of the numbers
    pose: float  # Its value by either
    pose_sigma: float  # Their standard deviations
    motion: float  # Its value by either
    motion_sigma: float  # Their standard deviations

    @property
    def apart(self) -> float:
        """Difference in sigmas of both."""
        return abs(self.pose - self.motion) / float(np.hypot(self.pose_sigma, self.motion_sigma))

    @property
    def agrees(self) -> bool:
        """Whether the two can both be right."""
        return self.apart < AGREE


def compare(calibration: ForearmCalibration) -> list[Compared]:
    """Every measure that both the pose and the motion showed; empty where the motion showed nothing."""
    if calibration.motion is None:
        return []
    m, motion, rows = calibration.measured, calibration.motion, []
    if motion.upper_arm is not None:
        rows.append(_lengths("upper arm", m.upper_arm, motion.upper_arm))
    frame = forearm_frame(motion)
    if frame is None:
        return rows

    def along(joint: str, sign: float) -> Length:
        lever = motion.lever_arms[joint]
        sigma = float(np.linalg.norm(lever.sigma_m * frame.direction))
        return Length(sign * float(lever.position_m @ frame.direction), sigma)

    rows += [
        _lengths("forearm", m.forearm, Length(frame.length_m, frame.length_sigma_m)),
        _lengths("strap to wrist", m.strap_to_wrist, along("wrist", 1.0)),
        _lengths("strap to elbow", m.strap_to_elbow, along("elbow", -1.0)),
        _lengths("radius", m.radius, Length(frame.distance_m, frame.distance_sigma_m)),
    ]
    R_F_A = calibration.calibration.R_F_A
    if R_F_A is None:
        return rows
    y = R_F_A.T @ [0.0, 1.0, 0.0]
    tilt = float(np.degrees(np.arccos(np.clip(y @ frame.direction, -1, 1))))
    # an angle between two directions that are each uncertain about two axes
    both = np.degrees(np.hypot(calibration.direction_sigma_rad, frame.direction_sigma_rad))
    rows.append(Compared("direction", "degrees", tilt, float(both), 0.0, 0.0))
    if frame.R_F_A is not None:
        x = R_F_A @ frame.R_F_A.T @ [1.0, 0.0, 0.0]  # the motion's x in the pose's {F}
        roll = float(np.degrees(np.arctan2(-x[2], x[0])))
        own = float(np.degrees(np.hypot(frame.roll_sigma_rad, PLACED_SIGMA_RAD)))
        rows.append(
            Compared("roll", "degrees", 0.0, float(np.degrees(calibration.roll_sigma_rad)), roll, own)
        )
    return rows


def forearm_answer(calibration: ForearmCalibration) -> Answer:
    """Lever arms, measures and mounting in the form that every calibration answers in."""
    rows = compare(calibration)
    arm, measures = without_wrong_axes(calibration.calibration, rows), calibration.measured.lengths
    sentences, left_open = verdict(calibration, rows), open_questions(calibration)
    if arm.R_F_A is None and calibration.calibration.R_F_A is not None:
        left_open.append("R_F_A is not written: pose and motion contradict each other")
    sigma_deg = {
        "direction": float(np.degrees(calibration.direction_sigma_rad)),
        "roll": float(np.degrees(calibration.roll_sigma_rad)),
    }
    table: dict[str, Any] = {"strap_from": calibration.measured.strap_from}
    for name, length in measures.items():
        table |= {f"{name}_m": float(length.value_m), f"{name}_sigma_m": float(length.sigma_m)}
    if arm.R_F_A is not None:
        table |= {f"R_F_A_{name}_sigma_deg": value for name, value in sigma_deg.items()}
    grade = "not good enough" if arm.R_F_A is None else "usable"
    if rows and all(row.agrees for row in rows):
        grade = "good"
    return Answer(
        verdict=Verdict(
            grade, sentences[1], (sentences[0], *sentences[2:]), tuple(next_time(calibration, rows))
        ),
        open_questions=tuple(left_open),
        table=CalibrationFile().with_arm(arm).with_table("forearm", {arm.side or "any": table}),
        figures={
            "side": arm.side,
            "pose": {
                "from_s": calibration.pose.start_s,
                "to_s": calibration.pose.end_s,
                "chosen": calibration.pose.chosen,
            },
            "measures": {name: asdict(length) for name, length in measures.items()},
            "strap_from": calibration.measured.strap_from,
            "lever_arms": {joint: asdict(lever) for joint, lever in arm.lever_arms.items()},
            "R_F_A": arm.R_F_A,
            "R_F_A_sigma_deg": sigma_deg,
            "against_motion": [
                {
                    "measure": row.name,
                    **{key: value for key, value in asdict(row).items() if key != "name"},
                    "sigmas_apart": row.apart,
                    "agrees": row.agrees,
                }
                for row in rows
            ],
            "verdict": sentences,
            "not_determined": left_open,
        },
    )


def without_wrong_axes(arm: ArmCalibration, rows: list[Compared]) -> ArmCalibration:
    """The arm without the forearm's axes where the motion has them otherwise: one of both is wrong."""
    wrong = any(row.name in ("direction", "roll") and not row.agrees for row in rows)
    return replace(arm, R_F_A=None) if wrong else arm


def verdict(calibration: ForearmCalibration, rows: list[Compared]) -> list[str]:
    """Whether pose and motion agree, and which assumption broke."""
    pose = calibration.pose
    said = [f"the pose was held from {pose.start_s:.1f} to {pose.end_s:.1f} s"]
    if not rows:
        why = calibration.why_not or "the motion did not show the forearm"
        return [*said, f"there is no motion to compare it with: {why}"]
    broken = [row for row in rows if not row.agrees]
    if not broken:
        return [*said, f"pose and motion agree in all {len(rows)} measures within their sigmas"]
    said.append(f"pose and motion agree in {len(rows) - len(broken)} of {len(rows)} measures")
    return said + [
        f"{row.name}: {row.pose:.0f} {row.unit} in the pose, {row.motion:.0f} in motion, {row.apart:.1f}"
        f" sigmas apart: {_BROKEN[row.name]}"
        for row in broken
    ]


def open_questions(calibration: ForearmCalibration) -> list[str]:
    """What the pose left open, one sentence each."""
    said = []
    if calibration.calibration.R_F_A is None:
        said.append(
            "lever arms and R_F_A are not determined: the sensor's orientation in the pose is not known"
            f" ({calibration.why_not})"
        )
    if calibration.measured.strap_from == "usual":
        said.append(
            "the strap's place was neither seen nor measured: usual values are used (5 +- 2 cm to the"
            " wrist, 3.5 +- 0.8 cm to the forearm's axis)"
        )
    if calibration.pose.turning_rad_s > RESTLESS_RAD_S:
        said.append(
            f"the sensor turned by {np.degrees(calibration.pose.turning_rad_s):.0f} degrees/s in the pose"
        )
    y, middle = calibration.R_K_F[:, 1], calibration.pose.position[1]
    towards = float(np.abs(y @ middle) / np.linalg.norm(middle))
    if towards > np.sin(CORONAL_RAD):
        said.append(
            f"the forearm points {np.degrees(np.arcsin(towards)):.0f} degrees towards or away from the"
            " camera: depth errors are in its length"
        )
    return said


def next_time(calibration: ForearmCalibration, rows: list[Compared]) -> list[str]:
    """What to record next, one sentence each."""
    said = []
    if calibration.calibration.R_F_A is None:
        said.append(
            "after the pose, move for 20 s in view: bend and stretch the elbow, turn the palm up and down"
        )
    if calibration.measured.strap_from == "usual":
        said.append(
            "measure by ruler from the middle of the strap to the wrist's crease and half the wrist's"
            " thickness (--strap-to-wrist-m, --radius-m), or record the camera's images and use `unocclude"
            " import strap`"
        )
    if any(row.name == "roll" and not row.agrees for row in rows):
        said.append("hold the palm square to the camera, and put the sensor on the back of the wrist")
    if calibration.pose.end_s - calibration.pose.start_s < 2.0:
        said.append("hold the pose for three seconds")
    return said or ["record in the same way: nothing is missing"]


def _lengths(name: str, pose: Length, motion: Length) -> Compared:
    in_mm = (1e3 * value for value in (pose.value_m, pose.sigma_m, motion.value_m, motion.sigma_m))
    return Compared(name, "mm", *in_mm)
