"""The live page: the arm, an angle and a target in a browser of this computer, for the patient."""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from queue import Empty, SimpleQueue
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..live.answers import LiveOutput, LiveState
from ..live.arm_angles import TITLES, live_angles
from ..measurements.visibility import Gap
from ..recording import JOINTS
from ..runtime.local_requests import LOOPBACK, LocalDoor, is_token, joined
from .arrivals import FrameRows, SourceInfo

PAGE_PORT = 8766
#: The page is sent no more than this often, s; without news this is sent that often that it lives.
_EACH_S, _ALIVE_S = 1 / 60, 1.0
#: A browser that takes nothing for this long is let go, s.
_PATIENCE_S = 5.0
#: What a browser may send: a mark of this many letters, this many bytes.
_LONGEST_MARK, _LONGEST_BODY = 200, 2000
_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
#: The page may load nothing from elsewhere, and be shown in no other page.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-ancestors 'none'"
)


class LivePage:
    """Serves the page on this computer alone, to who has its address; a receiver.

    The address contains a token, and requests of other pages that the browser shows are refused by their Host
    and Origin. A slow browser does not delay the others: it misses moments.

    Parameters
    ----------
    info : SourceInfo
        Of the session.
    port : int
        0 takes a free one.
    others : sequence of SourceInfo
        Of the same person's other arm, shown beside it.

    Raises
    ------
    UnoccludeError
        The port is taken.
    """

    def __init__(self, info: SourceInfo, port: int = PAGE_PORT, others: Sequence[SourceInfo] = ()):
        self._sides = [each.side for each in (info, *others)]
        self._downs = [each.down for each in (info, *others)]
        self._axes = [_view(down) for down in self._downs]
        self._others: dict[int, dict[str, Any]] = {}
        self._token = secrets.token_urlsafe(18)
        self._news = threading.Condition()
        self._text, self._number, self._sent_s = "", 0, -np.inf
        self._events: list[str] = []
        self._marks: SimpleQueue[str] = SimpleQueue()
        self._closing = threading.Event()
        try:
            self._server = ThreadingHTTPServer((LOOPBACK, port), self._handler())
        except OSError as error:
            raise UnoccludeError(
                f"port {port} of {LOOPBACK} cannot be used for the page ({error.strerror or error}); give"
                " another with --page"
            ) from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """What is opened in a browser; whoever has it sees the session."""
        return f"http://{LOOPBACK}:{self.port}/?token={self._token}"

    def send(
        self,
        output: LiveOutput,
        frames: FrameRows,
        gap: Gap | None,
        events: Sequence[str],
        number: int = 0,
    ) -> None:
        """Show what a step answered of an arm, some 60 times per second; the last arm's sends them all."""
        named = [f"{self._sides[number]} arm: {text}" for text in events] if self._sides[1:] else events
        self._events = [*self._events, *named][-4:]
        if number < len(self._sides) - 1:
            self._others[number] = self._shown(output, number)
            return
        if abs(time.monotonic() - self._sent_s) < 0.9 * _EACH_S:
            return
        self._sent_s = time.monotonic()
        arms = [*(self._others[each] for each in sorted(self._others)), self._shown(output, number)]
        text = json.dumps({"arms": arms, "events": self._events}, allow_nan=False)
        with self._news:
            self._text, self._number = text, self._number + 1
            self._news.notify_all()

    def marks(self) -> list[str]:
        """What was marked in the browser since the last call."""
        found: list[str] = []
        try:
            while True:
                found.append(self._marks.get_nowait())
        except Empty:
            return found

    def close(self) -> None:
        """Let all browsers go."""
        self._closing.set()
        with self._news:
            self._news.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(_PATIENCE_S)

    def _shown(self, output: LiveOutput, number: int) -> dict[str, Any]:
        """What the page draws of an arm's answer."""
        shown: dict[str, Any] = {
            "t": round(output.now_s, 3),
            "side": self._sides[number],
            "state": str(output.state),
            "light": light_of(output),
            "why": output.doubt or output.calibration,
            "joints": {},
            "angles": {},
        }
        now = output.now
        if now is None:
            return shown
        shown["sigma_cm"] = round(100 * now.sigma_m, 1)
        shown["gap_s"] = None if now.since_s is None else round(now.t_s - now.since_s, 2)
        shown["joints"] = {
            joint: [round(float(value), 4) for value in self._axes[number] @ now.joints[joint]]
            for joint in JOINTS
            if joint in now.joints and np.isfinite(now.joints[joint]).all()
        }
        angles = live_angles(now, self._downs[number])
        shown["angles"] = {
            name: [round(value, 1), round(min(sigma, 180.0), 1)]
            for name, (value, sigma) in angles.items()
            if np.isfinite(value) and np.isfinite(sigma)
        }
        return shown

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        page = self

        class PageHandler(BaseHTTPRequestHandler):
            """Answers one browser."""

            timeout = _PATIENCE_S
            protocol_version = "HTTP/1.1"

            def log_message(self, *_: Any) -> None:
                """The terminal is the dashboard's."""

            def do_GET(self) -> None:
                """The page and its files; the answers as events."""
                path = urlsplit(self.path).path
                if not page._may(self, sends=False):
                    return
                if path == "/events":
                    page._stream(self)
                elif path in ("/", "/live.js", "/live.css"):
                    name = path[1:] or "live.html"
                    page._reply(self, _TYPES[name.rpartition(".")[2]], page._file(name))
                else:
                    page._refuse(self, HTTPStatus.NOT_FOUND, "there is no such page")

            def do_POST(self) -> None:
                """A mark."""
                if page._may(self, sends=True):
                    page._take_mark(self)

        return PageHandler

    def _file(self, name: str) -> bytes:
        """A file of the page; the token is in its links."""
        text = files("smoother.streams").joinpath("web", name).read_text("utf-8")
        sides = self._sides if self._sides[1:] else [""]
        titles = json.dumps(
            [
                [number, name, f"{title}, {side}" if side else title]
                for number, side in enumerate(sides)
                for name, title in TITLES.items()
            ]
        )
        return (
            text.replace("%TOKEN%", self._token).replace("%ANGLES%", titles.replace('"', "&quot;")).encode()
        )

    def _may(self, request: BaseHTTPRequestHandler, sends: bool) -> bool:
        """Whether a request comes from the page itself, with its token; else it is refused."""
        token = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        refusal = LocalDoor(self.port).refusal(joined(request.headers.items()), changes=sends)
        if refusal is None and is_token(token, self._token):
            return True
        self._refuse(request, HTTPStatus.FORBIDDEN, "open the address that `unocclude live --page` printed")
        return False

    def _refuse(self, request: BaseHTTPRequestHandler, status: HTTPStatus, sentence: str) -> None:
        request.close_connection = True
        self._reply(request, "text/plain", sentence.encode(), status)

    def _reply(
        self, request: BaseHTTPRequestHandler, kind: str, body: bytes, status: HTTPStatus = HTTPStatus.OK
    ) -> None:
        request.send_response(status)
        for key, value in (
            ("Content-Type", f"{kind}; charset=utf-8"),
            ("Content-Length", str(len(body))),
            ("Content-Security-Policy", _POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cache-Control", "no-store"),
        ):
            request.send_header(key, value)
        request.end_headers()
        request.wfile.write(body)

    def _stream(self, request: BaseHTTPRequestHandler) -> None:
        """The newest answer as it comes, until the browser goes."""
        request.close_connection = True
        request.send_response(HTTPStatus.OK)
        request.send_header("Content-Type", "text/event-stream")
        request.send_header("Cache-Control", "no-store")
        request.end_headers()
        number = -1
        try:
            while not self._closing.is_set():
                with self._news:
                    self._news.wait_for(
                        lambda seen=number: self._number != seen or self._closing.is_set(),  # type: ignore[misc]
                        _ALIVE_S,
                    )
                    text = self._text if self._number != number else ""
                    number = self._number
                request.wfile.write(f"data: {text}\n\n".encode() if text else b": alive\n\n")
        except OSError:  # the browser has gone, or takes nothing
            return

    def _take_mark(self, request: BaseHTTPRequestHandler) -> None:
        length = request.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > _LONGEST_BODY:
            self._refuse(request, HTTPStatus.BAD_REQUEST, "a mark is a short text")
            return
        text = request.rfile.read(int(length)).decode("utf-8", "replace")
        plain = "".join(letter if letter.isprintable() else " " for letter in text).strip()[:_LONGEST_MARK]
        if plain:
            self._marks.put(plain)
        self._reply(request, "text/plain", b"")


def light_of(output: LiveOutput) -> str:
    """How good the answer is, in one word: `seen`, `recovered` (with care: `unsure`), `lost`."""
    if output.now is None:
        return "wait" if output.state is LiveState.CALIBRATING else "lost"
    if output.doubt:
        return "unsure"
    return "seen" if output.state is LiveState.VISIBLE else "recovered"


def _view(down: FloatArray | None) -> FloatArray:
    """Rows of what is right, up and towards the camera for who looks as it does, (3, 3)."""
    up = np.array([0.0, -1.0, 0.0]) if down is None else -np.asarray(down) / np.linalg.norm(down)
    right = np.array([1.0, 0.0, 0.0]) - up[0] * up
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 0.1 else np.array([0.0, 0.0, 1.0])
    return np.stack([right, up, np.cross(right, up)])
