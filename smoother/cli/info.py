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
    for arm in about.arms:
        of = f"{arm.label}: " if len(about.arms) > 1 else ""
        body = "" if arm.body is None else f" (body {arm.body})"
        rows += [
            (f"{of}taken", f"{arm.imu}, {arm.side or 'no side'} arm of {arm.skeleton}{body}"),
            *([(f"{of}on the upper arm", arm.upper_imu)] if arm.upper_imu else []),
            *([(f"{of}on the trunk", arm.trunk_imu)] if arm.trunk_imu else []),
            (f"{of}joints", ", ".join(arm.joints) or "none tracked"),
            (f"{of}both recorded, s", arm.duration_s),
            (f"{of}gaps", arm.gaps),
            (f"{of}occluded, s", arm.gap_total_s),
            (f"{of}longest gap, s", arm.gap_longest_s),
        ]
    if about.arms:
        rows.append(("camera frame", about.camera_frame or "not stated"))
    for topic, clock in about.clocks.items():
        behind = clock.get("log_time_behind_s")
        lag = "" if behind is None else f", logged {1000 * behind:.1f} ms later"
        rows.append((f"clock of {topic}", f"{clock['first_s']:.3f} to {clock['last_s']:.3f} s{lag}"))
    print_table("Streams", ("what", "found"), rows)


def _say_verdicts(about: RecordingInfo) -> None:
    """Print the verdict on each arm of a result, and how many of its times are not to be trusted."""
    for each in about.verdicts:
        of = f"{each['arm']}: " if each["arm"] else ""
        if each["verdict"]:
            say(f"{of}{each['verdict']}")
        if each["trusted"] is not False and (times := each["untrusted"]):
            assert isinstance(times, list)
            count = f"{len(times)} {'time' if len(times) == 1 else 'times'}"
            say(f"{of}not to be trusted at {count}; export says which")


def print_missing(about: RecordingInfo) -> None:
    """Print what is missing for recovering first, then in short what it can do without."""
    if "smooth" in about.missing:
        say(f"cannot be recovered: {about.missing['smooth']}")
    elif about.result:
        say("holds a result: validate and export read it")
    else:
        for arm in about.arms:
            of = f"{arm.label}: " if len(about.arms) > 1 else ""
            say(of + (arm.allows if arm.ready else f"not ready for `unocclude smooth`: it {arm.allows}"))
        if about.ready:
            say("ready for `unocclude smooth`")
    _say_verdicts(about)
    for step, reason in about.missing.items():
        if step != "smooth":
            say(f"{step}: {reason}")
    if about.optional:
        lacks = ", ".join(f"{what} ({use})" for what, use in about.optional.items())
        say(f"not in the file, not needed to recover: {lacks}")
