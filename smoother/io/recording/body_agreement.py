"""Whether two bodies of a camera are one person, by the IMUs that they wear."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ...errors import RecordingError
from ...runtime.store import Store
from .bodies import first_and_last
from .stream_names import role
from .streams import ArmFrames, RecordingFile

if TYPE_CHECKING:
    from ...matching import ImuMatch

#: With more bodies than this the camera counts shadows, and comparing all of them costs more than it tells.
MOST_BODIES = 12
#: An IMU that is on none of a body's limbs with this probability is on somebody else.
NOT_WORN_FROM = 0.95


class WornImus:
    """Which IMUs each body of a file wears, worked out when it is asked for.

    Parameters
    ----------
    file : RecordingFile
        All streams, bodies as the camera numbered them.
    store : Store, optional
        Where cleaned columns are to lie; None = in memory.
    """

    def __init__(self, file: RecordingFile, store: Store | None = None) -> None:
        self._file, self._store = file, store
        self._imus = [imu for imu in file.imus if role(imu) not in ("base", "trunk")]
        self._matches: dict[tuple[str, int], dict[str, ImuMatch]] = {}
        bodies = {(arm.topic, arm.body) for arm in file.arms if arm.tracked}
        #: With one IMU there is nothing to tell people apart by.
        self.can_tell = len(self._imus) > 1 and 1 < len(bodies) <= MOST_BODIES

    def agree(self, earlier: list[int], later: int, topic: str) -> bool | None:
        """Whether a body wears what another wore.

        Parameters
        ----------
        earlier : list of int
            The numbers that the other had so far.
        later : int
            The body's number.
        topic : str
            Of their skeleton.

        Returns
        -------
        bool or None
            True where an IMU is surely on the same limb of both; False where it is surely on the limb of one
            and not on that limb of the other; None where the motion settles neither.
        """
        if not self.can_tell:
            return None
        before = {name: match for body in earlier for name, match in self._sure(topic, body).items()}
        now = self._of(topic, later)
        verdicts = set()
        for name, match in before.items():
            assert match.limb is not None
            other = now.get(name)
            if other is None:
                continue
            if other.is_sure and other.limb is not None:
                verdicts.add(other.limb.joint == match.limb.joint)
            elif other.limb is None and other.is_known and other.probability > NOT_WORN_FROM:
                verdicts.add(False)
        return verdicts.pop() if len(verdicts) == 1 else None

    def _sure(self, topic: str, body: int) -> dict[str, ImuMatch]:
        return {name: match for name, match in self._of(topic, body).items() if match.is_sure}

    def _of(self, topic: str, body: int) -> dict[str, ImuMatch]:
        """What every IMU is on if this body is the only one; nothing where too little was seen of it."""
        from .match_streams import match_streams  # what it imports is not needed with one person

        if (topic, body) not in self._matches:
            arms = [arm for arm in self._file.arms if (arm.topic, arm.body) == (topic, body)]
            try:
                matches, _ = match_streams(self._file, self._imus, seen_frames(arms), store=self._store)
            except RecordingError:
                matches = []
            self._matches[topic, body] = {match.imu: match for match in matches}
        return self._matches[topic, body]


def seen_frames(arms: list[ArmFrames]) -> list[ArmFrames]:
    """The arms in the frames in which anything of a body is there."""
    ends = [first_and_last(arm) for arm in arms]
    start, stop = min((first for first, _ in ends), default=0), max((last + 1 for _, last in ends), default=0)
    rows = slice(start, stop)
    return [
        replace(arm, stamp_ns=arm.stamp_ns[rows], position=arm.position[rows], state=arm.state[rows])
        for arm in arms
    ]
