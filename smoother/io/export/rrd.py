"""A result as a recording of Rerun: arms in space, as curves, and the views that show them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...angles import JointAngle, JointAngles
from ...angles.definitions import ELBOW_FLEXION
from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import UnoccludeError
from ...linalg import median_rate_hz
from ...recording import JOINTS, JointState, JointTracks
from ...result import Recovery
from ...result.frame_residuals import BATCH_ROWS
from ...result.untrusted import untrusted_sentences
from ...runtime.outputs import writing
from ...runtime.packages import extra_module
from ..result.drawing import ANSWER, CAMERA, CHAIN, DISTRUST, GUESSED, VISIBLE, Color, common_down, world_axes

TIMELINE = "time"
#: Pictures a second in space, and points of the shoulder's and the forearm's angles; other curves have every
#: sample.
PICTURES_HZ = 30.0
_NAMES = [JOINTS[i] for i in CHAIN]
#: Of bones and joints, m.
_BONE_M, _JOINT_M, _THIN_M, _TRAIL_M = 0.010, 0.016, 0.004, 0.004
_AXES = "xyz"
_AXIS_COLORS = np.array([0xE0483DFF, 0x4CAF50FF, 0x4F7FE8FF], np.uint32)
#: Of the curves of several arms.
ARM_COLORS: dict[str, Color] = {
    "blue": VISIBLE,
    "pink": (0.80, 0.47, 0.65, 1.0),
    "yellow": (0.94, 0.75, 0.20, 1.0),
    "white": (0.90, 0.90, 0.90, 1.0),
}
_STATES = ("seen", "occluded", "not to be trusted", "no answer")


class RerunArm:
    """What is logged of one arm, batch by batch."""

    def __init__(self, rr: Any, recovery: Recovery, name: str, number: int | None = None):
        self.rr = rr
        self.recovery = recovery
        self.name = name
        self.label = "" if number is None else f"{name} "
        self.color_name = list(ARM_COLORS)[(number or 0) % len(ARM_COLORS)]
        self.color = ARM_COLORS[self.color_name]
        self.space = f"scene/camera/{name}"
        joints = recovery.joints
        #: The point whose place and sigma are shown.
        self.point = "wrist" if "wrist" in joints else "imu"
        self._angles = JointAngles(recovery)
        #: Joint angles that are known anywhere.
        self.angles = self._known_angles()
        rate = median_rate_hz(recovery.t_s)
        self.step = max(round(rate / PICTURES_HZ), 1) if np.isfinite(rate) else 1

    def log(self, stream: Any) -> None:
        """All of it."""
        self.stream = stream
        self._styles()
        for start in range(0, len(self.recovery), BATCH_ROWS):
            batch = self.recovery.rows(slice(start, start + BATCH_ROWS))
            some = batch.rows(np.arange(-start % self.step, len(batch), self.step))
            self._in_space(some)
            self._curves(batch)
            self._angle_curves(batch, [ELBOW_FLEXION])
            self._angle_curves(some, [angle for angle in self.angles if angle is not ELBOW_FLEXION])
        for frames in self.recovery.frame_batches():
            self._before(frames)
        self._gaps()

    def _known_angles(self) -> list[JointAngle]:
        known: set[str] = set()
        for batch in self.recovery.batches():
            values, _ = self._angles.at(batch)
            known |= {name for name, angle in values.items() if np.isfinite(angle).any()}
        return [angle for angle in self._angles.angles if angle.name in known]

    def point_of(self, batch: Recovery) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3) and covariances (n, 3, 3) of the shown point."""
        if self.point in batch.joints:
            return batch.joints[self.point], batch.joint_covariance[self.point]
        return batch.position, batch.pose_covariance[:, :3, :3]

    def _in_space(self, batch: Recovery) -> None:
        """The arm, its uncertainty and the trail."""
        rr = self.rr
        places = np.full((len(batch), len(_NAMES) + 1, 3), np.nan)
        for place, joint in enumerate(_NAMES):
            if joint in batch.joints:
                places[:, place] = batch.joints[joint]
        places[:, -1] = batch.position
        shade = np.array([packed(color) for color in ANSWER])[_kind(batch)]
        self._bones("after", batch.t_s, places[:, :-1], shade, _BONE_M)
        self._dots("after/joints", batch.t_s, places, np.repeat(shade[:, None], places.shape[1], 1), _JOINT_M)
        point, covariance = self.point_of(batch)
        self._dots("trail", batch.t_s, point[:, None], shade[:, None], _TRAIL_M)
        good = np.isfinite(point).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
        variance, turn = np.linalg.eigh(covariance[good])
        turn[:, :, 2] *= np.sign(np.linalg.det(turn).reshape(-1, 1))
        quaternion = Rotation.from_matrix(turn).as_quat() if len(turn) else np.empty((0, 4))
        columns = rr.Ellipsoids3D.columns(
            half_sizes=2.0 * np.sqrt(np.maximum(variance, 0.0)),
            centers=point[good],
            quaternions=quaternion,
            colors=shade[good] - 0xFF + 0x60,
            fill_mode=[rr.components.FillMode.TransparentFillMajorWireframe] * int(good.sum()),
        )
        self._send("two_sigma", batch.t_s, columns.partition(good.astype(int)))

    def _before(self, frames: JointTracks) -> None:
        """The camera's joints."""
        has = (frames.state != JointState.NOT_TRACKED) & np.isfinite(frames.position).all(axis=2)
        places = np.where(has[:, :, None], frames.position, np.nan)
        guessed = frames.state == JointState.INFERRED
        shades = np.where(guessed, packed(GUESSED), packed(CAMERA))
        grey = np.full(len(frames), packed(CAMERA))
        self._bones("before", frames.t_s, places[:, CHAIN], grey, _THIN_M)
        self._dots("before/joints", frames.t_s, places, shades, _JOINT_M / 2)
        if self.point == "wrist":
            wrist = JOINTS.index("wrist")
            for axis, name in enumerate(_AXES):
                self._curve(f"wrist_{name}", "camera", frames.t_s, places[:, wrist, axis : axis + 1])

    def _curves(self, batch: Recovery) -> None:
        """Place with its 2 sigma lines, and sigma, at every sample."""
        point, covariance = self.point_of(batch)
        sigma = np.sqrt(np.einsum("nii->ni", covariance))
        for axis, name in enumerate(_AXES):
            self._curve(f"{self.point}_{name}", "after", batch.t_s, point[:, axis : axis + 1])
            band = point[:, axis, None] + 2.0 * sigma[:, axis, None] * np.array([-1.0, 1.0])
            self._curve(f"{self.point}_{name}", "two_sigma", batch.t_s, band)
        self._curve("sigma", "", batch.t_s, 100.0 * sigma)

    def _angle_curves(self, batch: Recovery, angles: Sequence[JointAngle]) -> None:
        """Joint angles with their 2 sigma lines, those that are known anywhere."""
        values, sigmas = self._angles.at(batch)
        for name in (angle.name for angle in angles if angle in self.angles):
            value = broken_at_turns(values[name])[:, None]
            self._curve(name, "after", batch.t_s, value)
            band = value + 2.0 * sigmas[name][:, None] * np.array([-1.0, 1.0])
            self._curve(name, "two_sigma", batch.t_s, band)

    def _gaps(self) -> None:
        """Seen, occluded, not to be trusted or without an answer, where it changes."""
        states = np.where(self.recovery.answered, _kind(self.recovery), np.int8(len(ANSWER)))
        turns = np.flatnonzero(np.diff(states, prepend=-1))
        names = [_STATES[state] for state in states[turns]]
        columns = self.rr.StateChange.columns(state=names)
        time = self.rr.TimeColumn(TIMELINE, duration=self.recovery.t_s[turns])
        self.stream.send_columns(f"gaps/{self.name}", [time], columns)

    def _styles(self) -> None:
        """How curves and states look; the same at all times."""
        rr = self.rr
        log, curves = self.stream.log, [f"{self.point}_{axis}" for axis in _AXES]
        curves += [angle.name for angle in self.angles]
        after, faint = packed(self.color), packed((*self.color[:3], 0.45))
        for curve in curves:
            of = f"curves/{curve}/{self.name}"
            log(
                f"{of}/after",
                rr.SeriesLines(colors=[after], widths=[2.0], names=[f"{self.label}after"]),
                static=True,
            )
            lines = rr.SeriesLines(
                colors=[faint] * 2, widths=[1.0] * 2, names=[f"{self.label}{sign} 2 sigma" for sign in "-+"]
            )
            log(f"{of}/two_sigma", lines, static=True)
            if curve.startswith("wrist"):
                dots = rr.SeriesPoints(
                    colors=[packed(CAMERA)], marker_sizes=[1.5], names=[f"{self.label}camera"]
                )
                log(f"{of}/camera", dots, static=True)
        names = [f"{self.label}{self.point} {axis}" for axis in _AXES]
        lines = rr.SeriesLines(names=names, widths=[1.5] * 3, colors=_AXIS_COLORS)
        log(f"curves/sigma/{self.name}", lines, static=True)
        colors = np.array([packed(color) for color in (*ANSWER, GUESSED)], np.uint32)
        log(f"gaps/{self.name}", rr.StateConfiguration(values=_STATES, colors=colors), static=True)

    def _bones(self, path: str, t_s: FloatArray, places: FloatArray, shade: IntArray, radius: float) -> None:
        """A line through the joints (n, J, 3) that are there; nothing where it is less than two."""
        has: BoolArray = np.asarray(np.isfinite(places).all(axis=2))
        drawn = has.sum(axis=1) > 1
        strips = [places[row][has[row]] for row in np.flatnonzero(drawn)]
        columns = self.rr.LineStrips3D.columns(
            strips=strips, colors=shade[drawn], radii=np.full(len(strips), radius)
        )
        self._send(path, t_s, columns.partition(drawn.astype(int)))

    def _dots(self, path: str, t_s: FloatArray, places: FloatArray, shade: IntArray, radius: float) -> None:
        """Points (n, J, 3) where they are there."""
        has: BoolArray = np.asarray(np.isfinite(places).all(axis=2))
        columns = self.rr.Points3D.columns(
            positions=places[has], colors=shade[has], radii=np.full(int(has.sum()), radius)
        )
        self._send(path, t_s, columns.partition(has.sum(axis=1)))

    def _curve(self, curve: str, line: str, t_s: FloatArray, values: FloatArray) -> None:
        """Values (n, lines); nan breaks a line."""
        path = "/".join(part for part in ("curves", curve, self.name, line) if part)
        columns = self.rr.Scalars.columns(scalars=values.ravel())
        time = self.rr.TimeColumn(TIMELINE, duration=t_s)
        self.stream.send_columns(path, [time], columns.partition(np.full(len(values), values.shape[1])))

    def _send(self, path: str, t_s: FloatArray, columns: Any) -> None:
        if len(t_s):
            time = self.rr.TimeColumn(TIMELINE, duration=t_s)
            self.stream.send_columns(f"{self.space}/{path}", [time], columns)


