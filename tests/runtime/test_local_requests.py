"""Which requests to a server of this computer are of its own pages."""

from __future__ import annotations

import pytest

from smoother.runtime.local_requests import LocalDoor, Refusal, is_token, joined

OWN = {"host": "127.0.0.1:8080", "origin": "http://127.0.0.1:8080"}
FOXGLOVE = LocalDoor(guests=("app.foxglove.dev",), schemes=("file",))


@pytest.mark.parametrize(
    ("headers", "changes", "by_address", "expected"),
    [
        (OWN, True, False, None),
        ({"host": "localhost:8080"}, False, False, None),
        ({"host": "localhost:8080"}, True, False, Refusal.SITE),
        ({"host": "127.0.0.1:8081"}, False, False, Refusal.HOST),
        ({"host": "evil.example:8080"}, False, True, Refusal.HOST),
        ({}, False, False, Refusal.HOST),
        (OWN | {"origin": "http://localhost:8080"}, True, False, Refusal.SITE),
        (OWN | {"origin": "https://evil.example"}, False, True, Refusal.SITE),
        (OWN | {"origin": "null"}, True, False, Refusal.SITE),
        (OWN | {"sec-fetch-site": "cross-site"}, False, False, Refusal.SITE),
        (OWN | {"sec-fetch-site": "same-site"}, True, False, Refusal.SITE),
        ({"host": OWN["host"], "sec-fetch-site": "cross-site"}, False, True, None),
    ],
)
def test_a_page_of_ones_own(headers, changes, by_address, expected):
    assert LocalDoor(8080).refusal(headers, changes, by_address) is expected


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"host": "127.0.0.1:1"}, None),
        ({"host": "127.0.0.1", "origin": "https://app.foxglove.dev", "sec-fetch-site": "cross-site"}, None),
        ({"host": "127.0.0.1", "origin": "file://"}, None),
        ({"host": "127.0.0.1", "origin": "ftp://app.foxglove.dev"}, Refusal.SITE),
        ({"host": "127.0.0.1", "origin": "http://[broken"}, Refusal.SITE),
        ({"host": "[broken"}, Refusal.HOST),
    ],
)
def test_guests(headers, expected):
    assert FOXGLOVE.refusal(headers, changes=False) is expected


def test_a_header_that_repeats_fits_no_value():
    headers = joined([("Host", "127.0.0.1:8080"), ("HOST", "evil.example"), (" Origin ", " null ")])
    assert headers == {"host": "127.0.0.1:8080, evil.example", "origin": "null"}
    assert LocalDoor(8080).refusal(headers, changes=False) is Refusal.HOST


def test_tokens():
    assert is_token("secret", "secret")
    assert not any(is_token(given, "secret") for given in ("", "secre", "secret ", "\ud800", "sécret"))
