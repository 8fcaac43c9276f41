"""The recovered arms of one recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

from ..errors import UnoccludeError
from ..recording import Recording
from .recovery import Recovery


def arm_tags(recoveries: Sequence[Recovery]) -> list[str]:
    """A name for each arm among several, as topics end in: "left", or "body_2/left" with several people.

    Where side and body do not distinguish them, a number does.
    """

    def tag(recovery: Recovery) -> str:
        side = recovery.side or "arm"
        return side if recovery.body is None else f"body_{recovery.body}/{side}"

    tags = [tag(recovery) for recovery in recoveries]
    return [
        one if tags.count(one) == 1 and recovery.side else f"{one}_{number}"
        for number, (one, recovery) in enumerate(zip(tags, recoveries, strict=True), start=1)
    ]


def is_of_arm(recovery: Recovery, recording: Recording) -> bool:
    """Whether a recovery is of this arm of a recording."""
    of_arm = (recording.arm.name, recording.side, recording.body)
    return of_arm == (recovery.arm.name, recovery.side, recovery.body)


@dataclass(frozen=True)
class Recoveries(Sequence[Recovery]):
    """The arms of a recording: by number, by side, or by name where there are several people.

    `recoveries["left"]`, `recoveries["body_2/left"]`, `recoveries[0]`; iterates over the arms.

    Attributes
    ----------
    arms : tuple of Recovery
        In order of body and side.
    left_out : tuple of str
        A sentence for each arm that could not be recovered.
    """

    arms: tuple[Recovery, ...]
    left_out: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.arms)

    @overload
    def __getitem__(self, key: int | str) -> Recovery: ...
    @overload
    def __getitem__(self, key: slice) -> tuple[Recovery, ...]: ...
    def __getitem__(self, key: int | str | slice) -> Recovery | tuple[Recovery, ...]:
        if not isinstance(key, str):
            return self.arms[key]
        named = [arm for arm, tag in zip(self.arms, self.tags, strict=True) if tag == key]
        fitting = named or [arm for arm in self.arms if arm.side == key]
        if len(fitting) != 1:
            what = "several arms fit" if fitting else "there is no arm"
            raise UnoccludeError(f"{what} {key!r}; arms: {', '.join(self.tags)}")
        return fitting[0]

    @property
    def tags(self) -> list[str]:
        """The arms' names, as a result file's topics end in."""
        return arm_tags(self.arms)
