"""What a calibration file says of a session's sensor and arm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from calib.file import CalibrationFile, read_calibration, sigma_factors_of
from calib.imu.sensor import SensorCalibration, sensor_of

from ..calibration import ArmCalibration
from ..config import Config
from ..io.recording.write import imu_topic
from ..recording import ImuStream
from ..window.priors import with_measured_noise
from .arrivals import ImuRows, SourceInfo


@dataclass(frozen=True)
class SessionCalibration:
    """What is known before a session.

    Attributes
    ----------
    arm : ArmCalibration or None
        Of the arm.
    sensor : SensorCalibration or None
        Of the IMU: taken off what is used, not off what is recorded.
    notes : tuple of str
        What of it is used, one sentence each.
    """

    arm: ArmCalibration | None = None
    sensor: SensorCalibration | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, file: CalibrationFile | None, info: SourceInfo) -> SessionCalibration:
        """Of a file, for a session; nothing without one.

        Raises
        ------
        CalibrationError
            The file is of the other arm, or cannot be used.
        """
        if file is None:
            return cls()
        topic = imu_topic(info.imu, info.side)
        sensor, factors = sensor_of(file, topic), sigma_factors_of(file)
        arm = replace(file.arm(info.side), sigma_factors=factors) if file.arms else None
        if arm is None and factors is not None:
            arm = ArmCalibration(info.side, sigma_factors=factors)
        notes = [] if sensor is None else [f"{topic}: {', '.join(sensor.named)} corrected ({file.source})"]
        return cls(arm, sensor, tuple(notes))

    def corrected(self, rows: ImuRows) -> ImuRows:
        """Samples as the sensor should have given them."""
        if self.sensor is None or not len(rows):
            return rows
        stream = self.sensor.apply(ImuStream("", rows.t_s, rows.acc, rows.gyro))
        return replace(rows, acc=stream.acc, gyro=stream.gyro)

    def config(self, config: Config) -> Config:
        """The settings with the sensor's own noise where it was measured."""
        if self.sensor is None:
            return config
        none = ImuRows.none()
        return with_measured_noise(config, self.sensor.apply(ImuStream("", none.t_s, none.acc, none.gyro)))


def prefer_side(file: CalibrationFile | None) -> str | None:
    """The side of a calibration of one arm: settles what the streams leave open."""
    sides = [] if file is None else [name for name in file.arms if name != "any"]
    return sides[0] if len(sides) == 1 else None


def read_calibration_file(path: Path | None) -> CalibrationFile | None:
    """The calibration file, or None.

    Raises
    ------
    CalibrationError
        It cannot be used.
    """
    return None if path is None else read_calibration(path)
