"""The app's server: who is let in, its addresses, what each does with the folder; one a folder."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
import socket
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import anyio
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from .. import __version__
from ..errors import UnoccludeError
from ..io.tables.recording_toml import read_templates, template_text
from ..io.tables.video import is_model
from ..runtime.local_requests import is_token, joined, refusal
from . import steps
from .folder import (
    AppError,
    AppFolder,
    Choices,
    JobDesk,
    KeptRecording,
    changed,
    file_name,
    link_file,
    one_line,
    read_kept,
    refuse_busy,
    slug,
    write_kept,
)

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
    cookie = f"unocclude-{port}"

    async def answer(request: Request, go_on: RequestResponseEndpoint) -> Response:
        reads, headers = request.method in ("GET", "HEAD"), joined(request.headers.items())
        is_first = request.scope["path"] == "/" and reads
        with_token = is_first and is_token(request.query_params.get("token", ""), token)
        refused = "" if with_token or is_token(request.cookies.get(cookie, ""), token) else NO_TOKEN
        if why := refusal(headers, port, not reads, by_address=with_token):
            refused = WRONG_HOST if why == "host" else OTHER_SITE
        response = PlainTextResponse(refused, 403) if refused else await go_on(request)
        for name, value in _HEADERS.items():
            response.headers.setdefault(name, value)
        if with_token and not refused:
            response.set_cookie(cookie, token, httponly=True, samesite="strict")
        return response

    return Middleware(BaseHTTPMiddleware, dispatch=answer)


WEB = Path(__file__).parent / "web"
#: Bytes of a request's JSON at most.
_LONGEST_JSON = 1_000_000
#: Bytes of an upload written at a time, and bytes that stay free on the disk.
_BLOCK, RESERVE_BYTES = 1 << 20, 200_000_000
NO_SPACE = "no space left on the disk; make room and run again"


def make_app(folder: AppFolder, desk: JobDesk, token: str, port: int) -> Starlette:
    """The application."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        try:
            yield
        finally:
            await anyio.to_thread.run_sync(desk.close)

    one = "/api/recordings/{id}"
    answers: list[tuple[str, str, Callable[[_Asked], Any]]] = [
        ("GET", "/api/state", lambda asked: steps.overview(asked.folder, __version__)),
        ("POST", "/api/recordings", _add),
        ("GET", one, _one),
        ("PATCH", one, _change),
        ("DELETE", one, _remove),
        ("GET", f"{one}/streams", lambda asked: steps.streams(asked.folder, asked.id)),
        ("DELETE", f"{one}/files/{{name}}", _drop_file),
        ("POST", f"{one}/jobs", _begin),
        ("POST", f"{one}/cancel", lambda asked: asked.desk.cancel(asked.place)),
        ("POST", f"{one}/template", _template),
        ("POST", "/api/batch", _batch),
        ("GET", "/results/{id}/{name:path}", _result),
    ]
    app = Starlette(
        routes=[
            Route(f"{one}/files/{{name}}", _upload, methods=["PUT"]),
            *(Route(path, _asking(answer), methods=[how]) for how, path, answer in answers),
            Mount("/", StaticFiles(directory=WEB, html=True)),
        ],
        middleware=[guard(token, port)],
        exception_handlers={UnoccludeError: _said, OSError: _said},
        lifespan=lifespan,
    )
    app.state.folder, app.state.desk, app.state.changing = folder, desk, threading.Lock()
    return app


class _Asked:
    """What a request asks for, of which folder."""

    def __init__(self, request: Request, wish: dict[str, Any]) -> None:
        self.request, self.wish = request, wish
        self.folder: AppFolder = request.app.state.folder
        self.desk: JobDesk = request.app.state.desk
        self.id: str = request.path_params.get("id", "")
        self.name: str = request.path_params.get("name", "")

    @property
    def place(self) -> Path:
        """The folder of its recording."""
        return self.folder.of(self.id)


def _asking(answer: Callable[[_Asked], Any]) -> Callable[[Request], Awaitable[Response]]:
    """A function of what is asked, as a handler that runs in a thread; one change is made at a time."""

    async def handle(request: Request) -> Response:
        asked = _Asked(request, await _body(request) if request.method in ("POST", "PATCH") else {})
        changing = nullcontext() if request.method == "GET" else request.app.state.changing

        def work() -> Any:
            with changing:
                return answer(asked)

        result = await anyio.to_thread.run_sync(work)
        return result if isinstance(result, Response) else JSONResponse(result or {})

    return handle


def _said(_: Request, error: Exception) -> Response:
    """An error as one sentence."""
    sentence, status = str(error), error.status if isinstance(error, AppError) else 400
    if isinstance(error, OSError):
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        name = f"{Path(os.fsdecode(error.filename)).name}: " if error.filename else ""
        sentence = name + (NO_SPACE if full else f"{error.strerror or error}")
        status = 507 if full else 500
    return JSONResponse({"error": sentence}, status)


