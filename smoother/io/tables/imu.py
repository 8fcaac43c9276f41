"""Tables of one inertial sensor: checked by gravity, and put together where two files contain a half each."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray
from ...errors import RecordingError
from ...linalg import interpolate, median_rate_hz
from ...measurements.timestamps import PAUSE_S, PAUSE_SAMPLES
from ...units import STANDARD_GRAVITY
from .table import amount


@dataclass
class ImuTable:
    """One inertial sensor as a file has it, in SI units, times not yet repaired."""

    name: str  # What the file calls the sensor ("" where it does not say)
    t_s: FloatArray | None  # (N,) s: stamps as written, on the device's clock
    acc: FloatArray | None  # (N, 3) m/s^2 and rad/s: none where the file contains only the other of the two
    gyro: FloatArray | None  # (N, 3) m/s^2 and rad/s: none where the file contains only the other of the two
    mag: FloatArray | None = None  # (N, 3): in the sensor's own unit
    rate_hz: float | None = None  # Rate that the file states, or that its counter counts
    # int (N,): Packet counter, where there is one
    counter: NDArray[np.int64] | None = None
    counter_wraps: int = 0  # 0 = it does not wrap
    units: str = ""  # As written in the file, for the line that is said of it ("m/s^2, deg/s")
    notes: list[str] = field(default_factory=list)  # What was decided or dropped in reading, a sentence each
    # The file does not state the gyroscope's unit, and its size alone decided: an accelerometer may settle it
    gyro_unit_assumed: bool = False
    made_of: tuple[str, ...] = ()  # Streams of the file that contain a half each


#: A median below this part of gravity has no gravity.
_NO_GRAVITY = 0.35
#: A median between these parts of gravity is gravity.
_GRAVITY = (0.6, 1.7)
#: The fastest gyroscopes measure 4000 deg/s; more in one sample of a hundred is another unit, rad/s.
_FASTEST = 70.0
#: Rotation is compared with gravity's over this time, s.
_OVER_S = 0.4
#: A unit is wrong by 57.3 where the scale lies beyond this factor; fast motion lowers it to 0.2.
WRONG_SCALE = 7.5
#: The comparison counts from this correlation on.
_CLEAR = 0.5


def size_notes(table: ImuTable) -> list[str]:
    """Sentences on values that do not fit the unit they are in; none where all is well."""
    return [*(_gravity_notes(table.acc) if table.acc is not None else []), *turn_notes(table)]


def turn_notes(table: ImuTable) -> list[str]:
    """A sentence where the gyroscope does not turn as gravity does in its sensor, by 57.3; else none."""
    if table.gyro is None or not np.isfinite(table.gyro).any():
        return []
    fast = float(np.nanpercentile(np.abs(table.gyro), 99))
    scale = turn_scale(table)
    if fast > _FASTEST or (scale is not None and scale < 1 / WRONG_SCALE):
        return [
            "The gyroscope is some 57 times larger than the accelerometer turns with it: the file's rad/s are"
            " probably deg/s; check the export."
        ]
    if scale is not None and scale > WRONG_SCALE:
        return [
            "The gyroscope is some 57 times smaller than the accelerometer turns with it: the file's deg/s"
            " are probably rad/s; check the export."
        ]
    return []


def with_settled_unit(table: ImuTable) -> ImuTable:
    """An IMU whose gyroscope's unit, where it was assumed, is the one in which gravity turns with it."""
    scale = turn_scale(table) if table.gyro_unit_assumed else None
    if scale is None or table.gyro is None or 1 / WRONG_SCALE < scale < WRONG_SCALE:
        return table
    unit, factor = ("deg/s", np.pi / 180) if scale < 1 else ("rad/s", 180 / np.pi)
    said = f"The accelerometer turns with the gyroscope only if that is in {unit}, so that unit counts."
    other = "rad/s" if unit == "deg/s" else "deg/s"
    return replace(
        table,
        gyro=table.gyro * factor,
        units=table.units.replace(other, unit),
        notes=[*table.notes, said],
        gyro_unit_assumed=False,
    )


def holds_gravity(acc: FloatArray) -> bool:
    """Whether accelerations (n, 3) in m/s^2 can be specific force: most are not near zero."""
    size = np.linalg.norm(acc, axis=1)
    return bool(np.isfinite(size).any()) and float(np.nanmedian(size)) > _NO_GRAVITY * STANDARD_GRAVITY


def turn_scale(table: ImuTable) -> float | None:
    """How much faster gravity turns in the sensor's axes than its gyroscope says."""
    rate = _rate(table)
    if table.acc is None or table.gyro is None or rate is None:
        return None
    width = max(round(_OVER_S * rate), 2)
    finite = np.isfinite(table.acc).all(axis=1) & np.isfinite(table.gyro).all(axis=1)
    acc, gyro = table.acc[finite], table.gyro[finite]
    if len(acc) < 8 * width:
        return None
    acc, gyro = _means(acc, width), _means(gyro, width)
    turned = np.cross(acc[1:-1], gyro[1:-1])
    changed = (acc[2:] - acc[:-2]) / (2 * width / rate)
    power, common = float((turned**2).sum()), float((turned * changed).sum())
    both = np.sqrt(power * float((changed**2).sum()))
    return common / power if both > 0 and common / both > _CLEAR else None


