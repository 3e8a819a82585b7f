"""The page's server: files, live frames over a websocket, and the supervisor's services."""

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import bokeh
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from seft_ros.monitor.access import Access
from seft_ros.monitor.figures import figures
from seft_ros.monitor.watch import Frame

ASSETS = Path(__file__).with_name("assets")
LIBRARY = Path(bokeh.__file__).parent / "server" / "static" / "js"
MOST_PAGES = 32
BEHIND = 4_000_000
"""Bytes that may wait for a slow page before it is left out, and later told all anew."""
WRONG_TOKEN = 0.5  # s that a wrong token costs who tries it

Call = Callable[[str], Awaitable[tuple[bool, str]]]


class Pages:
    """The pages that are open.

    Parameters
    ----------
    everything : callable
        Gives what a page needs that has just been opened.
    """

    def __init__(self, everything: Callable[[], list[Frame]]) -> None:
        self._everything = everything
        self._open: dict[Live, bool] = {}  # and whether it knows all

    def __len__(self) -> int:
        return len(self._open)

    def add(self, page: "Live") -> bool:
        """Take in a page, unless there are too many."""
        if len(self._open) >= MOST_PAGES:
            return False
        self._open[page] = False
        self.send([])
        return True

    def remove(self, page: "Live") -> None:
        """Forget a page."""
        self._open.pop(page, None)

    def close(self) -> None:
        """Say goodbye to all pages."""
        for page in list(self._open):
            page.close(1001, "the monitor has ended")

    def send(self, frames: list[Frame]) -> None:
        """Send what is new to every page, and all to those that do not know it yet."""
        for page, knows_all in list(self._open.items()):
            if page.waiting() > BEHIND:
                self._open[page] = False
                continue
            for frame in frames if knows_all else self._everything():
                page.send(frame)
            if page in self._open:
                self._open[page] = True


class Guarded(RequestHandler):
    """What every request must pass, and every answer says."""

    def initialize(self, access: Access, **_: Any) -> None:
        """Take what the application gives."""
        self.access = access

    def set_default_headers(self) -> None:
        """Let the page load what is its own, be shown in no other page, and be kept nowhere."""
        known = self.application.settings["access"].is_host(self.request.host)
        host = self.request.host if known else ""  # what is no name does not go into a header
        self.clear_header("Server")
        policy = (
            "default-src 'none'; script-src 'self'; img-src 'self' data: blob:; "
            "style-src 'self' 'unsafe-inline'; "  # the plotting library makes style elements
            f"connect-src 'self' ws://{host} wss://{host}; "
            "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
        )
        for name, value in (
            ("Content-Security-Policy", policy),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Opener-Policy", "same-origin"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cache-Control", "no-store"),
        ):
            self.set_header(name, value)

    async def prepare(self) -> None:
        """Refuse who asks under a foreign name, from a foreign page, or without the token."""
        host = self.request.host
        if not self.access.is_host(host):
            raise HTTPError(403, reason="this page is served to its own host alone")
        acts = self.request.method != "GET" or "Upgrade" in self.request.headers
        if acts and not self.access.is_own_page(self.request.headers.get("Origin", ""), host):
            raise HTTPError(403, reason="a request of another page")
        if self.access.needs_token and not self._knows_token():
            if self._given_token():
                await asyncio.sleep(WRONG_TOKEN)
            raise HTTPError(401, reason="a token is needed")

    def write_error(self, status_code: int, **_: Any) -> None:
        """Say in plain text what is wrong; who lacks the token may type it."""
        wants_page = self.request.method == "GET" and self.request.path == "/"
        if status_code == 401 and wants_page:
            self.finish((ASSETS / "token.html").read_text(encoding="utf-8"))
            return
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")

    @property
    def cookie(self) -> str:
        """Name of the cookie that holds the token; cookies of all ports of a host are one."""
        return f"seft_monitor_{self.application.settings['port']}"

    def _given_token(self) -> str:
        bearer = self.request.headers.get("Authorization", "").removeprefix("Bearer ")
        return self.get_query_argument("token", "") or bearer or self.get_cookie(self.cookie, "")

    def _knows_token(self) -> bool:
        return self.access.knows_token(self._given_token())