async def _body(request: Request) -> dict[str, Any]:
    """A request's object."""
    data = b""
    async for chunk in request.stream():
        data += chunk
        if len(data) > _LONGEST_JSON:
            raise AppError("The request is too long.", 413)
    try:
        values = json.loads(data or b"{}")
        json.dumps(values, ensure_ascii=False).encode()  # half a character cannot be kept
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise AppError("The request is not a JSON object that can be kept.")
    return values


def _add(asked: _Asked) -> Any:
    name, person = (one_line(asked.wish.get(key, "")) for key in ("name", "person"))
    return {"id": asked.folder.add(KeptRecording(name=name or "Recording", person=person))}


def _one(asked: _Asked) -> Any:
    return steps.recording(asked.folder, asked.id)


def _change(asked: _Asked) -> Any:
    write_kept(asked.place, changed(read_kept(asked.place), asked.wish))
    return _one(asked)


def _remove(asked: _Asked) -> Any:
    refuse_busy(asked.place)
    return {"moved_to": str(asked.folder.remove(asked.id))}


async def _upload(request: Request) -> Response:
    """Write a dropped file to the disk as it comes; it is there whole or not at all."""
    asked = _Asked(request, {})
    place, name = asked.place, file_name(asked.name)
    refuse_busy(place)
    length = request.headers.get("content-length", "")
    free = shutil.disk_usage(place).free - RESERVE_BYTES
    if length.isdecimal() and int(length) > free:
        raise AppError(f"{name}: {NO_SPACE}", 507)
    beside = place / "files" / f".{secrets.token_hex(8)}.part"
    try:
        async with await anyio.open_file(beside, "wb") as file:
            block = bytearray()
            async for chunk in request.stream():
                block += chunk
                if len(block) >= _BLOCK:
                    if shutil.disk_usage(place).free < RESERVE_BYTES + len(block):  # no length was stated
                        raise AppError(f"{name}: {NO_SPACE}", 507)
                    await file.write(block)
                    block = bytearray()
            await file.write(block)
        await anyio.to_thread.run_sync(os.replace, beside, place / "files" / name)
        if name.endswith(".task") and is_model(place / "files" / name):
            link_file(place / "files" / name, asked.folder.models / name)
    except ClientDisconnect:
        return Response(status_code=400)  # the client is gone
    finally:
        with suppress(OSError):
            beside.unlink()
    return JSONResponse({"name": name})


def _drop_file(asked: _Asked) -> Any:
    refuse_busy(asked.place)
    with suppress(FileNotFoundError):
        (asked.place / "files" / file_name(asked.name)).unlink()
    return _one(asked)


def _begin(asked: _Asked) -> Any:
    wish = asked.wish
    begin(asked, asked.place, str(wish.get("kind", "")), bool(wish.get("anyway")), wish.get("formats"))
    return _one(asked)


def begin(asked: _Asked, place: Path, kind: str, anyway: bool = False, formats: object = ()) -> None:
    """Put a recording's job on the desk."""
    chosen = [str(each) for each in formats] if isinstance(formats, list) else []
    kinds: dict[str, Callable[[], list[steps.Step]]] = {
        "describe": lambda: steps.describe_steps(asked.folder, place),
        "check": lambda: steps.check_steps(asked.folder, place),
        "recover": lambda: steps.recover_steps(asked.folder, place, anyway),
        "export": lambda: steps.export_steps(place, chosen),
    }
    if kind not in kinds:
        raise AppError("There is no such job.")
    asked.desk.add(place, kind, kinds[kind](), steps.stamp(asked.folder, place))


def _template(asked: _Asked) -> Any:
    """Keep how a table is read, and look at the files again."""
    folder, place, wish = asked.folder, asked.place, asked.wish
    refuse_busy(place)
    about = [each for each in steps.described(place) if Path(each["file"]).name == wish.get("file")]
    if not about or about[0].get("guess") is None:
        raise AppError("There is no such table among the files of this recording.")
    names, rows = about[0]["guess"]["names"], about[0]["guess"]["rows"]
    width = len(rows[0]) if rows else len(names)
    columns, keys, kind = wish.get("columns"), wish.get("keys"), wish.get("kind")
    if not isinstance(columns, dict) or not isinstance(keys, dict) or kind not in ("imu", "skeleton"):
        raise AppError("A template defines the columns.")
    if not all(isinstance(value, str | int | float) for value in (*columns.values(), *keys.values())):
        raise AppError("A column or key of the template has a value that cannot be.")
    title = one_line(wish.get("title", "")) or "Table"
    # of one layout and name the second replaces the first
    layout = hashlib.sha256(f"{width}\0{chr(0).join(names)}".encode("utf-8", "replace")).hexdigest()[:8]
    trial = folder.hidden / f".{secrets.token_hex(8)}.toml"
    try:
        trial.write_text(template_text(title, kind, names, width, columns, keys), encoding="utf-8")
        read_templates([trial])[0].read(place / "files" / str(wish["file"]))  # said now, not at the import
        os.replace(trial, folder.templates / f"{slug(title) or 'table'}-{layout}.toml")
    except UnoccludeError as error:
        raise AppError(str(error).replace(str(trial), "The template")) from error
    finally:
        with suppress(OSError):
            trial.unlink()
    begin(asked, place, "describe")
    return _one(asked)


