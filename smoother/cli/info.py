"""`unocclude info`: what a recording holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .options import Body, Force, Imu, Json, RecordingPath, Side, Skeleton, one_side
from .output import check_outputs, print_notes, print_table, say, write_json

if TYPE_CHECKING:
    from ..io.info import RecordingInfo


def info(
    recording_file: RecordingPath,
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Show topics, rates, clocks and gaps, and what is missing for which step."""
    from ..io import describe

    check_outputs(force, [json_file], [recording_file])
    about = describe(recording_file, imu=imu, skeleton=skeleton, side=one_side(side), body=body)
    write_json(json_file, about.to_dict(), force)
    print_topics(about)
    print_arm(about)
    print_missing(about)
    print_notes(about.notes)


def print_topics(about: RecordingInfo) -> None:
    """Print the topics of a recording."""
    rows = [
        (topic.name, topic.schema, topic.count, topic.rate_hz, f"{topic.duration_s:.1f}")
        for topic in about.topics
    ]
    title = f"{about.path}, {about.size_bytes / 1e6:.1f} MB"
    print_table(title, ("topic", "schema", "messages", "rate, Hz", "length, s"), rows)


def print_arm(about: RecordingInfo) -> None:
    """Print the streams found, and what would be taken of them."""
    rows: list[tuple[str, object]] = [("IMU found", text) for text in about.imus]
    rows += [("skeleton found", text) for text in about.skeletons]
    rows += [("truth found", text) for text in about.poses]
    if about.imu:
        rows += [
            ("taken", f"{about.imu}, {about.side or 'no side'} arm of {about.skeleton}"),
            *([("on the upper arm", about.upper_imu)] if about.upper_imu else []),
            *([("on the trunk", about.trunk_imu)] if about.trunk_imu else []),
            ("joints", ", ".join(about.joints) or "none tracked"),
            ("camera frame", about.camera_frame or "not stated"),
            ("both recorded, s", about.duration_s),
            ("gaps", about.gaps),
            ("occluded, s", about.gap_total_s),
            ("longest gap, s", about.gap_longest_s),
        ]
    for topic, clock in about.clocks.items():
        behind = clock.get("log_time_behind_s")
        lag = "" if behind is None else f", logged {1000 * behind:.1f} ms later"
        rows.append((f"clock of {topic}", f"{clock['first_s']:.3f} to {clock['last_s']:.3f} s{lag}"))
    print_table("Streams", ("what", "found"), rows)


def print_missing(about: RecordingInfo) -> None:
    """Print what is missing for recovering first, then in short what it can do without."""
    if "smooth" in about.missing:
        say(f"cannot be recovered: {about.missing['smooth']}")
    elif about.result:
        say("holds a result: validate and export read it")
    elif about.ready:
        say(about.allows)
        say("ready for `unocclude smooth`")
    else:
        say(f"not ready for `unocclude smooth`: it {about.allows}")
    for step, reason in about.missing.items():
        if step != "smooth":
            say(f"{step}: {reason}")
    if about.optional:
        lacks = ", ".join(f"{what} ({use})" for what, use in about.optional.items())
        say(f"not in the file, not needed to recover: {lacks}")
