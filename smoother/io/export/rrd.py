"""A result as a recording of Rerun: arms in space, as curves, and the views that show them.

Rerun reads our MCAP files too, but shows neither curves nor drawn arms of them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...angles.definitions import ELBOW_FLEXION
from ...array_types import FloatArray, IntArray
from ...errors import UnoccludeError
from ...linalg import median_rate_hz
from ...recording import JOINTS, JointState
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ...runtime.outputs import writing
from ...runtime.packages import extra_module
from ..result.streams import ANSWER, CAMERA, CHAIN, DISTRUST, GUESSED, VISIBLE, Color, common_down, world_axes
from .prepare import Export

TIMELINE = "time"
#: Pictures a second in space, and points of the angles besides the elbow's; other curves have every sample.
PICTURES_HZ = 30.0
#: Of bones and joints, m.
_BONE_M, _JOINT_M, _THIN_M, _TRAIL_M = 0.010, 0.016, 0.004, 0.004
#: How far back the trail reaches, s.
TRAIL_S = 2.0
#: Of the curves of several arms.
ARM_COLORS = {
    "blue": VISIBLE,
    "pink": (0.80, 0.47, 0.65, 1.0),
    "yellow": (0.94, 0.75, 0.20, 1.0),
    "white": (0.90, 0.90, 0.90, 1.0),
}
_STATES = ("seen", "occluded", "not to be trusted", "no answer")
_LEGEND = """Blue: the camera saw the forearm. Orange: recovered. Grey: the camera's own joints.

Dark red: the answer is not to be trusted.

