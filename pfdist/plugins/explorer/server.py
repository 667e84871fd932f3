"""The local page: it answers this machine alone, and ends with the command.

Whoever knows the address may ask. So the address has a random token, and only requests that this
page makes itself are answered: with its own Host and, where the browser names one, its own Origin.
A page of the web cannot know the token, and another name of this machine (DNS rebinding) does not
help it. Every local user sees the words with which a browser is started. So the browser gets a
private file that leads to the address.
"""

import asyncio
import contextlib
import json
import os
import secrets
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from pfdist.common import stopping
from pfdist.errors import ArgumentError, MissingExtraError
from pfdist.plugins.explorer.session import ExplorerSession, reply
from pfdist.problem.problem import JobSource
from pfdist.results import Run

try:
    import uvicorn
    import websockets  # noqa: F401  uvicorn needs it
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.responses import Response
    from starlette.routing import Route, WebSocketRoute
    from starlette.websockets import WebSocket, WebSocketDisconnect
except ModuleNotFoundError as error:
    raise MissingExtraError("explore", "explore", error.name) from error

_MOST_PORT = 65_535
ADDRESS = "127.0.0.1"
MOST_BYTES = 2**21  # of a message; a set of all possible times is smaller
_HEADERS = {
    # Nothing is loaded but the page's own script and style, and nothing is asked but its server.
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "cache-control": "no-store",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",  # the address has the token
    "x-content-type-options": "nosniff",
}
_FILES = {"": "text/html", "explore.js": "text/javascript", "explore.css": "text/css"}


def server_of(session: ExplorerSession, token: str, port: int) -> uvicorn.Server:
    """The server of the page, its script and its style, which answers the messages of pages.

    Parameters
    ----------
    session : ExplorerSession
    token : str
        The first part of every path.
    port : int
        The port of the Host and the Origin of all requests.
    """

    def served(name: str) -> Any:
        async def send(_: Any) -> Response:
            text = (files("pfdist.plugins.explorer") / (name or "explore.html")).read_text("utf-8")
            return Response(text, media_type=_FILES[name], headers=_HEADERS)

        return send

    async def answer(page: WebSocket) -> None:
        await page.accept()
        while (asked := await page.receive())["type"] == "websocket.receive":
            # One question of a page after another. In a thread: no other page need wait.
            text = asked.get("text") or asked.get("bytes")
            found = await asyncio.to_thread(reply, session, text)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # the page was closed
                await page.send_text(json.dumps(found))

    app = Starlette(
        routes=[
            *(Route(f"/{token}/{name}", served(name)) for name in _FILES),
            WebSocketRoute(f"/{token}/socket", answer),
        ],
        middleware=[Middleware(_Own, port=port)],
    )
    settings = uvicorn.Config(
        app,
        ws="websockets-sansio",
        ws_max_size=MOST_BYTES,
        ws_ping_interval=None,  # a page that waits for an answer is not read
        log_level="critical",  # a line a request would show the token
        timeout_graceful_shutdown=1,
        server_header=False,
        lifespan="off",
    )
    return uvicorn.Server(settings)


class _Own:
    """Answer requests with the server's own Host, and no other Origin; a WebSocket has an Origin.

    Routes compare the token.
    """

    def __init__(self, app: Any, port: int) -> None:
        self._app = app
        self._hosts = {f"{name}:{port}".encode() for name in (ADDRESS, "localhost")}

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "lifespan" or self._is_own(scope):
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})  # not accepted: answered with 403
        else:
            await send({"type": "http.response.start", "status": 403, "headers": []})
            await send({"type": "http.response.body", "body": b"Not this page's own request.\n"})

    def _is_own(self, scope: Any) -> bool:
        given = [*scope["headers"]]
        hosts = [value for name, value in given if name == b"host"]
        origins = [value for name, value in given if name == b"origin"]
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return False
        needs_origin = scope["type"] == "websocket"
        return origins == [b"http://" + hosts[0]] or not (origins or needs_origin)


def explorer_page(job: JobSource | Run, *, port: int = 0, browser: bool = True) -> Iterator[str]:
    """Yield the page's address, then serve the page until Ctrl-C.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        See `ExplorerSession`.
    port : int
        Port of the page; 0: any that is free.
    browser : bool
        Whether a browser is opened.

    Raises
    ------
    PfdistError
        The job is not possible, or the port is in use.
    """
    if not 0 <= port <= _MOST_PORT:
        raise ArgumentError(f"port must be 0 to {_MOST_PORT:,}, got {port}", argument="port")
    session = ExplorerSession(job)
    with _listening(port) as listening:
        port, token = listening.getsockname()[1], secrets.token_urlsafe()
        address = f"http://{ADDRESS}:{port}/{token}/"
        yield address
        beside = _browser(address) if browser else contextlib.nullcontext()
        asyncio.run(_serve(server_of(session, token, port), listening, beside))
    stopping.check()


async def _serve(
    server: Any, listening: socket.socket, beside: contextlib.AbstractContextManager[None]
) -> None:
    """Serve until a signal was received; see `pfdist.common.stopping`."""
    serving = asyncio.create_task(server.serve(sockets=[listening]))
    with beside:
        while not serving.done():
            try:
                stopping.check()
            except KeyboardInterrupt:
                server.should_exit = True
            await asyncio.wait({serving}, timeout=0.1)
    await serving


@contextlib.contextmanager
def _browser(address: str) -> Iterator[None]:
    """Start a browser, which may last as long as the page, with a file that leads to an address."""
    with tempfile.TemporaryDirectory(prefix="pfdist-") as folder:
        link = Path(folder, "explore.html")
        link.touch(0o600)
        link.write_text(
            f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">\n'
            f'<a href="{address}">pfdist explore</a>\n',
            encoding="utf-8",
        )
        open_it = threading.Thread(target=webbrowser.open, args=[link.as_uri()], daemon=True)
        open_it.start()
        yield


def _listening(port: int) -> socket.socket:
    try:
        return socket.create_server((ADDRESS, port))
    except OSError as error:
        why = f"{port} cannot be used: {os.strerror(error.errno or 0)}"
        raise ArgumentError(why, argument="port") from error
