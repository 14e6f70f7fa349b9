"""Function `watch`: serve the live page of a study."""

from __future__ import annotations

import errno
import ipaddress
import secrets
import signal
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Final

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase._common.process.signals import last_signal
from cornercase._common.unknown_names import suggest_arguments
from cornercase.report.live._analysis_worker import AnalysisWorker
from cornercase.report.live._follower import StudyFollower
from cornercase.report.live._page_event_stream import EventStream
from cornercase.study._study_file import open_study

_MAX_PORT: Final = 65535
# Seconds for which the server waits for open connections when it stops.
_SHUTDOWN_SECONDS: Final = 2
_BACKLOG: Final = 100


@suggest_arguments
def watch(
    study: Path | str,
    *,
    port: int = 0,
    host: str = "127.0.0.1",
    scenario: Path | str | None = None,
    browser: bool = False,
    show: Callable[[str], object] = print,
) -> None:
    """Serve the report of a study as a live page, which grows with the study, until interrupted.

    The study is only read, except for notes written on the page. It may be created, replaced or resumed later.

    Parameters
    ----------
    study : path
        File of the study; it need not exist yet.
    port : int, default 0
        Port of the page; 0 for a free one.
    host : str, default "127.0.0.1"
        Address of the network interface. With another interface than the default, other machines can connect if they
        know the token in the address of the page.
    scenario : path, optional
        Scenario file that was explored, from which the page makes concrete scenarios. By default the file is searched
        where this machine explored it, then beside the study and in the current folder.
    browser : bool, default False
        Open the page in the browser.
    show : callable, default print
        Called with a sentence that contains the address of the page.

    Raises
    ------
    InputError
        The extra ``live`` is not installed, the address cannot be served, or the file is not a study.

    See Also
    --------
    cornercase.write_report : Write the same page as a file.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.watch("study.db", browser=True)  # doctest: +SKIP
    """
    path = validation.check_path("study", study)
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a file; name the file of a study.")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; make it, or correct the path.")
    if path.exists() and path.stat().st_size:
        # An empty file may still become a study; any other file that is not a study may not.
        with open_study(path, readonly=True):
            pass
    file = None if scenario is None else validation.check_path("scenario", scenario)
    if file is not None and not file.is_file():
        raise InputError(f"`scenario` {file}: there is no such file.")
    number = validation.check_int("port", port, maximum=_MAX_PORT)
    try:
        import uvicorn

        from cornercase.report.live._server import create_app
    except ModuleNotFoundError as error:
        raise InputError(
            f"The live page needs {error.name}, which is not installed; {describe_install('live')}."
        ) from error
    token = secrets.token_urlsafe(24)
    follower = StudyFollower(path)
    analysis_worker = AnalysisWorker(follower, file)
    with _bind(host, number) as listening:
        servers: list[uvicorn.Server] = []
        app = create_app(
            path, EventStream(follower, analysis_worker), token, file, lambda: bool(servers) and servers[0].should_exit
        )
        # No access log, as it would contain the token.
        config = uvicorn.Config(
            app, log_level="error", access_log=False, timeout_graceful_shutdown=_SHUTDOWN_SECONDS, lifespan="off",
            server_header=False, limit_concurrency=100,
        )  # fmt: skip
        servers.append(uvicorn.Server(config))
        address = _page_address(listening, token)
        show(f"The page of {path} is {address}")
        follower.start()
        analysis_worker.start()
        if browser:
            # The socket is already listening, so the browser waits for the response.
            webbrowser.open(address)
        try:
            servers[0].run(sockets=[listening])
        except KeyboardInterrupt:
            # Ctrl-C is the normal way to end the server.
            if last_signal() != signal.SIGINT:
                raise
        finally:
            analysis_worker.stop()
            follower.stop()


def _bind(host: str, port: int) -> socket.socket:
    try:
        kind = socket.AF_INET6 if ipaddress.ip_address(host).version == 6 else socket.AF_INET
    except ValueError:
        raise InputError(f"`host` {host}: give the address of an interface, such as 127.0.0.1.") from None
    try:
        return socket.create_server((host, port), family=kind, backlog=_BACKLOG)
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise InputError(f"`host` {host}: this machine has no such address; give 127.0.0.1.") from error
        raise InputError(
            f"`port` {port}: nothing can be served at {host} ({error.strerror}); choose another port."
        ) from error


def _page_address(listening: socket.socket, token: str) -> str:
    host, port = listening.getsockname()[:2]
    display_host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{display_host}:{port}/?token={token}"