Ellipsoid: 2 sigma. Trail: 2 s."""


def packed(color: Color) -> int:
    """A colour as 0xRRGGBBAA."""
    return int.from_bytes(bytes(round(255 * part) for part in color), "big")


class ArmPicture:
    """One arm, and how it is called and coloured."""

    def __init__(
        self,
        rr: Any,
        stream: Any,
        recovery: Recovery,
        name: str,
        number: int | None,
        is_styled: bool = True,  # the looks of its curves are sent, too
    ):
        self.rr, self.stream, self.recovery, self.name = rr, stream, recovery, name
        self._is_styled = is_styled
        self.color_name = list(ARM_COLORS)[(number or 0) % len(ARM_COLORS)]
        self.label = "" if number is None else f"{name} "
        self.point = "wrist" if "wrist" in recovery.joints else "imu"  # whose place and sigma are shown
        self.places, self.covariance = recovery.position, recovery.pose_covariance[:, :3, :3]
        if self.point == "wrist":
            self.places, self.covariance = recovery.joints["wrist"], recovery.joint_covariance["wrist"]
        table = recovery.angles()
        known = [angle for angle in table.angles if np.isfinite(table.values[angle.name]).any()]
        self.titles = {angle.name: f"{angle.title}, degrees" for angle in known}
        self.angles = {angle.name: (table.values[angle.name], table.sigmas[angle.name]) for angle in known}

    def log(self) -> None:
        """The arm in space and its curves; seen, occluded, not trusted or without an answer."""
        r, look = self.recovery, self.rr.SeriesLines
        kind = np.where(r.trusted, r.occluded.astype(np.int8), np.int8(DISTRUST))
        rate = median_rate_hz(r.t_s) if len(r) > 1 else np.nan
        some = slice(None, None, max(round(rate / PICTURES_HZ), 1) if np.isfinite(rate) else 1)
        self._in_space(r.rows(some), np.array([packed(color) for color in ANSWER])[kind[some]], some)
        self._before()
        sigma = np.sqrt(np.einsum("nii->ni", self.covariance))
        curves = {f"{self.point}_{axis}": (self.places[:, k], sigma[:, k]) for k, axis in enumerate("xyz")}
        for name, (value, of) in (curves | self.angles).items():
            rows = some if name in self.angles and name != ELBOW_FLEXION.name else slice(None)
            t_s, value, of = r.t_s[rows], value[rows, None], of[rows, None]
            if name in self.angles:  # broken where it would run from 180 to -180 degrees
                value = np.where(np.abs(np.diff(value, axis=0, prepend=value[:1])) > 180.0, np.nan, value)
            color, names = ARM_COLORS[self.color_name], [f"{self.label}{sign} 2 sigma" for sign in "-+"]
            style = look(colors=[packed(color)], widths=[2.0], names=[f"{self.label}after"])
            self._curve(f"{name}/{self.name}/after", t_s, value, style)
            faint = look(colors=[packed((*color[:3], 0.45))] * 2, widths=[1.0] * 2, names=names)
            self._curve(f"{name}/{self.name}/two_sigma", t_s, value + of * np.array([-2.0, 2.0]), faint)
        axes = np.array([0xE0483DFF, 0x4CAF50FF, 0x4F7FE8FF], np.uint32)
        names = [f"{self.label}{self.point} {axis}" for axis in "xyz"]
        style = look(names=names, widths=[1.5] * 3, colors=axes)
        self._curve(f"sigma/{self.name}", r.t_s, 100.0 * sigma, style)
        states = np.where(r.answered, kind, np.int8(len(ANSWER)))
        turns = np.flatnonzero(np.diff(states, prepend=-1))
        colors = np.array([packed(color) for color in (*ANSWER, GUESSED)], np.uint32)
        columns = self.rr.StateChange.columns(state=[_STATES[state] for state in states[turns]])
        style = self.rr.StateConfiguration(values=_STATES, colors=colors)
        self._send(f"gaps/{self.name}", r.t_s[turns], columns, style)

    def _in_space(self, r: Recovery, shade: IntArray, rows: slice) -> None:
        """The arm, its uncertainty and the trail, some pictures a second."""
        rr, nothing = self.rr, np.full((len(r), 3), np.nan)
        joints = [r.joints.get(JOINTS[i], nothing) for i in CHAIN]
        point, covariance = self.places[rows], self.covariance[rows]
        self._bones("after", r.t_s, np.stack(joints, axis=1), shade, _BONE_M)
        self._dots("after/joints", r.t_s, np.stack([*joints, r.position], axis=1), shade, _JOINT_M)
        self._dots("trail", r.t_s, point[:, None], shade, _TRAIL_M)
        good = np.isfinite(point).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
        variance, turn = np.linalg.eigh(covariance[good])
        turn[:, :, 2] *= np.sign(np.linalg.det(turn).reshape(-1, 1))
        columns = rr.Ellipsoids3D.columns(
            half_sizes=2.0 * np.sqrt(np.maximum(variance, 0.0)),
            centers=point[good],
            quaternions=Rotation.from_matrix(turn).as_quat() if len(turn) else np.empty((0, 4)),
            colors=(shade[good] - 0xFF + 0x60).astype(np.uint32),
            fill_mode=[rr.components.FillMode.TransparentFillMajorWireframe] * int(good.sum()),
        )
        self._send(f"scene/camera/{self.name}/two_sigma", r.t_s, columns.partition(good.astype(int)))

    def _before(self) -> None:
        """The camera's joints."""
        frames = self.recovery.arm
        has = (frames.state != JointState.NOT_TRACKED) & np.isfinite(frames.position).all(axis=2)
        places = np.where(has[:, :, None], frames.position, np.nan)
        shades = np.where(frames.state == JointState.INFERRED, packed(GUESSED), packed(CAMERA))
        self._bones("before", frames.t_s, places[:, CHAIN], np.full(len(frames), packed(CAMERA)), _THIN_M)
        self._dots("before/joints", frames.t_s, places, shades, _JOINT_M / 2)
        names = [f"{self.label}camera"]
        style = self.rr.SeriesPoints(colors=[packed(CAMERA)], marker_sizes=[1.5], names=names)
        for axis, name in enumerate("xyz" if self.point == "wrist" else ""):
            wrist = places[:, JOINTS.index("wrist"), axis, None]
            self._curve(f"wrist_{name}/{self.name}/camera", frames.t_s, wrist, style)

    def _curve(self, path: str, t_s: FloatArray, values: FloatArray, style: Any) -> None:
        """Values (n, lines); nan breaks a line."""
        columns = self.rr.Scalars.columns(scalars=values.ravel())
        self._send(f"curves/{path}", t_s, columns.partition(np.full(len(values), values.shape[1])), style)

    def _bones(self, path: str, t_s: FloatArray, places: FloatArray, shade: IntArray, radius: float) -> None:
        """A line through the joints (n, J, 3) that are there; nothing where it is less than two."""
        has = np.asarray(np.isfinite(places).all(axis=2))
        drawn = has.sum(axis=1) > 1
        strips = [places[row][has[row]] for row in np.flatnonzero(drawn)]
        colors, radii = shade[drawn].astype(np.uint32), np.full(len(strips), radius)
        columns = self.rr.LineStrips3D.columns(strips=strips, colors=colors, radii=radii)
        self._send(f"scene/camera/{self.name}/{path}", t_s, columns.partition(drawn.astype(int)))

    def _dots(self, path: str, t_s: FloatArray, places: FloatArray, shade: IntArray, radius: float) -> None:
        """Points (n, J, 3) where they are there, of a shade (n,) or (n, J)."""
        has = np.asarray(np.isfinite(places).all(axis=2))
        shades = np.broadcast_to(shade if shade.ndim == 2 else shade[:, None], has.shape)
        colors, radii = shades[has].astype(np.uint32), np.full(int(has.sum()), radius)
        columns = self.rr.Points3D.columns(positions=places[has], colors=colors, radii=radii)
        self._send(f"scene/camera/{self.name}/{path}", t_s, columns.partition(has.sum(axis=1)))

    def _send(self, path: str, t_s: FloatArray, columns: Any, style: Any = None) -> None:
        if len(t_s):
            self.stream.send_columns(path, [self.rr.TimeColumn(TIMELINE, duration=t_s)], columns)
        if style is not None and self._is_styled:
            self.stream.log(path, style, static=True)


