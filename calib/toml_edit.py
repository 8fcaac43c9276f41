"""TOML text in which values change, and comments stay."""

from __future__ import annotations

import tomllib
from typing import Any

from smoother.errors import CalibrationError


def to_toml(document: dict[str, Any], text: str = "") -> str:
    """TOML text of plain values.

    Parameters
    ----------
    document : dict
        Of str, bool, int, float, dates, lists, and dicts (tables, nested at will).
    text : str
        TOML that the document was changed from: comments in it, and how its values are written, are kept.

    Returns
    -------
    text : str

    Raises
    ------
    CalibrationError
        TOML has no such value.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    reason: Exception | None = None
    for start in (text, ""):  # where tables in an odd order cannot be edited, values count, not comments
        tree = tomlkit.parse(start)
        try:
            _update(tree, document)
            changed = tomlkit.dumps(tree)
        except (TOMLKitError, KeyError, TypeError, ValueError) as error:
            reason = error
            continue
        if not start or tomllib.loads(changed) == document:
            return changed
    raise CalibrationError(f"A calibration file cannot hold such a value: {reason}.") from reason


def _update(table: Any, values: dict[str, Any]) -> None:
    """Give a table of tomlkit these values; what is equal is not touched."""
    for key in [key for key in table if key not in values]:
        del table[key]
    for key, value in values.items():
        if key not in table:
            table[key] = value
        elif isinstance(value, dict) and isinstance(table[key], dict):
            _update(table[key], value)
        elif table[key] != value:
            table[key] = value
