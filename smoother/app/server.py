"""The app's addresses: what each answers, and what it does with the folder."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import anyio
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from ..errors import UnoccludeError
from ..io.tables.recording_toml import read_templates, template_text
from ..io.tables.video import is_model
from . import steps, views
from .folder import (
    AppError,
    AppFolder,
    KeptRecording,
    changed,
    file_name,
    one_line,
    read_kept,
    slug,
    write_json,
    write_kept,
)
from .guard import REPORTS, Guard
from .jobs import JobDesk, refuse_busy

WEB = Path(__file__).parent / "web"
#: Files of the page, and what they are.
_PAGE = {"app.js": "text/javascript", "texts.js": "text/javascript", "app.css": "text/css"}
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
    app = Starlette(
        routes=[
            Route("/", _page),
            Route("/{name}", _asset),
            Route("/api/state", _answer(_state)),
            Route("/api/recordings", _answer(_add), methods=["POST"]),
            Route("/api/loose", _answer(_take_up), methods=["POST"]),
            Route(one, _answer(_one), methods=["GET"]),
            Route(one, _answer(_change), methods=["PATCH"]),
            Route(one, _answer(_remove), methods=["DELETE"]),
            Route(f"{one}/streams", _answer(_streams)),
            Route(f"{one}/files/{{name}}", _answer(_upload), methods=["PUT"]),
            Route(f"{one}/files/{{name}}", _answer(_drop_file), methods=["DELETE"]),
            Route(f"{one}/jobs", _answer(_begin), methods=["POST"]),
            Route(f"{one}/cancel", _answer(_cancel), methods=["POST"]),
            Route(f"{one}/template", _answer(_template), methods=["POST"]),
            Route("/api/batch", _answer(_batch), methods=["POST"]),
            Route("/api/comparisons", _answer(_compare), methods=["POST"]),
            Route("/api/comparisons/{id}", _answer(_comparison)),
            Route("/api/comparisons/{id}/cancel", _answer(_cancel_comparison), methods=["POST"]),
            Route("/results/comparisons/{id}/{name}", _answer(_result)),
            Route("/results/{id}/{name:path}", _answer(_result)),
        ],
        middleware=[Middleware(Guard, token=token, port=port)],
        lifespan=lifespan,
    )
    app.state.folder, app.state.desk = folder, desk
    return app


Handler = Callable[[Request], Awaitable[Any]]


def _answer(handler: Handler) -> Handler:
    """A handler whose errors become one sentence."""

    async def answer(request: Request) -> Response:
        try:
            result = await handler(request)
        except AppError as error:
            return JSONResponse({"error": str(error)}, error.status)
        except UnoccludeError as error:
            return JSONResponse({"error": str(error)}, 400)
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            sentence = NO_SPACE if full else f"{error.strerror or error}"
            return JSONResponse({"error": f"{_name_of(error)}{sentence}"}, 507 if full else 500)
        return result if isinstance(result, Response) else JSONResponse(result)

    return answer


def _name_of(error: OSError) -> str:
    return f"{Path(os.fsdecode(error.filename)).name}: " if error.filename else ""


def _folder(request: Request) -> AppFolder:
    folder: AppFolder = request.app.state.folder
    return folder


def _desk(request: Request) -> JobDesk:
    desk: JobDesk = request.app.state.desk
    return desk


def _place(request: Request) -> Path:
    return _folder(request).of(request.path_params["id"])


def _comparison_place(request: Request) -> Path:
    return _folder(request).comparison(request.path_params["id"])


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


async def _page(_: Request) -> Response:
    return FileResponse(WEB / "app.html", media_type="text/html")


async def _asset(request: Request) -> Response:
    name = request.path_params["name"]
    if name not in _PAGE:
        return JSONResponse({"error": "There is no such page."}, 404)
    return FileResponse(WEB / name, media_type=_PAGE[name])


async def _state(request: Request) -> Any:
    from .. import __version__

    return await anyio.to_thread.run_sync(views.overview, _folder(request), __version__)


async def _add(request: Request) -> Any:
    wish = await _body(request)
    kept = KeptRecording(name=one_line(wish.get("name", "")), person=one_line(wish.get("person", "")))
    kept.name = kept.name or "Recording"
    return {"id": _folder(request).add(kept)}


async def _take_up(request: Request) -> Any:
    """Make a recording of an MCAP file of the folder, and look at it."""
    folder, wish = _folder(request), await _body(request)
    name = await anyio.to_thread.run_sync(folder.take_up, str(wish.get("name", "")))
    begin(folder, _desk(request), folder.of(name), "describe", {})
    return {"id": name}


async def _one(request: Request) -> Any:
    return await anyio.to_thread.run_sync(views.recording, _folder(request), request.path_params["id"])


async def _change(request: Request) -> Any:
    place = _place(request)
    kept = changed(read_kept(place), await _body(request))
    write_kept(place, kept)
    return await _one(request)


async def _remove(request: Request) -> Any:
    refuse_busy(_place(request))
    place = _folder(request).remove(request.path_params["id"])
    return {"moved_to": str(place)}


async def _streams(request: Request) -> Any:
    return await anyio.to_thread.run_sync(views.streams, _folder(request), request.path_params["id"])


async def _upload(request: Request) -> Any:
    """Write a dropped file to the disk as it comes; it is there whole or not at all."""
    place, name = _place(request), file_name(request.path_params["name"])
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
            _folder(request).keep_model(place / "files" / name)
    except ClientDisconnect:
        return Response(status_code=400)  # the client is gone
    finally:
        with suppress(OSError):
            beside.unlink()
    return {"name": name}


async def _drop_file(request: Request) -> Any:
    place, name = _place(request), file_name(request.path_params["name"])
    refuse_busy(place)
    with suppress(FileNotFoundError):
        (place / "files" / name).unlink()
    return await _one(request)


async def _begin(request: Request) -> Any:
    folder, place, wish = _folder(request), _place(request), await _body(request)
    begin(folder, _desk(request), place, str(wish.get("kind", "")), wish)
    return await _one(request)


def begin(folder: AppFolder, desk: JobDesk, place: Path, kind: str, wish: dict[str, Any]) -> None:
    """Put a recording's job on the desk."""
    if kind == "describe":
        todo = steps.describe_steps(folder, place)
    elif kind == "check":
        todo = steps.check_steps(folder, place)
    elif kind == "recover":
        todo = steps.recover_steps(folder, place, bool(wish.get("anyway")))
    elif kind == "export":
        formats = wish.get("formats", [])
        todo = steps.export_steps(place, [str(each) for each in formats] if isinstance(formats, list) else [])
    else:
        raise AppError("There is no such job.")
    desk.add(place, kind, todo, steps.stamp(folder, place))


