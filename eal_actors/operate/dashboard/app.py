"""The web application: the page's files and reports of runs by GET, everything else by one websocket."""

from __future__ import annotations

import asyncio
from collections.abc import Collection

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from eal_actors.kernel.throttled_log import ThrottledLog
from eal_actors.operate.dashboard.access import Access
from eal_actors.operate.dashboard.limits import MAX_BROWSERS
from eal_actors.operate.dashboard.pages import INDEX, SECURITY_HEADERS, read_pages, report_headers
from eal_actors.operate.dashboard.places import place_of
from eal_actors.operate.dashboard.session import AppState, BrowserSession
from eal_actors.operate.run_record import REPORT


class _Guard:
    """Refuses requests with a foreign `Host` or `Origin`, and adds the security headers to all answers."""

    def __init__(self, app: ASGIApp, access: Access, strangers: ThrottledLog) -> None:
        self._app = app
        self._access = access
        self._strangers = strangers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        host = headers.get("host")
        if not self._access.knows_host(host):
            await self._refuse(scope, receive, send, "the request's Host is no name of the dashboard")
        elif scope["type"] == "websocket" and not self._access.knows_origin(headers.get("origin"), host):
            await self._refuse(scope, receive, send, "only the dashboard's own page may connect")
        else:
            if (place := place_of(scope)) is not None:
                place.renew()
            await self._app(scope, receive, _with_headers(send))

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, reason: str) -> None:
        headers = Headers(scope=scope)
        source = (scope.get("client") or ("unknown",))[0]
        seen = f"{reason}: Host {headers.get('host')!r}, Origin {headers.get('origin')!r}"
        self._strangers.warn(source, "request refused", seen)
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).close()
        else:
            await PlainTextResponse(reason, 403)(scope, receive, _with_headers(send))


def _with_headers(send: Send) -> Send:
    async def send_with(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in SECURITY_HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return send_with


class App:
    """The application of one dashboard: `asgi` serves it, `browsers` are connected to it."""

    def __init__(self, app_state: AppState) -> None:
        self._app_state = app_state
        self._pages = read_pages()
        self.browsers: set[BrowserSession] = set()
        self._sessions: set[BrowserSession] = set()  # those that are not admitted yet, too
        routes = [
            Route("/", self._file, methods=["GET"]),
            Route("/static/{name:path}", self._file, methods=["GET"]),
            Route(f"/runs/{{name}}/{REPORT}", self._report, methods=["GET"]),
            WebSocketRoute("/ws", self._connect),
        ]
        self.asgi: ASGIApp = _Guard(Starlette(routes=routes), app_state.access, app_state.strangers)

    async def _file(self, request: Request) -> Response:
        if (page := self._pages.get(request.path_params.get("name", INDEX))) is None:
            raise HTTPException(404)
        return Response(page.content, media_type=page.media_type)

    async def _report(self, request: Request) -> Response:
        if (report := self._app_state.report(request.path_params["name"])) is None:
            raise HTTPException(404)
        try:
            page = await asyncio.to_thread(report.read_bytes)
        except OSError:  # moved or removed since
            raise HTTPException(404) from None
        return Response(page, media_type="text/html; charset=utf-8", headers=report_headers())

    async def _connect(self, websocket: WebSocket) -> None:
        browser = BrowserSession(websocket, self._app_state, self._admit)
        self._sessions.add(browser)
        try:
            await browser.serve()
        finally:
            self._sessions.discard(browser)
            self.browsers.discard(browser)

    def dismiss(self, operators: Collection[str]) -> None:
        """End the sessions of some operators. Thread: the loop's."""
        for browser in self._sessions:
            browser.dismiss(operators)

    def _admit(self, browser: BrowserSession) -> bool:
        """Admit a browser that has signed in. One that may stop the robots replaces one that may not."""
        if len(self.browsers) >= MAX_BROWSERS:
            watchers = [other for other in self.browsers if not other.may_stop]
            if not browser.may_stop or not watchers:
                return False
            watchers[0].abort()
            self.browsers.discard(watchers[0])
        self.browsers.add(browser)
        return True