def _gravity_notes(acc: FloatArray) -> list[str]:
    size = np.linalg.norm(acc, axis=1)
    if not np.isfinite(size).any():
        return []
    median = float(np.nanmedian(size))
    if _GRAVITY[0] < median / STANDARD_GRAVITY < _GRAVITY[1]:
        return []
    if _GRAVITY[0] < median < _GRAVITY[1]:
        return ["The accelerometer's usual size is 1, not 9.81 m/s^2: it is probably in g; check the export."]
    if median < _NO_GRAVITY * STANDARD_GRAVITY:
        return [
            f"The accelerometer's usual size is {median:.2g} m/s^2: it has no gravity; export raw"
            " acceleration."
        ]
    return [
        f"The accelerometer's usual size is {median:.3g} m/s^2, not 9.81; check its unit and calibration."
    ]


def _rate(table: ImuTable) -> float | None:
    if table.rate_hz:
        return table.rate_hz
    if table.t_s is None or len(table.t_s) < 10:
        return None
    dt = np.diff(table.t_s)
    dt = dt[np.isfinite(dt) & (dt > 0)]
    if not len(dt):
        return None
    # Repeated stamps are samples too, pauses are short ones.
    rate = len(table.t_s) / float(np.minimum(dt, 10 * np.median(dt)).sum())
    return rate if 1 < rate < 1e5 else None


def _means(values: FloatArray, width: int) -> FloatArray:
    """Means over successive `width` rows."""
    count = len(values) // width
    return values[: count * width].reshape(count, width, 3).mean(axis=1)


def paired(tables: list[ImuTable], source: str) -> ImuTable:
    """One IMU of tables that each contain a part of it, on the gyroscope's times."""
    if len(tables) == 1 and tables[0].acc is not None and tables[0].gyro is not None:
        return tables[0]
    acc, gyro = (_only(tables, part, name, source) for part, name in _PARTS)
    if acc is gyro:
        raise RecordingError(f"{source}: one file contains the whole sensor already; name it alone.")
    assert acc.t_s is not None and gyro.t_s is not None and acc.acc is not None
    first, last = max(acc.t_s[0], gyro.t_s[0]), min(acc.t_s[-1], gyro.t_s[-1])
    if not last > first:
        raise RecordingError(
            f"{source}: accelerometer and gyroscope do not overlap in time, they are {first - last:.1f} s"
            " apart; export both from the same recording."
        )
    at = gyro.t_s
    keep = (at >= first) & (at <= last) & ~_in_a_pause(acc.t_s, at)
    if keep.sum() < 2:
        raise RecordingError(
            f"{source}: accelerometer and gyroscope share too few samples; export both from the same"
            " recording."
        )
    mag = next((t for t in tables if t.mag is not None and t.t_s is not None), None)
    notes = [note for table in tables for note in table.notes]
    notes.append(
        f"The accelerometer ({median_rate_hz(acc.t_s):.1f} Hz) was interpolated to the gyroscope's times"
        f" ({median_rate_hz(at):.1f} Hz)."
    )
    if not keep.all():
        count = int((~keep).sum())
        samples = amount(
            count,
            "sample of the gyroscope has no accelerometer and was",
            "samples of the gyroscope have no accelerometer and were",
        )
        notes.append(f"{samples} left out.")
    table = replace(
        gyro,
        name=gyro.name or acc.name,
        t_s=at[keep],
        acc=interpolate(acc.t_s, acc.acc, at[keep]),
        gyro=None if gyro.gyro is None else gyro.gyro[keep],
        mag=None if mag is None else _at(mag.t_s, mag.mag, at[keep]),
        counter=None,
        units=", ".join(dict.fromkeys(unit for unit in (acc.units, gyro.units) if unit)),
        notes=notes,
    )
    table = with_settled_unit(table)
    table.notes.extend(note for note in turn_notes(table) if note not in table.notes)
    return table


#: How a note on what was not taken begins.
UNUSED = "Not used:"
_PARTS = (("acc", "accelerometer"), ("gyro", "gyroscope"))


def _only(tables: list[ImuTable], part: str, name: str, source: str) -> ImuTable:
    having = [table for table in tables if getattr(table, part) is not None]
    if len(having) == 1:
        return having[0]
    if not having:
        said = dict.fromkeys(note for table in tables for note in table.notes if note.startswith(UNUSED))
        unused = f" ({' '.join(said).rstrip('.')})" if said else ""
        raise RecordingError(
            f"{source} has no {name} that is recognised{unused}; export it as well and name both files:"
            " --imu forearm_right=acc.csv,gyro.csv."
        )
    names = ", ".join(table.name for table in having)
    one = f"{source}#{_first(tables, 'acc')},#{_first(tables, 'gyro')}"
    command = f": --imu forearm_right={one}" if ", " not in source else ""
    raise RecordingError(
        f"{source} has {len(having)} {name}s ({names}); name one accelerometer and one gyroscope{command}."
    )


def _first(tables: list[ImuTable], part: str) -> str:
    return next((table.name for table in tables if getattr(table, part) is not None), "")


def _in_a_pause(t_s: FloatArray, at: FloatArray) -> BoolArray:
    """Times (M,) that are in a pause of samples at `t_s` (N,)."""
    dt = np.diff(t_s)
    pause_s = max(PAUSE_S, PAUSE_SAMPLES * float(np.median(dt))) if len(dt) else PAUSE_S
    row = np.clip(np.searchsorted(t_s, at, side="right") - 1, 0, max(len(dt) - 1, 0))
    exact = at == t_s[np.clip(np.searchsorted(t_s, at), 0, len(t_s) - 1)]
    return np.asarray((dt[row] > pause_s) & ~exact if len(dt) else np.zeros(len(at), bool))


def _at(t_s: FloatArray | None, values: FloatArray | None, at: FloatArray) -> FloatArray | None:
    return None if t_s is None or values is None else interpolate(t_s, values, at)
