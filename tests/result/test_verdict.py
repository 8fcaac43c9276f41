"""Verdicts by gap and by sample, and their plain values."""

from __future__ import annotations

import math

import numpy as np
import pytest

from smoother.measurements.visibility import Gap
from smoother.result import Estimates, Pairing, SelfCheck, UntrustedInterval
from smoother.result.verdict import gap_verdicts, trusted_at

GAPS = (Gap(1.0, 2.0), Gap(5.0, 6.0), Gap(8.0, 9.0))
BODY = UntrustedInterval(5.5, 7.0, ("another body",))


def test_a_gap_that_an_untrusted_interval_reaches_into_is_not_trusted() -> None:
    verdicts = gap_verdicts(GAPS, True, (), (BODY, UntrustedInterval(5.9, 6.0, ("another body", "late"))))
    assert [each.trusted for each in verdicts] == [True, False, True]
    assert verdicts[1].reasons == ("another body", "late")
    assert (verdicts[1].start_s, verdicts[1].end_s) == (5.0, 6.0)


def test_no_gap_of_an_untrusted_recording_is_trusted() -> None:
    assert [each.reasons for each in gap_verdicts(GAPS[:1], False, ("mirrored",), ())] == [("mirrored",)]
    assert not gap_verdicts(GAPS[:1], False, (), ())[0].trusted


def test_an_interval_that_ends_where_a_gap_begins_does_not_touch_it() -> None:
    assert gap_verdicts(GAPS[1:2], True, (), (UntrustedInterval(3.0, 5.0, ("x",)),))[0].trusted


@pytest.mark.parametrize(("trusted", "rest"), [(True, True), (None, True), (False, False)])
def test_samples_inside_an_interval_are_not_trusted(trusted: bool | None, rest: bool) -> None:
    t = np.arange(0.0, 10.0, 0.1)
    good = trusted_at(t, trusted, (BODY,))
    assert not good[(t >= 5.5) & (t < 7.0)].any()
    assert (good[(t < 5.5) | (t >= 7.0)] == rest).all()


def test_plain_values_come_back() -> None:
    check = SelfCheck(8, 1, 1.7, 0.011, 0.010, 0.96, 1.4, 1.1)
    stated = Estimates(trusted=True, untrusted=(BODY,), self_check=check, pairing=Pairing(True, 1e-4, 120.0))
    assert Estimates.from_plain(stated.plain()) == stated


def test_what_is_not_known_is_none_in_plain_values_and_nan_again() -> None:
    none = SelfCheck(0, note="too short")
    plain = none.plain()
    assert plain["rms_m"] is None
    back = SelfCheck.from_plain(plain)
    assert back is not None
    assert math.isnan(back.rms_m)
    assert back.note == "too short"


@pytest.mark.parametrize(
    "values", [{}, {"stretches": "8"}, {"stretches": 8, "rms_m": [1]}, {"stretches": 8, "note": 3}, 7, None]
)
def test_values_of_another_kind_are_no_self_check(values: object) -> None:
    assert SelfCheck.from_plain(values) is None


@pytest.mark.parametrize(
    "values", [7, [7], [{"start_s": 1.0}], [{"start_s": "a", "end_s": 2, "reasons": []}]]
)
def test_other_values_than_intervals_stay_in_further(values: object) -> None:
    assert Estimates.from_plain({"untrusted": values}).further == {"untrusted": values}


def test_the_self_check_speaks_plainly() -> None:
    check = SelfCheck(8, 0, 1.7, 0.011, 0.010, error_95_m=0.021, stated_95_m=0.028)
    assert check.sentence == (
        "Hidden 8 times for 1.7 s where the camera saw the arm: recovered to within 2.1 cm in 95 of 100 cases"
        " (stated: 2.8 cm)."
    )
    assert SelfCheck(8, 0, 1.7, 0.011, 0.010).sentence == (
        "Hidden 8 times for 1.7 s where the camera saw the arm: recovered to 1.1 cm rms (stated 1.0 cm)."
    ), "a file that states the rms only"
    assert SelfCheck(2, 2, 1.7).sentence.endswith("it could not be recovered.")
    assert SelfCheck(0, note="the camera never saw the arm long enough").sentence == (
        "Self-check: the camera never saw the arm long enough."
    )
