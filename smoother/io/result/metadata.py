"""What a recovery contains besides its time series, as JSON and back."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...body import FURTHER, SEGMENTS, UPPER_ARM
from ...calibration import ArmCalibration, Length, LeverArm, SegmentMounting
from ...measurements.visibility import Gap
from ...result import Recovery


def to_json(value: object) -> str:
    """JSON of plain values, arrays (as lists) and dataclasses; nan stays nan, as Python reads it."""
    text = json.dumps(value, default=_plain, ensure_ascii=False)
    return text.encode("utf-8", "backslashreplace").decode("utf-8")  # a file's name may be no UTF-8: \\udcff


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, set | frozenset):
        return sorted(value)
    return str(value)


def recovery_values(recovery: Recovery, version: str) -> dict[str, str]:
    """The metadata record of a result: JSON by key."""
    return {
        key: to_json(value)
        for key, value in {
            "method": recovery.method,
            "version": version,
            "name": recovery.name,
            "side": recovery.side,
            "origin_ns": recovery.origin_ns,
            "camera": recovery.arm.name,
            "joints": list(recovery.joints),
            "gaps": recovery.gaps,
            "calibration": _calibration(recovery.calibration),
            "gravity_direction": recovery.gravity_direction,
            "clock_offset_s": recovery.clock_offset_s,
            "clock_offset_sigma_s": recovery.clock_offset_sigma_s,
            "has_residuals": recovery.residuals is not None,
            "notes": recovery.notes,
            "config": _lasting(recovery.config),
            "figures": recovery.estimates.plain(),
            **_further(recovery),
            **({} if recovery.body is None else {"body": recovery.body}),
            **_trunk(recovery),
            **_draws(recovery),
        }.items()
    }


def _further(recovery: Recovery) -> dict[str, object]:
    """What IMUs on further segments add; nothing without any."""
    names = ("name", "clock_offset_s", "mount_sigma_rad")
    return {
        segment: {name: getattr(motion, name) for name in names}
        for segment, motion in recovery.segments.items()
    }


def _calibration(arm: ArmCalibration | None) -> dict[str, object] | None:
    """A calibration as plain values; the upper arm's IMU has its keys with and without one."""
    if arm is None:
        return None
    plain = {
        each.name: getattr(arm, each.name) for each in dataclasses.fields(arm) if each.name != "mountings"
    }
    plain |= {"upper_imu": arm.upper_imu, "R_U_B": arm.R_U_B}
    others = {name: mounting for name, mounting in arm.mountings.items() if name != UPPER_ARM.name}
    return plain | {_levers_key(name): mounting.lever_arms for name, mounting in others.items()}


def _levers_key(segment: str) -> str:
    return f"{SEGMENTS[segment].prefix}_imu"


def _trunk(recovery: Recovery) -> dict[str, object]:
    """What an IMU on the trunk adds; nothing without one."""
    trunk = recovery.trunk
    if trunk is None:
        return {}
    names = ("name", "clock_offset_s", "mount_sigma_rad", "R_T_D")
    by = {} if trunk.by_imu else {"by_imu": False}
    return {"trunk": {name: getattr(trunk, name) for name in names} | by}


def _draws(recovery: Recovery) -> dict[str, object]:
    """How many motions were drawn, and their seed; nothing where none were."""
    draws = recovery.draws
    return {} if draws is None else {"draws": {"count": len(draws), "seed": draws.seed}}


def _lasting(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration without the number of processes: it does not affect the result."""
    return {
        section: {key: value for key, value in settings.items() if (section, key) != ("windows", "processes")}
        if isinstance(settings, Mapping)
        else settings
        for section, settings in config.items()
    }


def gaps_of(values: list[dict[str, Any]]) -> tuple[Gap, ...]:
    """Gaps from their JSON."""
    return tuple(Gap(**value) for value in values)


def calibration_of(value: dict[str, Any] | None) -> ArmCalibration | None:
    """A calibration from its JSON."""
    if value is None:
        return None

    def array(name: str) -> Any:
        return None if value.get(name) is None else np.array(value[name], float)

    def levers(name: str) -> dict[str, LeverArm]:
        return {
            joint: LeverArm(np.array(lever["position_m"], float), np.array(lever["sigma_m"], float))
            for joint, lever in value.get(name, {}).items()
        }

    return ArmCalibration(
        side=value["side"],
        lever_arms=levers("lever_arms"),
        upper_arm=None if value["upper_arm"] is None else Length(**value["upper_arm"]),
        R_F_A=array("R_F_A"),
        accelerometer_bias=array("accelerometer_bias"),
        gyroscope_bias=array("gyroscope_bias"),
        mountings={
            body.name: SegmentMounting(own, R_bone=array("R_U_B") if body.name == UPPER_ARM.name else None)
            for body in FURTHER
            if (own := levers(_levers_key(body.name)))
        },
    )