async def _cancel(request: Request) -> Any:
    _desk(request).cancel(_place(request))
    return {}


async def _template(request: Request) -> Any:
    """Keep how a table is read, and look at the files again."""
    folder, place, wish = _folder(request), _place(request), await _body(request)
    refuse_busy(place)
    about = next(
        (each for each in steps.described(place) if Path(each["file"]).name == wish.get("file")), None
    )
    if about is None or about.get("guess") is None:
        raise AppError("There is no such table among the files of this recording.")
    guess = about["guess"]
    names = guess["names"]
    width = len(guess["rows"][0]) if guess["rows"] else len(names)
    columns, keys = wish.get("columns"), wish.get("keys")
    kind = wish.get("kind")
    if not isinstance(columns, dict) or not isinstance(keys, dict) or kind not in ("imu", "skeleton"):
        raise AppError("A template defines the columns.")
    if not all(isinstance(v, str | int | float) for v in (*columns.values(), *keys.values())):
        raise AppError("A column or key of the template has a value that cannot be.")
    title = one_line(wish.get("title", "")) or "Table"
    text = template_text(title, kind, names, width, columns, keys)
    trial = folder.hidden / f".{secrets.token_hex(8)}.toml"
    try:
        trial.write_text(text, encoding="utf-8")
        read_templates([trial])[0].read(place / "files" / str(wish["file"]))  # said now, not at the import
        os.replace(trial, folder.templates / f"{slug(title) or 'table'}-{_mark(names, width)}.toml")
    except UnoccludeError as error:
        raise AppError(str(error).replace(str(trial), "The template")) from error
    finally:
        with suppress(OSError):
            trial.unlink()
    begin(folder, _desk(request), place, "describe", {})
    return await _one(request)


def _mark(names: list[str], width: int) -> str:
    """Of a layout: a second template for it replaces the first of that name."""
    return hashlib.sha256(f"{width}\0{chr(0).join(names)}".encode("utf-8", "replace")).hexdigest()[:8]


async def _batch(request: Request) -> Any:
    """Recover many recordings, all with the choices of one where it is named."""
    folder, wish = _folder(request), await _body(request)
    names, like = wish.get("ids", []), wish.get("like")
    if not isinstance(names, list) or not names:
        raise AppError("Choose recordings first.")
    places = [folder.of(str(name)) for name in names]
    pattern = read_kept(folder.of(str(like))).choices if like else None
    begun, refused = 0, []
    for place in places:
        kept = read_kept(place)
        try:
            if pattern is not None:
                for key in ("side", "body", "remedy", "imu_starts_at_s", "video_mirrored", "video_turn"):
                    setattr(kept.choices, key, getattr(pattern, key))
                mine = set(steps.sensor_keys(steps.described(place)))
                kept.choices.places |= {k: v for k, v in pattern.places.items() if k in mine}
                kept.revision += 1
                write_kept(place, kept)
            begin(folder, _desk(request), place, "recover", {"anyway": True})
            begun += 1
        except AppError as error:
            refused.append(f"{kept.name}: {error}")
    return {"begun": begun, "refused": refused}


async def _compare(request: Request) -> Any:
    folder, wish = _folder(request), await _body(request)
    person = one_line(wish.get("person", ""))
    if not person:
        raise AppError("Give the recordings a person first.")
    name, place = folder.add_comparison(person)
    todo = steps.compare_steps(folder, place, person)
    write_json(place / "comparison.json", {"person": person})
    _desk(request).add(place, "compare", todo)
    return {"id": name}


async def _comparison(request: Request) -> Any:
    return views.comparison(_folder(request), request.path_params["id"])


async def _cancel_comparison(request: Request) -> Any:
    _desk(request).cancel(_comparison_place(request))
    return {}


async def _result(request: Request) -> Any:
    """A result of a recording or of a comparison: a report opens in the page's frame, all else is taken."""
    name = request.path_params["name"]
    if "/comparisons/" in request.url.path:
        place = _comparison_place(request)
        known = ["progress.html", "progress.json", "progress.csv"]
    else:
        place = _place(request)
        exported = [f"exports/{each}" for each in steps.EXPORTS.values()]
        known = [*views.DOWNLOADS, steps.recording_of(place), *exported]
    if name not in known:
        raise AppError("There is no such file.", 404)
    return _file(place / name, request)


def _file(path: Path, request: Request) -> Response:
    if not path.is_file():
        raise AppError("There is no such file yet.", 404)
    if path.suffix == ".html":
        taken = path.name if "download" in request.query_params else None
        return FileResponse(
            path, media_type="text/html", headers={"content-security-policy": REPORTS}, filename=taken
        )
    return FileResponse(path, media_type="application/octet-stream", filename=path.name)
