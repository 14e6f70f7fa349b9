"""HTTP server of the live page."""

from __future__ import annotations

import asyncio
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
from cornercase._common.io.files import make_portable_file_name
from cornercase.report._event_payload import find_events_of_scenario
from cornercase.report._report_page import CONTENT_SECURITY_POLICY, render_live_page
from cornercase.report._rerun import read_selection_reasons, render_concrete_scenario
from cornercase.report.live._auth import TokenAuth
from cornercase.report.live._page_event_stream import Cursor, EventStream
from cornercase.study import StudyFile, write_note
from cornercase.study._notes import MAX_NOTE_LENGTH
from cornercase.study._scenario_file import find_explored_scenario

# Seconds between two polls for events, and between heartbeats.
_POLL_SECONDS: Final = 0.1
_HEARTBEAT_SECONDS: Final = 10.0
_MAX_ID_DIGITS: Final = 18
_MAX_NOTE_BYTES: Final = 4 * MAX_NOTE_LENGTH + 64
_CONTENT_SECURITY_POLICY: Final = (
    f"{CONTENT_SECURITY_POLICY}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class _Endpoints:
    def __init__(
        self, path: Path, event_stream: EventStream, scenario: Path | None, is_ending: Callable[[], bool]
    ) -> None:
        self._path = path
        self._event_stream = event_stream
        self._scenario_path = scenario
        self._is_ending = is_ending

    def page(self, request: Request) -> Response:
        return HTMLResponse(render_live_page(self._path.stem))

    def contents(self, request: Request) -> Response:
        return JSONResponse(self._event_stream.contents())

    async def events(self, request: Request) -> Response:
        since = request.headers.get("last-event-id") or request.query_params.get("since", "")
        return StreamingResponse(self._stream_events(Cursor.parse(since)), media_type="text/event-stream")

    async def _stream_events(self, cursor: Cursor) -> AsyncIterator[str]:
        write = self._event_stream.event_writer(cursor)
        yield "retry: 1000\n\n"
        last_sent = time.monotonic()
        while not self._is_ending():
            news = await run_in_threadpool(lambda: "".join(write()))
            if not news and time.monotonic() - last_sent > _HEARTBEAT_SECONDS:
                news = ": still here\n\n"
            if news:
                last_sent = time.monotonic()
                yield news
            await asyncio.sleep(_POLL_SECONDS)

    def _require_same_epoch(self, request: Request) -> None:
        epoch = request.query_params.get("epoch")
        if epoch is not None and epoch != self._event_stream.follower.epoch:
            raise InputError("The study was replaced by another one.")

    def recording(self, request: Request) -> Response:
        self._require_same_epoch(request)
        with StudyFile.open(self._path, readonly=True) as study:
            content = study.rounded_recording(_scenario_id(request))
        return Response(content, media_type="application/octet-stream")

    def scenario_events(self, request: Request) -> Response:
        self._require_same_epoch(request)
        with StudyFile.open(self._path, readonly=True) as study:
            return JSONResponse(find_events_of_scenario(study, _scenario_id(request)))

    def recording_csv(self, request: Request) -> Response:
        self._require_same_epoch(request)
        scenario = _scenario_id(request)
        with StudyFile.open(self._path, readonly=True) as study, tempfile.TemporaryDirectory() as folder:
            study.recording(scenario).to_csv(Path(folder) / "recording.csv")
            content = (Path(folder) / "recording.csv").read_bytes()
            return _download_response(content, f"{study.meta.title}-{scenario:05}.csv", "text/csv; charset=utf-8")

    def scenario_file(self, request: Request) -> Response:
        self._require_same_epoch(request)
        scenario = _scenario_id(request)
        with StudyFile.open(self._path, readonly=True) as study:
            explored = find_explored_scenario(study, self._scenario_path)
            if explored is None:
                raise InputError("Imported recordings have no scenario file.")
            rows = study.rows_from_id(scenario)
            if not rows or rows[0].id != scenario:
                raise InputError(f"There is no scenario {scenario}.")
            content = render_concrete_scenario(
                study.meta, explored, rows[0], read_selection_reasons(study).get(scenario)
            )
            return _download_response(content, f"{study.meta.title}-{scenario:05}.xosc", "application/xml")

    async def save_note(self, request: Request) -> Response:
        self._require_same_epoch(request)
        body = b""
        try:
            async for chunk in request.stream():
                body += chunk
                if len(body) > _MAX_NOTE_BYTES:
                    raise InputError(f"The note is too long; at most {MAX_NOTE_LENGTH} characters are kept.")
            note = body.decode("utf-8")
        except (UnicodeDecodeError, ClientDisconnect):
            raise InputError("The note is not UTF-8 text.") from None
        await run_in_threadpool(write_note, self._path, _scenario_id(request), note)
        return Response(status_code=204)


def create_app(
    path: Path, event_stream: EventStream, token: str, scenario: Path | None, is_ending: Callable[[], bool]
) -> Any:
    """Return the ASGI application that serves the live page of the study at `path`.

    Every request must contain `token`. `is_ending` returns True once the server shuts down.
    """
    answers = _Endpoints(path, event_stream, scenario, is_ending)
    app = Starlette(
        routes=[
            Route("/", answers.page),
            Route("/contents", answers.contents),
            Route("/events", answers.events),
            Route("/recordings/{id}.csv", answers.recording_csv),
            Route("/recordings/{id}", answers.recording),
            Route("/scenarios/{id}/events", answers.scenario_events),
            Route("/scenarios/{id}.xosc", answers.scenario_file),
            Route("/notes/{id}", answers.save_note, methods=["PUT"]),
        ],
        exception_handlers={InputError: _error_response},
    )
    return TokenAuth(app, token, _CONTENT_SECURITY_POLICY)


async def _error_response(request: Request, error: Exception) -> Response:
    return PlainTextResponse(f"{error}\n", status_code=404 if request.method in ("GET", "HEAD") else 400)


def _scenario_id(request: Request) -> int:
    text = request.path_params["id"]
    # Limited in length, as parsing very long numbers is slow.
    if not (text.isascii() and text.isdecimal() and len(text) <= _MAX_ID_DIGITS):
        raise InputError(f"The scenario id in the address must be a number of at most {_MAX_ID_DIGITS} digits.")
    return int(text)


def _download_response(content: bytes, name: str, kind: str) -> Response:
    plain = make_portable_file_name(name).encode("ascii", "replace").decode().replace("?", "-")
    return Response(content, media_type=kind, headers={"content-disposition": f'attachment; filename="{plain}"'})
