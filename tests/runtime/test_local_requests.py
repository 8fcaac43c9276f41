"""Which requests to a server of this computer are of its own pages."""

from __future__ import annotations

import pytest

from smoother.runtime.local_requests import LocalDoor, is_token, joined

OWN = {"host": "127.0.0.1:8080", "origin": "http://127.0.0.1:8080"}
FOXGLOVE = LocalDoor(guests=("app.foxglove.dev",), schemes=("file",))


@pytest.mark.parametrize(
    ("headers", "changes", "by_address", "expected"),
    [
        (OWN, True, False, ""),
        ({"host": "localhost:8080"}, False, False, ""),
        ({"host": "localhost:8080"}, True, False, "site"),
        ({"host": "127.0.0.1:8081"}, False, False, "host"),
        ({"host": "evil.example:8080"}, False, True, "host"),
        ({}, False, False, "host"),
        (OWN | {"origin": "http://localhost:8080"}, True, False, "site"),
        (OWN | {"origin": "https://evil.example"}, False, True, "site"),
        (OWN | {"origin": "null"}, True, False, "site"),
        (OWN | {"sec-fetch-site": "cross-site"}, False, False, "site"),
        (OWN | {"sec-fetch-site": "same-site"}, True, False, "site"),
        ({"host": OWN["host"], "sec-fetch-site": "cross-site"}, False, True, ""),
    ],
)
def test_a_page_of_ones_own(headers, changes, by_address, expected):
    assert LocalDoor(8080).refusal(headers, changes, by_address) == expected


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"host": "127.0.0.1:1"}, ""),
        ({"host": "127.0.0.1", "origin": "https://app.foxglove.dev", "sec-fetch-site": "cross-site"}, ""),
        ({"host": "127.0.0.1", "origin": "file://"}, ""),
        ({"host": "127.0.0.1", "origin": "ftp://app.foxglove.dev"}, "site"),
        ({"host": "127.0.0.1", "origin": "http://[broken"}, "site"),
        ({"host": "[broken"}, "host"),
    ],
)
def test_guests(headers, expected):
    assert FOXGLOVE.refusal(headers, changes=False) == expected


def test_a_header_that_repeats_fits_no_value():
    headers = joined([("Host", "127.0.0.1:8080"), ("HOST", "evil.example"), (" Origin ", " null ")])
    assert headers == {"host": "127.0.0.1:8080, evil.example", "origin": "null"}
    assert LocalDoor(8080).refusal(headers, changes=False) == "host"


def test_tokens():
    assert is_token("secret", "secret")
    assert not any(is_token(given, "secret") for given in ("", "secre", "secret ", "\ud800", "sécret"))
