"""Estimates as plain values and back: what is known is typed, the rest is kept as it came."""

from __future__ import annotations

from dataclasses import fields

import pytest

from smoother.result import Estimates

#: One of each; `orientation` is known to another version only.
PLAIN = {
    "camera_sigma_m": {"wrist": 0.008, "elbow": 0.01}, "camera_effective_sigma_m": {"wrist": 0.02},
    "joint_bias_m": {"wrist": [0.001, 0.0, -0.002]}, "joint_bias_sigma_m": 0.004,
    "accelerometer_bias": [0.01, 0.02, 0.03], "gyroscope_bias": [0.001, 0.002, 0.003],
    "magnetometer_blocks": 12, "magnetometer_blocks_used": 11, "magnetometer_sigma_deg": 2.0,
    "magnetic_field_direction": [0.0, 1.0, 0.0], "given": ["wrist", "upper_arm"], "max_sigma_m": 0.02,
    "sigma_factors": [1.2, 1.5], "trusted": False, "reasons": ["the upper arm is 53 cm"],
    "cautions": ["the gyroscope was clipped"], "cause": "the skeleton seems mirrored (x)",
    "remedies": ["--mirror x"],
    "untrusted": [{"start_s": 1.0, "end_s": 2.5, "reasons": ["another body"]}],
    "findings": [
        {"code": "gap-unconfirmed", "severity": "times", "start_s": 1.0, "end_s": 2.5,
         "sentence": "another body", "remedy": ""},
        {"code": "cause", "severity": "recording", "start_s": None, "end_s": None,
         "sentence": "the skeleton seems mirrored (x)", "remedy": "--mirror x"},
    ],
    "self_check": {
        "stretches": 6, "unanswered": 0, "length_s": 1.5, "rms_m": 0.02, "stated_sigma_m": 0.021,
        "inside_95": 0.96, "worst_nees": 1.2, "sigma_factor": 1.0, "note": "", "failed": 0,
        "error_95_m": 0.031, "stated_95_m": 0.034,
    },
    "pairing": {
        "proved": True, "chance": 1e-6, "evidence": 80.0, "offset_s": 0.02, "reason": "", "caution": "",
    },
    "clock_given_s": [0.12, 0.001],
    "cameras": [{
        "name": "side", "R_K_C": [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
        "p_K_C_m": [1.5, 0.0, 1.4], "sigma_m": 0.004, "sigma_deg": 0.2, "offset_s": 0.02,
        "offset_sigma_s": 0.001, "skew": 1e-5, "misfit_m": 0.01, "together_s": 20.0,
        "joint_sigma_m": {"wrist": 0.005}, "reason": "", "seen_s": [[0.0, 12.5]],
    }],
    "orientation": "vqf",
}  # fmt: skip


def test_every_estimate_comes_back() -> None:
    estimates = Estimates.from_plain(PLAIN)
    assert estimates.plain() == PLAIN
    assert set(PLAIN) - {"orientation"} == {each.name for each in fields(Estimates)} - {"further"}
    assert estimates.further == {"orientation": "vqf"}
    assert estimates.joint_bias_m == {"wrist": (0.001, 0.0, -0.002)}
    assert Estimates().plain() == {}  # what is not stated is left out, that nothing was found is stated
    nothing = {"joint_bias_m": {}, "joint_bias_sigma_m": 0.0}
    assert Estimates(**nothing).plain() == nothing


@pytest.mark.parametrize("name", [name for name in PLAIN if name not in ("orientation", "cause")])
@pytest.mark.parametrize("value", [None, "text", {"knee": 1.0}, {"wrist": "far"}, [[1.0]], [None]])
def test_a_value_of_another_kind_is_kept_beside(name: str, value: object) -> None:
    estimates = Estimates.from_plain({name: value})
    assert estimates == Estimates(further={name: value})
    assert estimates.plain() == {name: value}