def _batch(asked: _Asked) -> Any:
    """Recover many recordings, all with the choices of one where it is named."""
    folder, names, like = asked.folder, asked.wish.get("ids", []), asked.wish.get("like")
    if not isinstance(names, list) or not names:
        raise AppError("Choose recordings first.")
    places = [folder.of(str(name)) for name in names]
    pattern = read_kept(folder.of(str(like))).choices.model_dump() if like else None
    begun, refused = 0, []
    for place in places:
        kept = read_kept(place)
        try:
            if pattern is not None:
                own = kept.choices.model_dump(include={"places", "left_out"})
                mine = set(steps.sensor_keys(steps.described(place)))
                own["places"] |= {key: worn for key, worn in pattern["places"].items() if key in mine}
                update = {"choices": Choices(**(pattern | own)), "revision": kept.revision + 1}
                write_kept(place, kept.model_copy(update=update))
            begin(asked, place, "recover", anyway=True)
            begun += 1
        except AppError as error:
            refused.append(f"{kept.name}: {error}")
    return {"begun": begun, "refused": refused}


def _result(asked: _Asked) -> Response:
    """A result: a report opens in the page's frame, all else is taken away."""
    exported = (f"exports/{each}" for each in steps.EXPORTS.values())
    path = asked.place / asked.name
    known = (*steps.DOWNLOADS, steps.recording_of(asked.place), *exported)
    if asked.name not in known or not path.is_file():
        raise AppError("There is no such file.", 404)
    if path.suffix == ".html":
        taken = path.name if "download" in asked.request.query_params else None
        policy = {"content-security-policy": REPORTS}
        return FileResponse(path, media_type="text/html", headers=policy, filename=taken)
    return FileResponse(path, media_type="application/octet-stream", filename=path.name)


#: The only address where it is served.
ADDRESS = "127.0.0.1"
#: Connections at a time: a browser opens 6, and a process may have 256 files open (macOS). Those that ask
#: nothing are closed after this time, s.
MOST_CONNECTIONS, IDLE_S = 64, 5


def serve(folder: AppFolder, port: int | None, ready: Callable[[str], None]) -> None:
    """Serve a folder until the process is stopped."""
    import uvicorn
    from filelock import FileLock, Timeout

    token = secrets.token_urlsafe(24)  # of this start alone

    class Announcing(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            ready(f"http://{ADDRESS}:{number}/?token={token}")

    try:
        with FileLock(folder.hidden / "server.lock", timeout=0), _listening(port or 0) as listener:
            number = int(listener.getsockname()[1])
            config = uvicorn.Config(
                make_app(folder, JobDesk(folder), token, number),
                http="h11",
                limit_concurrency=MOST_CONNECTIONS,
                timeout_keep_alive=IDLE_S,
                log_config=None,
                log_level="critical",
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=3,
                ws="none",
            )
            try:
                with suppress(KeyboardInterrupt):  # Ctrl-C is how it ends
                    Announcing(config).run(sockets=[listener])
            finally:
                with suppress(OSError):
                    (folder.hidden / "open.html").unlink()
    except Timeout:
        raise UnoccludeError(
            f"{folder.path} is open in another `unocclude app`; use its page, or end it first"
        ) from None


def _listening(port: int) -> socket.socket:
    """A socket that listens on this computer's own address alone."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if os.name == "posix":  # elsewhere it would let two programs share the port
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((ADDRESS, port))
        listener.listen(MOST_CONNECTIONS)
    except (OSError, OverflowError):
        listener.close()
        raise UnoccludeError(f"port {port} is in use; give another --port, or none") from None
    return listener


def redirect_file(folder: AppFolder, address: str) -> Path:
    """A file for its owner alone that opens an address: other users can read a browser's command line."""
    path = folder.hidden / "open.html"
    with suppress(OSError):
        path.unlink()
    text = f'<!doctype html><meta http-equiv="refresh" content="0;url={address}"><title>unocclude</title>'
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(text)
    return path
