"""Who is let in: this computer's browser, with the token, from the app's own page."""

from __future__ import annotations

from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..runtime.local_requests import LocalDoor, is_token, joined

#: Pages of the app: its own files alone, and no other address.
OWN_PAGES = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self';"
    " frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
#: Reports bring their own script and style. They run in a sandbox: nothing of it reaches the app.
REPORTS = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:;"
    " font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self';"
    " sandbox allow-scripts allow-downloads allow-modals"
)
_HEADERS = {
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-resource-policy": b"same-origin",
    b"cross-origin-opener-policy": b"same-origin",
    b"cache-control": b"no-store",
}
NO_TOKEN = "Open the address that `unocclude app` printed; it contains the token of this page.\n"
WRONG_HOST = "This page is served to this computer alone, under 127.0.0.1.\n"
OTHER_SITE = "Refused: the request came from another site.\n"


class Guard:
    """Lets requests through to the app that may come; see the module."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self.app = app
        self.token = token
        self.door = LocalDoor(port)
        self.cookie = f"unocclude-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on; see ASGI."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            await send({"type": "websocket.close", "code": 1008})
            return
        headers = joined((key.decode("latin-1"), value.decode("latin-1")) for key, value in scope["headers"])
        comes_with_token = self._has_token(scope)
        refusal = self._refusal(scope, headers, comes_with_token)
        with_cookie = comes_with_token and not refusal

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {key for key, _ in message["headers"]}
                more = {**_HEADERS, b"content-security-policy": OWN_PAGES.encode()}
                message["headers"] += [(key, value) for key, value in more.items() if key not in given]
                if with_cookie:
                    text = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                    message["headers"].append((b"set-cookie", text.encode()))
            await send(message)

        target = PlainTextResponse(refusal, status_code=403) if refusal else self.app
        await target(scope, receive, answer)

    def _has_token(self, scope: Scope) -> bool:
        """Whether the first page is asked for with the token in its address."""
        if scope["path"] != "/" or scope["method"] not in ("GET", "HEAD"):
            return False
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        return is_token(given, self.token)

    def _refusal(self, scope: Scope, headers: dict[str, str], comes_with_token: bool) -> str:
        """Why a request is refused; "" where it is not."""
        changes = scope["method"] not in ("GET", "HEAD")
        if why := self.door.refusal(headers, changes, by_address=comes_with_token):
            return WRONG_HOST if why == "host" else OTHER_SITE
        return "" if comes_with_token or self._has_cookie(headers.get("cookie", "")) else NO_TOKEN

    def _has_cookie(self, text: str) -> bool:
        try:
            cookie = SimpleCookie(text).get(self.cookie)
        except CookieError:
            return False
        return cookie is not None and is_token(cookie.value, self.token)
