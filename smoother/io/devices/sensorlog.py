"""SensorLog for iPhone and Apple Watch."""

from __future__ import annotations

from ...array_types import FloatArray
from ...errors import RecordingError
from ..tables.imu_columns import (
    Columns,
    ImuSheetFormat,
    angular_velocity,
    seconds,
    specific_force,
    unit_summary,
)
from ..tables.protocol import ImuTable
from ..tables.table_layout import TableLayout
from ..tables.text_table import Sheet

_ACC = ("accelerometeracceleration",)
_USER, _GRAVITY = ("motionuseracceleration",), ("motiongravity",)
_GYRO, _RATE = ("gyrorotation",), ("motionrotationrate",)
_LOGGED = ("loggingtime", "timestamp", "time", "locationtimestamp_since1970")


class SensorLog(ImuSheetFormat):
    """Core Motion's values: g with the sign of gravity (-1 on z, lying face up), rad/s.

    Source of the sign: Apple, "Getting raw accelerometer events" and `CMDeviceMotion.gravity`; specific force
    is the opposite, 1 g upwards.
    """

    key = "sensorlog"
    title = "SensorLog CSV (iPhone, Apple Watch)"
    recognised_by = (
        "columns such as accelerometerAccelerationX(G), gyroRotationX(rad/s), motionRotationRateX(rad/s)"
    )

    def fits(self, layout: TableLayout) -> bool:
        """Whether some vector has SensorLog's name."""
        return any(layout.axes(*stems) is not None for stems in (_ACC, _USER, _GYRO, _RATE))

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor: raw accelerometer and gyroscope, else Core Motion's."""
        layout = sheet.layout
        raw, user, gravity, gyro, rate = (
            _filled(sheet, layout.axes(*stems)) for stems in (_ACC, _USER, _GRAVITY, _GYRO, _RATE)
        )
        summed = user is not None and gravity is not None
        if (raw is None and not summed) or (gyro is None and rate is None):
            raise RecordingError(
                f"{sheet.path} is a {self.title} without both accelerometer and gyroscope; log"
                " 'Accelerometer' and 'Gyroscope', or 'Device Motion' with user acceleration and gravity."
            )
        notes = ["iOS writes gravity, which points down; the signs were turned to specific force."]
        own_gyro = gyro is not None and (raw is not None or rate is None)
        own_acc = raw is not None and (own_gyro or not summed)
        turning = gyro if own_gyro else rate
        if own_acc:
            acc = specific_force(sheet, raw, "g", sign=-1.0)
        else:
            acc = _sum(specific_force(sheet, user, "g", -1.0), specific_force(sheet, gravity, "g", -1.0))
            notes.append("Acceleration is the sum of user acceleration and gravity of Core Motion.")
        if not own_gyro:
            notes.append("Angular velocity is Core Motion's, which removes an estimate of the bias.")
        stamp = "accelerometertimestamp_sincereboot" if own_acc else "motiontimestamp_sincereboot"
        return [
            ImuTable(
                name="",
                t_s=_times(sheet, stamp),
                acc=acc,
                gyro=angular_velocity(sheet, turning, "rad/s"),
                units=unit_summary(sheet, (raw if own_acc else user, "g"), (turning, "rad/s")),
                notes=notes,
            )
        ]


def _filled(sheet: Sheet, columns: Columns | None) -> Columns | None:
    """The columns, where there are values in them: sensors that were off leave theirs empty or null."""
    return (
        columns if columns is not None and any(_has_value(text) for text in sheet.texts(columns[0])) else None
    )


def _has_value(text: str) -> bool:
    return text.strip().lower() not in ("", "null", "nan")


def _sum(one: FloatArray | None, other: FloatArray | None) -> FloatArray | None:
    return None if one is None or other is None else one + other


def _times(sheet: Sheet, stamp: str) -> FloatArray | None:
    """The sensor's own stamps, else those of logging."""
    for label in (stamp, *_LOGGED):
        t_s = seconds(sheet, sheet.layout.find(label))
        if t_s is not None:
            return t_s
    raise RecordingError(f"{sheet.path} has no times; log them too (loggingTime, timestamp since reboot).")
