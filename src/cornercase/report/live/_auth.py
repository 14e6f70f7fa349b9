"""Authentication of requests to the live server: token and address."""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any, Final
from urllib.parse import parse_qs

_Scope = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[_Scope]]
_Send = Callable[[_Scope], Awaitable[None]]
_App = Callable[[_Scope, _Receive, _Send], Awaitable[None]]

_MAX_QUERY_FIELDS: Final = 20
_SECURITY_HEADERS: Final = (
    (b"cache-control", b"no-store"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)


class TokenAuth:
    """ASGI middleware that rejects requests without the token, or with a host name other than localhost.

    `policy` is the content security policy, which is sent with every response.
    """

    def __init__(self, app: _App, token: str, policy: str) -> None:
        self._app = app
        self._token = token.encode()
        self._headers = [*_SECURITY_HEADERS, (b"content-security-policy", policy.encode())]

    async def __call__(self, scope: _Scope, receive: _Receive, send: _Send) -> None:
        """Pass an ASGI request on to the application, or answer with status 403."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        why = _check_headers(headers) or self._check_token(scope)

        async def send_with_headers(message: _Scope) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *self._headers]
            await send(message)

        if why is None:
            await self._app(scope, receive, send_with_headers)
            return
        body = f"{why}\n".encode()
        plain = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
        await send_with_headers({"type": "http.response.start", "status": 403, "headers": plain})
        await send_with_headers({"type": "http.response.body", "body": body})

    def _check_token(self, scope: _Scope) -> str | None:
        try:
            query = parse_qs(scope["query_string"].decode("latin-1"), max_num_fields=_MAX_QUERY_FIELDS)
        except ValueError:
            query = {}
        token = query.get("token", [""])[-1].encode("utf-8", "replace")
        if secrets.compare_digest(token, self._token):
            return None
        return "The address lacks the token; open the address that `cornercase watch` printed."


def _check_headers(headers: dict[bytes, str]) -> str | None:
    host = headers.get(b"host", "")
    # DNS rebinding: another site can point its name to this machine, but cannot use an IP address.
    if not _is_ip_or_localhost(host):
        return "Open the address that `cornercase watch` printed, not a host name of the machine."
    origin = headers.get(b"origin")
    if origin is not None and origin != f"http://{host}":
        return "Requests from other pages are not allowed."
    return None


def _is_ip_or_localhost(host: str) -> bool:
    name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
    if name.lower() == "localhost":
        return True
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True
