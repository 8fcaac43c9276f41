"""How `--help` shows commands and options: whole sentences, options in groups, rare ones last."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup

ADVANCED = "Advanced"
#: Options that several commands share, by group.
_SHARED = {
    "Which arm": ("imu", "skeleton", "side", "body"),
    "Correct a wrong set-up": ("mirror", "swap", "negate", "camera-frame", "clock-offset", "clock-sigma"),
    "Pictures in the report": ("with-images", "video", "video-offset"),
    ADVANCED: (
        *("config", "orientation", "boundary-s", "solve-lever-arms", "processes", "draws", "seed", "anatomy"),
        *("passthrough-images", "live", "latency", "gaps-per-run", "scheduler", "retry-failed", "time-limit"),
        *("memory-limit", "hash-names", "keep-paths", "outside", "skeleton-format", "imu-format", "wait"),
        *("one-session", "port", "web-port", "lsl-out", "gravity", "mocap-sigma-mm", "panel-topic"),
        *("base-topic", "colour-topic", "depth-topic", "sound-clocks", "motion-clocks", "audio-topic"),
        *("audio-rate-hz", "sound-start", "tone-hz", "distance-m", "resolution-ms"),
    ),
}
#: Options of `simulate`, by group; its other settings are advanced.
_SIMULATED = {
    "Movement": ("protocol", "repetitions", "duration-s", "side", "speed", "strap"),
    "Occlusions": (
        *("occlusion-lengths-s", "occlusion-every-s", "end-gap-s", "occluded-state", "belly"),
        *("shoulder-lost", "frozen-gaps", "swapped-gaps"),
    ),
    "Camera": (
        *("frame-rate-hz", "noise-m", "joint-bias-m", "latency-s", "dropped-frames", "outliers", "outlier-m"),
        *("camera-frame", "distance-m"),
    ),
    "IMUs": (
        *("imus", "imu-rate-hz", "accelerometer-noise", "gyroscope-noise", "accelerometer-bias"),
        *("gyroscope-bias", "wobble-deg", "upper-wobble-deg", "wrist-deg", "trunk-turn-deg"),
    ),
    "Several cameras": ("cameras", "camera-clock-s", "camera-clock-ppm", "camera-blind", "camera-fault"),
    "Motion capture (with --mocap)": (
        *("mocap-rate-hz", "mocap-offset-s", "mocap-skew-ppm", "marker-noise-m", "marker-lost"),
    ),
}
#: Options of `simulate` that are shown first.
_SIMULATED_FIRST = (
    *("output", "calibration-out", "preset", "seed", "mocap", "arms", "json", "force", "mcap", "panel"),
    *("people", "sensors", "on-table", "hanging", "in-time", "clocks-apart-s", "tissue-deg", "every"),
    *("rounds", "minutes", "motion-s", "noise-db", "poses", "rest-s", "long-rest-s", "offset", "scale"),
    *("cross", "noise", "hard-iron", "soft-iron", "field", "tilt-deg", "magnetometer", "camera-tilt-deg"),
    "help",
)
#: Commands whose --imu and --skeleton name what they read, and not one of several.
_OWN_STREAMS = ("live", "import files", "match", "calibrate imu", "calibrate magnetometer")


def group_of(command: str, option: str) -> str:
    """The group under which an option is shown, "" for those that come first.

    Parameters
    ----------
    command : str
        Its words, as "simulate arm".
    option : str
        Its long name without the dashes.
    """
    simulated = command.startswith("simulate ")
    if simulated and option in _SIMULATED_FIRST:
        return ""
    if command in _OWN_STREAMS and option in _SHARED["Which arm"]:
        return ""
    groups = _SIMULATED if simulated else _SHARED
    named = next((group for group, names in groups.items() if option in names), "")
    return named or (ADVANCED if simulated else "")


class GroupedCommand(TyperCommand):
    """A command whose help has its options in groups."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, then the options of every group, those that are rarely needed last."""
        command = ctx.command_path.partition(" ")[2]
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "": []}
        for group in (*_SHARED, *_SIMULATED):
            groups.setdefault(group, [])
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            if parameter.param_type_name == "argument":
                groups["Arguments"].append(record)
            else:
                flag = max(parameter.opts, key=len).lstrip("-")
                groups[group_of(command, flag)].append(record)
        groups[ADVANCED] = groups.pop(ADVANCED)  # last
        for group, records in groups.items():
            if records:
                with formatter.section(group or "Options"):
                    formatter.write_dl(records)


class WholeSentences(TyperGroup):
    """A group whose list of commands has the whole first sentence of each."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its first sentence."""
        names = self.list_commands(ctx)
        commands = [(name, self.get_command(ctx, name)) for name in names]
        rows = [(name, each.get_short_help_str(limit=200)) for name, each in commands if each is not None]
        with formatter.section("Commands"):
            formatter.write_dl(rows)
