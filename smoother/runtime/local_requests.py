"""Who may ask a server of this computer: its own pages, by Host, Origin, Sec-Fetch-Site and a token.

Any page that a browser shows may send requests to this computer, and may do so under a name of its own that
it points here (DNS rebinding). The browser sends the requested name (Host), the requesting page (Origin, RFC
6454; RFC 6455, 10.2 for WebSockets) and whether that is the same site (Sec-Fetch-Site, Fetch Metadata).
"""

from __future__ import annotations

import hmac
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
#: Names of this computer that a request may be addressed to.
OWN_NAMES = (LOOPBACK, "localhost")


@dataclass(frozen=True)
class LocalDoor:
    """Which requests come from this computer's own pages and programs."""

    port: int | None = None  # On which is served, as Host and own Origins name it
    guests: tuple[str, ...] = ()  # Hosts of other web sites whose pages may ask too
    schemes: tuple[str, ...] = ()  # Origins of programs that are not web pages ("file", ..) and may ask too

    def refusal(
        self, headers: Mapping[str, str], changes: bool, by_address: bool = False
    ) -> Literal["host", "site", ""]:
        """What a request is refused for: the name of the host, or the asking site; "" where it is not."""
        host = headers.get("host", "")
        if not self._is_own(host):
            return "host"
        origin = headers.get("origin")
        is_ours = origin is not None and (origin == f"http://{host}" or self._is_guest(origin))
        may_ask = is_ours or (origin is None and not changes)
        site = headers.get("sec-fetch-site", "none")
        is_near = by_address or site in ("none", "same-origin") or (is_ours and bool(self.guests))
        return "" if may_ask and is_near else "site"

    def _is_own(self, host: str) -> bool:
        if self.port is not None:
            return host in {f"{name}:{self.port}" for name in OWN_NAMES}
        try:
            return urlsplit(f"//{host}").hostname in OWN_NAMES
        except ValueError:
            return False

    def _is_guest(self, origin: str) -> bool:
        try:
            parts = urlsplit(origin)
            return parts.scheme in self.schemes or (
                parts.scheme in ("http", "https") and parts.hostname in self.guests
            )
        except ValueError:
            return False


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
