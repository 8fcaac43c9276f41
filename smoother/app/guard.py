"""Who is let in: this computer's browser, with the token, from the app's own page."""

from __future__ import annotations

from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

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
    "content-security-policy": OWN_PAGES,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}
NO_TOKEN = "Open the address that `unocclude app` printed; it contains the token of this page.\n"
WRONG_HOST = "This page is served to this computer alone, under 127.0.0.1.\n"
OTHER_SITE = "Refused: the request came from another site.\n"


def guard(token: str, port: int) -> Middleware:
    """Let requests through that may come: the first with the token, all others with its cookie."""
    door, cookie = LocalDoor(port), f"unocclude-{port}"

    async def answer(request: Request, go_on: RequestResponseEndpoint) -> Response:
        reads, headers = request.method in ("GET", "HEAD"), joined(request.headers.items())
        is_first = request.scope["path"] == "/" and reads
        with_token = is_first and is_token(request.query_params.get("token", ""), token)
        refusal = "" if with_token or is_token(request.cookies.get(cookie, ""), token) else NO_TOKEN
        if why := door.refusal(headers, not reads, by_address=with_token):
            refusal = WRONG_HOST if why == "host" else OTHER_SITE
        response = PlainTextResponse(refusal, 403) if refusal else await go_on(request)
        for name, value in _HEADERS.items():
            response.headers.setdefault(name, value)
        if with_token and not refusal:
            response.set_cookie(cookie, token, httponly=True, samesite="strict")
        return response

    return Middleware(BaseHTTPMiddleware, dispatch=answer)
