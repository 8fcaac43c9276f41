"""All measures of one arm's recording."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from ..recording import arm_words
from .measure import Measure, Scope
from .movement import Movement

if TYPE_CHECKING:
    import pyarrow


@dataclass(frozen=True)
class Measures:
    """What was measured of one arm: over the session, by movement and by repetition.

    Attributes
    ----------
    side : str
        "left", "right" or "".
    body : int, optional
        The camera's number of the person, where several are told apart.
    name : str
        Of the recording.
    start_s, end_s : float, s
        First and last sample.
    rows : tuple of Measure
        The session's first, then those of movements and repetitions in the order of time.
    movements, repetitions : tuple of Movement
        In the order of time; a measure's `movement` counts in them.
    trusted : bool, optional
        Whether the recovery is to be trusted; None where nobody judged.
    verdict : str
        The recovery's verdict, one sentence.
    n_draws : int
        How many draws the intervals are of; 0 = there are none.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    side: str
    body: int | None
    name: str
    start_s: float
    end_s: float
    rows: tuple[Measure, ...]
    movements: tuple[Movement, ...] = ()
    repetitions: tuple[Movement, ...] = ()
    trusted: bool | None = None
    verdict: str = ""
    n_draws: int = 0
    notes: tuple[str, ...] = ()

    @property
    def arm_label(self) -> str:
        """Which arm, in words: "right arm of body 2"."""
        return arm_words(self.side, self.body)

    @property
    def session(self) -> tuple[Measure, ...]:
        """Those of the whole session."""
        return tuple(row for row in self.rows if row.scope == "session")

    @property
    def by_key(self) -> dict[str, Measure]:
        """Those of the session by their key."""
        return {row.key: row for row in self.session}

    def of(self, scope: Scope, number: int) -> dict[str, Measure]:
        """Those of one movement or repetition by their key."""
        return {row.key: row for row in self.rows if (row.scope, row.movement) == (scope, number)}

    def to_table(self) -> pyarrow.Table:
        """All measures as an Arrow table, a row a measure; null where there is no number.

        Returns
        -------
        table : pyarrow.Table
            `side`, `body`, then the columns of `Measure`.
        """
        import pyarrow as pa

        names = [each.name for each in fields(Measure)]
        types = {
            "movement": pa.int32(),
            "n_draws": pa.int32(),
            **dict.fromkeys(
                ("value", "low", "high", "sigma", "recovered_share", "untrusted_share", "start_s", "end_s"),
                pa.float64(),
            ),
        }
        columns = {
            "side": pa.array([self.side] * len(self.rows), pa.string()),
            "body": pa.array([self.body] * len(self.rows), pa.int32()),
        }
        for name in names:
            values = [getattr(row, name) for row in self.rows]
            columns[name] = pa.array(values, types.get(name, pa.string()), from_pandas=True)
        return pa.table(columns)

    def as_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` states them.

        Returns
        -------
        figures : dict
            `measures` by key (of the session), `movements` and `repetitions` (each with its own `measures`),
            and what to know of them.
        """

        def listed(scope: Scope, places: tuple[Movement, ...]) -> list[dict[str, object]]:
            return [
                place.as_dict()
                | {"measures": {key: row.as_dict() for key, row in self.of(scope, number).items()}}
                for number, place in enumerate(places)
            ]

        return {
            "recording": self.name,
            "side": self.side,
            "body": self.body,
            "trusted": self.trusted,
            "verdict": self.verdict,
            "start_s": self.start_s,
            "end_s": self.end_s,
            "draws": self.n_draws,
            "measures": {key: row.as_dict() for key, row in self.by_key.items()},
            "movements": listed("movement", self.movements),
            "repetitions": listed("repetition", self.repetitions),
            "notes": list(self.notes),
        }
