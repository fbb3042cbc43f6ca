# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Serves the page on this machine alone, in a thread of its own."""

import asyncio
import hmac
import logging
import socket
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import uvicorn
from fastapi import FastAPI, Request, Response, WebSocket, WebSocketDisconnect
from nicegui import ui
from starlette.middleware.base import RequestResponseEndpoint
from starlette.middleware.trustedhost import TrustedHostMiddleware

from valve_control.dashboard.frames import ViewError, frame, view
from valve_control.dashboard.machine import Machine
from valve_control.dashboard.page import Page
from valve_control.dashboard.recording import Recording

HOST = "127.0.0.1"
NAMES = [HOST, "localhost"]
START = 30.0  # s
END = 3.0  # s
RECONNECT = 10.0  # s that a window may be without connection and go on afterwards
# The browser itself refuses every request that would leave this host. NiceGUI builds its page in scripts
# inside the page, and Vue compiles templates, hence the two unsafe ones.
POLICY = {
    "content-security-policy": "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data:; font-src 'self' data:; connect-src 'self'; "
    "frame-ancestors 'none'; form-action 'self'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}


class PortTaken(RuntimeError):
    """Says that the port cannot be had; the message is one sentence for the user."""


class Server:
    """The page's server; ``start`` returns when it listens."""

    def __init__(self, machine: Machine, port: int, right_token: str, folder: Path) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((HOST, port))
        except OSError as error:
            self._socket.close()
            raise PortTaken(
                f"port {port} of {HOST} cannot be had: {(error.strerror or str(error)).lower()}; choose "
                "another with -p port:=8081, or any free one with -p port:=0"
            ) from error
        self.address = f"http://{HOST}:{self._socket.getsockname()[1]}/"
        self._recording = Recording(folder)
        app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)

        @app.websocket("/frames")
        async def frames(wire: WebSocket) -> None:
            await _serve_frames(wire, machine)

        @ui.page("/", title="valve_control", response_timeout=START)
        def page(token: str = "") -> None:
            may_write = hmac.compare_digest(token.encode(), right_token.encode())
            Page(machine, self._recording, may_write).build()

        ui.run_with(
            app,
            show_welcome_message=False,
            title="valve_control",
            favicon=FAVICON,
            dark=None,  # as the browser is
            binding_refresh_interval=0.5,
            reconnect_timeout=RECONNECT,
        )

        @app.middleware("http")
        async def policy(request: Request, answer: RequestResponseEndpoint) -> Response:
            response = await answer(request)
            response.headers.update(POLICY)
            return response

        app.add_middleware(TrustedHostMiddleware, allowed_hosts=NAMES)
        config = uvicorn.Config(
            app,
            log_level="warning",
            timeout_graceful_shutdown=1,
            access_log=False,
            ws_ping_interval=20.0,
            lifespan="on",
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def start(self) -> None:
        """Start the thread and wait until the page can be had."""
        self._thread.start()
        end = time.monotonic() + START
        while not self._server.started and self._thread.is_alive() and time.monotonic() < end:
            time.sleep(0.01)

    @property
    def running(self) -> bool:
        """Whether the thread lives."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """End the recorder that was started from the page, and the server."""
        self._recording.end()
        # Windows that are open are cut off; that needs no words in the terminal.
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        self._server.should_exit = True
        self._thread.join(END)
        self._socket.close()

    def _run(self) -> None:
        logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
        asyncio.run(self._server.serve(sockets=[self._socket]))


FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><path d="M2 24h8L16 6l6 18h8" '
    'fill="none" stroke="#0072b2" stroke-width="3"/></svg>'
)


async def _serve_frames(wire: WebSocket, machine: Machine) -> None:
    """Answer each request of a page with a frame, until it leaves."""
    origin = urlsplit(wire.headers.get("origin", "")).netloc
    if origin and origin != wire.headers.get("host", ""):
        await wire.close(1008)  # a page of somebody else
        return
    await wire.accept()
    try:
        while True:
            text = await wire.receive_text()
            try:
                await wire.send_bytes(frame(machine, view(text), time.time()))
            except ViewError as error:
                await wire.close(1003, str(error)[:100])
                return
    except (WebSocketDisconnect, RuntimeError):  # RuntimeError: it left while a frame was sent
        return
