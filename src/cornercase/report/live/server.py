"""HTTP server of the live page."""

from __future__ import annotations

import asyncio
import base64
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from cornercase._common.errors import InputError
from cornercase._common.files import portable_name
from cornercase.report.live.access import Guard
from cornercase.report.live.telling import Cursor, Teller
from cornercase.report.packing import pack_recordings
from cornercase.report.page import POLICY, fill_frame
from cornercase.report.rerun import why_kept, write_one
from cornercase.study import LONGEST_NOTE, Study, explored_scenario, write_note

# Seconds between two polls for events, and between heartbeats.
_PAUSE: Final = 0.1
_HEARTBEAT: Final = 10.0
_DIGITS: Final = 18
_LONGEST_BODY: Final = 4 * LONGEST_NOTE + 64
_POLICY: Final = f"{POLICY}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"


class _Answers:
    def __init__(self, path: Path, teller: Teller, scenario: Path | None, is_ending: Callable[[], bool]) -> None:
        self._path = path
        self._teller = teller
        self._scenario = scenario
        self._is_ending = is_ending

    def page(self, request: Request) -> Response:
        return HTMLResponse(fill_frame(self._path.stem))

    def contents(self, request: Request) -> Response:
        return JSONResponse(self._teller.contents())

    async def events(self, request: Request) -> Response:
        since = request.headers.get("last-event-id") or request.query_params.get("since", "")
        return StreamingResponse(self._stream(Cursor.of(since)), media_type="text/event-stream")

    async def _stream(self, cursor: Cursor) -> AsyncIterator[str]:
        write = self._teller.write_events(cursor)
        yield "retry: 1000\n\n"
        last_sent = time.monotonic()
        while not self._is_ending():
            news = await run_in_threadpool(lambda: "".join(write()))
            if not news and time.monotonic() - last_sent > _HEARTBEAT:
                news = ": still here\n\n"
            if news:
                last_sent = time.monotonic()
                yield news
            await asyncio.sleep(_PAUSE)

    def _require_same(self, request: Request) -> None:
        epoch = request.query_params.get("epoch")
        if epoch is not None and epoch != self._teller.follower.epoch:
            raise InputError("The study was replaced by another one.")

    def recording(self, request: Request) -> Response:
        self._require_same(request)
        with Study.open(self._path, readonly=True) as study:
            (block,) = pack_recordings(study, [_id(request)]).blocks
        return Response(base64.b64decode(block), media_type="application/octet-stream")

    def table(self, request: Request) -> Response:
        self._require_same(request)
        scenario = _id(request)
        with Study.open(self._path, readonly=True) as study, tempfile.TemporaryDirectory() as folder:
            study.recording(scenario).to_csv(Path(folder) / "recording.csv")
            content = (Path(folder) / "recording.csv").read_bytes()
            return _download(content, f"{study.meta.title}-{scenario:05}.csv", "text/csv; charset=utf-8")

    def scenario(self, request: Request) -> Response:
        self._require_same(request)
        scenario = _id(request)
        with Study.open(self._path, readonly=True) as study:
            explored = explored_scenario(study, self._scenario)
            if explored is None:
                raise InputError("Imported recordings have no scenario file.")
            rows = study.rows_from(scenario)
            if not rows or rows[0].id != scenario:
                raise InputError(f"There is no scenario {scenario}.")
            content = write_one(study.meta, explored, rows[0], why_kept(study).get(scenario))
            return _download(content, f"{study.meta.title}-{scenario:05}.xosc", "application/xml")

    async def note(self, request: Request) -> Response:
        self._require_same(request)
        body = b""
        try:
            async for chunk in request.stream():
                body += chunk
                if len(body) > _LONGEST_BODY:
                    raise InputError(f"The note is too long; at most {LONGEST_NOTE} characters are kept.")
            note = body.decode("utf-8")
        except (UnicodeDecodeError, ClientDisconnect):
            raise InputError("The note is not UTF-8 text.") from None
        await run_in_threadpool(write_note, self._path, _id(request), note)
        return Response(status_code=204)


def make_app(path: Path, teller: Teller, token: str, scenario: Path | None, is_ending: Callable[[], bool]) -> Any:
    """Return the ASGI application that serves the live page of the study at `path`.

    Every request must contain `token`; `is_ending` returns whether the server shuts down.
    """
    answers = _Answers(path, teller, scenario, is_ending)
    app = Starlette(
        routes=[
            Route("/", answers.page),
            Route("/contents", answers.contents),
            Route("/events", answers.events),
            Route("/recordings/{id}.csv", answers.table),
            Route("/recordings/{id}", answers.recording),
            Route("/scenarios/{id}.xosc", answers.scenario),
            Route("/notes/{id}", answers.note, methods=["PUT"]),
        ],
        exception_handlers={InputError: _tell_error},
    )
    return Guard(app, token, _POLICY)


async def _tell_error(request: Request, error: Exception) -> Response:
    return PlainTextResponse(f"{error}\n", status_code=404 if request.method in ("GET", "HEAD") else 400)


def _id(request: Request) -> int:
    text = request.path_params["id"]
    # Limited in length, as parsing very long numbers is slow.
    if not (text.isascii() and text.isdecimal() and len(text) <= _DIGITS):
        raise InputError("A scenario id is a number.")
    return int(text)


def _download(content: bytes, name: str, kind: str) -> Response:
    plain = portable_name(name).encode("ascii", "replace").decode().replace("?", "-")
    return Response(content, media_type=kind, headers={"content-disposition": f'attachment; filename="{plain}"'})
