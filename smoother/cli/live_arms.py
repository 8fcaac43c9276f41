"""`unocclude live`: the arms that are followed, which streams are whose, and who is sent the answers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import UnoccludeError
from .output import say

if TYPE_CHECKING:
    from ..streams.arrivals import SourceInfo
    from ..streams.session import Receiver


def sides_of(arms: str, side: str | None, gyro: str | None) -> list[str | None]:
    """The arms that are followed, the first one's side first."""
    if arms == "one":
        return [side]
    if gyro is not None:
        raise typer.BadParameter("--gyro is of one arm; with --arms both send each IMU in one stream")
    return ["left", "right"] if side == "left" else ["right", "left"]


def streams_of_arms(given: Sequence[str], sides: Sequence[str | None]) -> dict[str | None, str | None]:
    """The IMU's stream of each arm, of `--imu`."""
    if len(sides) == 1:
        if len(given) > 1:
            raise typer.BadParameter("--imu is given twice; IMUs beside the forearm's are --further-imu")
        return {sides[0]: given[0] if given else None}
    streams: dict[str | None, str | None] = dict.fromkeys(sides)
    for text in given:
        side, _, name = text.partition("=")
        if side not in streams or not name or streams[side] is not None:
            raise typer.BadParameter(f"--imu {text}: with --arms both give right=STREAM and left=STREAM")
        streams[side] = name
    return streams


def further_streams(given: Sequence[str], sides: Sequence[str | None]) -> dict[str | None, dict[str, str]]:
    """Names of streams by arm and segment, of `--further-imu`."""
    from ..body import FURTHER

    streams: dict[str | None, dict[str, str]] = {side: {} for side in sides}
    known = {
        f"{side}-{word}" if len(sides) > 1 else word: (side, segment.name)
        for side in sides
        for segment in FURTHER
        for word in [segment.name.replace("_", "-")]
    }
    for text in given:
        key, _, name = text.partition("=")
        side, segment = known.get(key, (None, ""))
        if not segment or not name or segment in streams[side]:
            raise typer.BadParameter(
                f"--further-imu {text}: give SEGMENT=STREAM once for each segment, of {', '.join(known)}"
            )
        streams[side][segment] = name
    return streams


def check_arms(infos: Sequence[SourceInfo], replay: Path | None) -> None:
    """Refuse two arms of which one stream is to be both."""
    names = [name for info in infos for name in info.imus.values()]
    if replay is not None and len(set(names)) < len(names):
        raise UnoccludeError(
            f"{replay}: which IMU is on which arm does not show by the topics' names; give --imu right=TOPIC"
            " --imu left=TOPIC"
        )


def receivers_of(
    infos: Sequence[SourceInfo],
    foxglove: int | None,
    lsl_out: str | None,
    lsl_network: bool,
    stack: ExitStack,
) -> list[list[Receiver]]:
    """Who is sent the answers of each arm, and where they are found."""
    info, *others = infos
    receivers: list[list[Receiver]] = [[] for _ in infos]
    if foxglove is not None:
        from ..streams.foxglove import FoxgloveServer

        server = FoxgloveServer(info, foxglove, others)
        stack.callback(server.close)
        say(f"Foxglove: open connection, Foxglove WebSocket, {server.address}; layout:"
            " docs/unocclude.foxglove-layout.json")  # fmt: skip
        for number, of_arm in enumerate(receivers):
            of_arm.append(partial(server.send, number=number))
    if lsl_out is not None:
        from ..streams.lsl import LslOutlet
        from ..streams.lsl_local import LocalLslOutlet

        for of_arm, each in zip(receivers, infos, strict=True):
            name = f"{lsl_out}_{each.side}" if others else lsl_out
            outlet = (LslOutlet if lsl_network else LocalLslOutlet)(name, each)
            stack.callback(outlet.close)
            of_arm.append(outlet.send)
            who = "all computers of this network" if lsl_network else "this computer"
            say(f"LSL: streams {name} and {name}_settled, for {who}")
    return receivers


def together(infos: Sequence[SourceInfo], figures: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Figures of the session; of two arms the first one's, and `arms` with each."""
    if len(figures) == 1:
        return figures[0]
    each = [{"side": info.side, **own} for info, own in zip(infos, figures, strict=True)]
    return {**each[0], "arms": each}
