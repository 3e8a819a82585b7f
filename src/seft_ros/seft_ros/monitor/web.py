"""The page's server: files, live frames over a websocket, and the supervisor's services."""

import json
from collections.abc import Awaitable, Callable
from pathlib import Path

import bokeh
from tornado.web import Application, StaticFileHandler

from seft_ros.monitor.access import Access
from seft_ros.monitor.figures import figures
from seft_ros.monitor.guarded import ASSETS, Guarded, Missing
from seft_ros.monitor.pages import Live, Pages

LIBRARY = Path(bokeh.__file__).parent / "server" / "static" / "js"

Call = Callable[[str], Awaitable[tuple[bool, str]]]


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