def views(rr: Any, arms: Sequence[ArmPicture]) -> Any:
    """The blueprint: the arm in space and its gaps on the left, curves on the right."""
    rrb = rr.blueprint
    whose = ", ".join(f"{arm.color_name}: {arm.name}" for arm in arms) if len(arms) > 1 else ""
    whole = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())

    def plot(path: str, name: str) -> Any:
        is_sigma = path == "sigma"
        return rrb.TimeSeriesView(
            origin=f"curves/{path}",
            name=f"{name} ({whose})" if whose and not is_sigma else name,
            axis_x=rrb.TimeAxis(view_range=whole, zoom_lock=False),
            plot_legend=rrb.PlotLegend("RightTop", visible=is_sigma and len(arms) == 1),
        )

    points = dict.fromkeys(arm.point for arm in arms)
    places = [plot(f"{point}_{axis}", f"{point} {axis}, m") for point in points for axis in "xyz"]
    angles = [plot(*each) for each in {n: t for arm in arms for n, t in arm.titles.items()}.items()]
    plots = rrb.Vertical(*places, *angles[:1], plot("sigma", "sigma, cm"), name="place")
    if angles[1:]:
        plots = rrb.Tabs(plots, rrb.Vertical(*angles[1:], name="joint angles"))
    boundary = rr.TimeRangeBoundary.cursor_relative
    trail = rr.VisibleTimeRange(TIMELINE, start=boundary(seconds=-TRAIL_S), end=boundary())
    space = rrb.Spatial3DView(
        origin="scene",
        name="blue: seen, orange: recovered, dark red: not to be trusted, grey: the camera's",
        overrides={f"scene/camera/{arm.name}/trail": rrb.VisibleTimeRanges(trail) for arm in arms},
    )
    gaps = rrb.StateTimelineView(origin="gaps", name="gaps")
    below = rrb.Tabs(gaps, rrb.TextDocumentView(origin="notes", name="notes"))
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(space, below, row_shares=[4, 1]), plots, column_shares=[1, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
    )


def level_scene(rr: Any, stream: Any, down: FloatArray | None) -> None:
    """Stand the scene upright, as far as the direction of gravity (3,) is known."""
    if down is not None:
        stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    axes = np.eye(3) if down is None else world_axes(down)
    stream.log("scene/camera", rr.Transform3D(mat3x3=axes), static=True)


def rerun_module() -> ModuleType:
    """The package `rerun`, an extra."""
    return extra_module("rerun", "rerun-sdk", "view", ["StateChange"], ["blueprint"])


def prepare_rrd(
    recoveries: Sequence[Recovery],
    level_down: FloatArray | None = None,  # (3,)
) -> Export:
    """All arms of a result as one file of Rerun, without writing yet."""
    rr: Any = rerun_module()
    if not any(recovery.answered.any() for recovery in recoveries):
        raise UnoccludeError(f"{recoveries[0].name}: there is no answer at any time, and nothing to show")
    down = common_down(recoveries, level_down)
    # The same for the same recording: Rerun shows a file that was made anew in place of the older one.
    text = "|".join(f"{each.name} {each.side} {each.origin_ns} {len(each)}" for each in recoveries)
    identity = hashlib.sha256(text.encode()).hexdigest()[:32]
    sides = [recovery.side or "arm" for recovery in recoveries]
    names = [side if sides.count(side) == 1 else f"{side}_{k}" for k, side in enumerate(sides, 1)]

    def write(path: Path, force: bool) -> None:
        with writing(path, force) as temporary:
            stream = rr.RecordingStream("unocclude", recording_id=identity, send_properties=False)
            arms = [
                ArmPicture(rr, stream, recovery, name, number if len(names) > 1 else None)
                for number, (recovery, name) in enumerate(zip(recoveries, names, strict=True))
            ]
            stream.save(str(temporary), default_blueprint=views(rr, arms))
            stream.send_recording_name(recoveries[0].name)
            level_scene(rr, stream, down)
            stream.log("notes", rr.TextDocument(_notes(recoveries), media_type="text/markdown"), static=True)
            for arm in arms:
                arm.log()
            stream.flush()
            stream.disconnect()

    return Export(sum(len(recovery) for recovery in recoveries), write, frame="camera")


def _notes(recoveries: Sequence[Recovery]) -> str:
    lines = []
    for recovery in recoveries:
        side = f"{recovery.side} arm, " if recovery.side else ""
        lines += [f"### {recovery.name}: {side}{recovery.method}", recovery.estimates.verdict]
        lines += [f"- Not to be trusted: {each}" for each in untrusted_sentences(recovery)]
        if (check := recovery.estimates.self_check) is not None:
            lines.append(check.sentence)
        lines += [f"- {note}" for note in recovery.notes]
    return "\n\n".join(line for line in (*lines, _LEGEND) if line)