class Page(Guarded):
    """The page itself; a token in its address goes into a cookie, and out of sight."""

    def get(self) -> None:
        """Answer with the page."""
        token = self.get_query_argument("token", "")
        if token and self.access.needs_token:
            self.set_cookie(self.cookie, token, httponly=True, samesite="Strict", path="/")
            self.redirect("/")
            return
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish((ASSETS / "page.html").read_bytes())


class Figures(Guarded):
    """The figures, without their lines."""

    def initialize(self, access: Access, figures: str) -> None:  # type: ignore[override]
        """Take what the application gives."""
        super().initialize(access)
        self._figures = figures

    def get(self) -> None:
        """Answer with what the plotting library makes figures of."""
        self.set_header("Content-Type", "application/json")
        self.finish(self._figures)


class File(Guarded, StaticFileHandler):
    """A style sheet, a script, or the plotting library."""

    def initialize(self, access: Access, path: str) -> None:  # type: ignore[override]
        """Take what the application gives."""
        Guarded.initialize(self, access)
        StaticFileHandler.initialize(self, path)

    def set_extra_headers(self, path: str) -> None:
        """Let browsers keep it, but ask each time whether it is still the same."""
        del path
        self.set_header("Cache-Control", "no-cache")


class Service(Guarded):
    """A button of the page."""

    def initialize(self, access: Access, call: Call) -> None:  # type: ignore[override]
        """Take what the application gives."""
        super().initialize(access)
        self._call = call

    async def post(self, name: str) -> None:
        """Call the supervisor; answer with what it says."""
        done, text = await self._call(name)
        self.finish({"done": done, "text": text})


class Live(Guarded, WebSocketHandler):
    """What a page is told while it is open."""

    def initialize(self, access: Access, pages: Pages) -> None:  # type: ignore[override]
        """Take what the application gives."""
        super().initialize(access)
        self._pages = pages
        self._waiting = 0

    def check_origin(self, origin: str) -> bool:
        """Look at the page that asks."""
        return self.access.is_own_page(origin, self.request.host)

    def open(self, *_: str, **__: str) -> None:
        """Begin to tell."""
        self.set_nodelay(True)
        if not self._pages.add(self):
            self.close(1013, "too many pages")

    def on_message(self, message: str | bytes) -> None:
        """Take no orders here."""

    def on_close(self) -> None:
        """Stop telling."""
        self._pages.remove(self)

    def waiting(self) -> int:
        """Bytes that have not gone out yet."""
        return self._waiting

    def send(self, frame: Frame) -> None:
        """Send a frame, without waiting for it to go out."""
        try:
            sending = asyncio.ensure_future(
                _sent(self.write_message(frame, binary=isinstance(frame, bytes)))
            )
        except WebSocketClosedError:
            self._pages.remove(self)
            return
        size = len(frame)
        self._waiting += size
        sending.add_done_callback(lambda _: self._gone(size))

    def _gone(self, size: int) -> None:
        self._waiting -= size


async def _sent(future: Awaitable[None]) -> None:
    with contextlib.suppress(WebSocketClosedError, StreamClosedError):
        await future


def application(access: Access, port: int, pages: Pages, call: Call) -> Application:
    """Make the web application."""
    given = {"access": access}
    drawn = json.dumps(figures())  # now: it takes a second, for which an emergency stop would wait
    return Application(
        [
            (r"/", Page, given),
            (r"/figures\.json", Figures, {**given, "figures": drawn}),
            (r"/live", Live, {**given, "pages": pages}),
            (r"/service/(start|stop|estop|reset)", Service, {**given, "call": call}),
            (r"/assets/([a-z_]+\.(?:css|js))", File, {**given, "path": str(ASSETS)}),
            (r"/library/(bokeh\.min\.js)", File, {**given, "path": str(LIBRARY)}),
        ],
        default_handler_class=Missing,
        default_handler_args=given,
        access=access,
        port=port,
        log_function=lambda _: None,
        websocket_ping_interval=20,
        websocket_max_message_size=4096,
        compress_response=False,
    )


class Missing(Guarded):
    """An address behind which is nothing."""

    async def prepare(self) -> None:
        """Say so, to who may know."""
        await super().prepare()
        raise HTTPError(404, reason="there is nothing here")