def broken_at_turns(angle: FloatArray) -> FloatArray:
    """Angles (n,), degrees, with nan where a curve would run from 180 to -180."""
    jumps = np.abs(np.diff(angle, prepend=angle[:1])) > 180.0
    return np.where(jumps, np.nan, angle)


def _kind(batch: Recovery) -> NDArray[np.int8]:
    """(n,) which of the colours of the answer a sample has."""
    return np.where(batch.trusted, batch.occluded.astype(np.int8), np.int8(DISTRUST))


def packed(color: Color) -> int:
    """A colour as 0xRRGGBBAA."""
    red, green, blue, alpha = (round(255 * part) for part in color)
    return red << 24 | green << 16 | blue << 8 | alpha


def middle_and_radius(arms: list[RerunArm]) -> tuple[FloatArray, float]:
    """The middle (3,) of what is drawn, in the camera's axes, and the radius about it that contains it, m."""
    drawn = []
    for arm in arms:
        for places in (*arm.recovery.joints.values(), arm.recovery.position):
            rows = places[:: max(len(places) // 1000, 1)]
            drawn.append(rows[np.isfinite(rows).all(axis=1)])
    places = np.concatenate(drawn)
    middle = np.median(places, axis=0)
    return middle, float(np.percentile(np.linalg.norm(places - middle, axis=1), 98))


#: How far back the trail reaches, s.
TRAIL_S = 2.0
#: Direction from the arm to the eye, in the level frame: before the person, to one side, above.
_EYE = np.array([0.80, -0.52, 0.30])
#: Distance of the eye, in radii of what is drawn, and at the least, m.
_FAR, _NEAR_M = 1.45, 0.7


def views(rr: Any, arms: list[RerunArm], R_W_K: FloatArray, upright: bool) -> Any:  # R_W_K (3, 3)
    """The blueprint: the arm in space and its gaps on the left, curves on the right."""
    rrb = rr.blueprint
    curves = [(f"{point}_{axis}", f"{point} {axis}, m") for point in _points(arms) for axis in "xyz"]
    angles = {angle.name: f"{angle.title}, degrees" for arm in arms for angle in arm.angles}
    curves += list(angles.items())[:1]
    curves.append(("sigma", "sigma, cm"))
    others = list(angles.items())[1:]
    whose = ", ".join(f"{arm.color_name}: {arm.name}" for arm in arms) if len(arms) > 1 else ""

    def plot(path: str, name: str) -> Any:
        return rrb.TimeSeriesView(
            origin=f"curves/{path}",
            name=f"{name} ({whose})" if whose and path != "sigma" else name,
            axis_x=rrb.TimeAxis(view_range=whole_recording(rr), zoom_lock=False),
            axis_y=rrb.ScalarAxis(range=(0.0, 1.1 * top_sigma_cm(arms))) if path == "sigma" else None,
            plot_legend=rrb.PlotLegend("RightTop", visible=path == "sigma" and len(arms) == 1),
        )

    plots = rrb.Vertical(*[plot(*curve) for curve in curves], name="place")
    if others:
        more = rrb.Vertical(*[plot(*curve) for curve in others], name="joint angles")
        plots = rrb.Tabs(plots, more)
    gaps = rrb.StateTimelineView(origin="gaps", name="gaps")
    notes = rrb.TextDocumentView(origin="notes", name="notes")
    left = rrb.Vertical(_space(rr, arms, R_W_K, upright), rrb.Tabs(gaps, notes), row_shares=[4, 1])
    return rrb.Blueprint(
        rrb.Horizontal(left, plots, column_shares=[1, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
    )


def whole_recording(rr: Any) -> Any:
    """A range of times from the first to the last, wherever the cursor is."""
    return rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())


def top_sigma_cm(arms: list[RerunArm]) -> float:
    """The largest sigma of any axis that is shown; its curve begins at zero."""
    tops = []
    for arm in arms:
        for batch in arm.recovery.batches():
            variance = np.einsum("nii->ni", arm.point_of(batch)[1])
            tops.append(np.max(variance[np.isfinite(variance)], initial=0.0))
    return max(100.0 * float(np.sqrt(max(tops, default=0.0))), 0.1)


def _points(arms: list[RerunArm]) -> list[str]:
    return list(dict.fromkeys(arm.point for arm in arms))


def _space(rr: Any, arms: list[RerunArm], R_W_K: FloatArray, upright: bool) -> Any:
    rrb = rr.blueprint
    place, radius = middle_and_radius(arms)
    middle = R_W_K @ place
    trail = rr.VisibleTimeRange(
        TIMELINE,
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
    eye = None
    if upright:
        there = middle + max(_FAR * radius, _NEAR_M) * _EYE
        eye = rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=there, look_target=middle, eye_up=[0, 0, 1]
        )
    return rrb.Spatial3DView(
        origin="scene",
        name="blue: seen, orange: recovered, dark red: not to be trusted, grey: the camera's",
        overrides={f"{arm.space}/trail": rrb.VisibleTimeRanges(trail) for arm in arms},
        eye_controls=eye,
    )


def rerun_module() -> ModuleType:
    """The package `rerun`, an extra."""
    return extra_module("rerun", "rerun-sdk", "view", ["StateChange"], ["blueprint"])


def check_rrd(recoveries: Sequence[Recovery]) -> None:
    """Refuse what could not be shown, before any work is done for it."""
    rerun_module()
    if not any(recovery.answered.any() for recovery in recoveries):
        raise UnoccludeError(f"{recoveries[0].name}: there is no answer at any time, and nothing to show")


def write_rrd(
    recoveries: Sequence[Recovery],
    path: str | os.PathLike[str],
    *,
    level_down: FloatArray | None = None,  # (3,)
    force: bool = False,
) -> None:
    """Write all arms of a result into one file of Rerun."""
    rr = rerun_module()
    results = list(recoveries)
    check_rrd(results)
    down = common_down(results, level_down)
    R_W_K = np.eye(3) if down is None else world_axes(down)
    arms = [
        RerunArm(rr, recovery, name, number if len(results) > 1 else None)
        for number, (recovery, name) in enumerate(zip(results, _names(results), strict=True))
    ]
    with writing(path, force) as temporary:
        stream = rr.RecordingStream("unocclude", recording_id=_identity(results), send_properties=False)
        stream.save(str(temporary), default_blueprint=views(rr, arms, R_W_K, upright=down is not None))
        stream.send_recording_name(results[0].name)
        upright = rr.ViewCoordinates.RIGHT_HAND_Z_UP
        if down is not None:
            stream.log("scene", upright, static=True)
        stream.log("scene/camera", rr.Transform3D(mat3x3=R_W_K), static=True)
        stream.log("notes", rr.TextDocument(_notes(results), media_type="text/markdown"), static=True)
        for arm in arms:
            arm.log(stream)
        stream.flush()
        stream.disconnect()


def _names(recoveries: Sequence[Recovery]) -> list[str]:
    """Side of each arm, with a number where sides do not distinguish them."""
    sides = [recovery.side or "arm" for recovery in recoveries]
    return [side if sides.count(side) == 1 else f"{side}_{number + 1}" for number, side in enumerate(sides)]


def _identity(recoveries: Sequence[Recovery]) -> str:
    """The same for the same recording: Rerun shows a file that was made anew in place of the older one."""
    text = "|".join(f"{each.name} {each.side} {each.origin_ns} {len(each)}" for each in recoveries)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _notes(recoveries: Sequence[Recovery]) -> str:
    lines = []
    for recovery in recoveries:
        side = f"{recovery.side} arm, " if recovery.side else ""
        lines += [f"### {recovery.name}: {side}{recovery.method}", recovery.estimates.verdict]
        lines += [f"- Not to be trusted: {each}" for each in untrusted_sentences(recovery)]
        if (check := recovery.estimates.self_check) is not None:
            lines.append(check.sentence)
        lines += [f"- {note}" for note in recovery.notes]
    lines.append("Blue: the camera saw the forearm. Orange: recovered. Grey: the camera's own joints.")
    lines.append("Dark red: the answer is not to be trusted.")
    lines.append("Ellipsoid: 2 sigma. Trail: 2 s.")
    return "\n\n".join(line for line in lines if line)
