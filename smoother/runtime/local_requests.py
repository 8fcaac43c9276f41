"""Who may ask a server of this computer: its own pages, by Host, Origin, Sec-Fetch-Site and a token.

Any page that a browser shows may send requests to this computer, and may do so under a name of its own that
it points here (DNS rebinding). The browser sends the requested name (Host), the requesting page (Origin, RFC
6454) and whether that is the same site (Sec-Fetch-Site, Fetch Metadata).
"""

from __future__ import annotations

import hmac
from collections.abc import Iterable, Mapping
from typing import Literal

LOOPBACK = "127.0.0.1"
#: Names of this computer that a request may be addressed to.
OWN_NAMES = (LOOPBACK, "localhost")


def refusal(
    headers: Mapping[str, str], port: int, changes: bool, by_address: bool = False
) -> Literal["host", "site", ""]:
    """What a request to a port is refused for: the host's name or the asking site; "" where it is not."""
    host, origin = headers.get("host", ""), headers.get("origin")
    if host not in {f"{name}:{port}" for name in OWN_NAMES}:
        return "host"
    may_ask = origin == f"http://{host}" or (origin is None and not changes)
    is_near = by_address or headers.get("sec-fetch-site", "none") in ("none", "same-origin")
    return "" if may_ask and is_near else "site"


def joined(headers: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Headers by names in small letters; one that repeats is joined by commas and so fits no single value."""
    values: dict[str, str] = {}
    for key, value in headers:
        name = key.strip().lower()
        values[name] = f"{values[name]}, {value.strip()}" if name in values else value.strip()
    return values


def is_token(given: str, token: str) -> bool:
    """Whether a token was given; how long that takes does not show how much of it is right."""
    return hmac.compare_digest(given.encode("utf-8", "replace"), token.encode())
