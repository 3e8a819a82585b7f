"""The page's server: files, figures, live frames over a websocket, the supervisor's services.

Who has the token may see the page and press its buttons; nobody else gets anything.
"""

import asyncio
import hmac
import json
import math
from collections.abc import Awaitable, Callable
from functools import cache, partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import bokeh
from bokeh.embed import json_item
from bokeh.models import ColumnDataSource, NumeralTickFormatter, Range1d
from bokeh.plotting import figure
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from seft_ros.drawing.page import plot
from seft_ros.monitor.history import Frame

_ASSETS = Path(__file__).with_name("assets")
_LIBRARY = Path(bokeh.__file__).parent / "server" / "static" / "js"
BEHIND = 4_000_000
"""Bytes that may wait for a slow page; after that it is skipped, and later receives all frames."""

HEIGHT = 230  # pixels
LEFT_MARGIN = 64  # pixels for the numbers: all figures begin at the same place
_LINES = {
    "displacement": ("displacement / mm", ("reference", "measured")),
    "displacement_error": ("displacement error / mm", ("error",)),
    "force_error": ("force error / kN", ("error",)),
    "acceleration": ("acceleration / (m/s²)", ("reference", "measured")),
    "force": ("force / kN", ("reference", "measured")),
    "spectrum": ("pseudo-acceleration / (m/s²)", ("natural", "reference", "measured")),
    "timing": ("time / ms", ("answer", "largest", "median", "period")),
    "missed": ("missed commands", ("missed",)),
}
"""Vertical axis and lines of each figure, the last line on top."""
WIDTHS = {"natural": 1.0, "reference": 3.0, "answer": 1.0, "period": 1.0, "median": 2.0}
STEPPED = ("largest", "median", "missed")
"""Signals that are sent once a second, for the last second."""

STOP_BUTTONS = ("stop", "estop")
Call = Callable[[str], Awaitable[tuple[bool, str]]]
Lateness = Callable[[int, float], str]


class Guarded(RequestHandler):
    """A request that needs the token, in its address or in the cookie that `Page` makes of it.

    Other pages in the same browser have the cookie, too: so a button belongs to this page's own
    origin, as tornado demands of a websocket.
    """

    def set_default_headers(self) -> None:
        """Forbid caches, and frames of other pages around the buttons."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Frame-Options", "DENY")

    async def prepare(self) -> None:
        """Refuse a request without the token, or of another page."""
        known = self.get_cookie(self.settings["cookie"], "") or ""
        offered = self.get_query_argument("token", known)
        if not hmac.compare_digest(offered.encode(), self.settings["token"].encode()):
            raise HTTPError(401, reason="this token is wrong" if offered else "a token is needed")
        origin = self.request.headers.get("Origin", "")
        if self.request.method == "POST" and urlsplit(origin).netloc != self.request.host:
            raise HTTPError(403, reason="a request of another page")

    def write_error(self, status_code: int, **_: Any) -> None:
        """Say in plain text what is wrong; without a token, offer to enter one."""
        if status_code == 401 and self.request.path == "/":
            self.finish((_ASSETS / "token.html").read_bytes())
            return
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")


class Page(Guarded):
    """The page itself; a token in its address becomes a cookie, and is hidden."""

    def get(self) -> None:
        """Answer with the page."""
        if token := self.get_query_argument("token", ""):
            options: dict[str, Any] = {"httponly": True, "samesite": "Strict"}
            self.set_cookie(self.settings["cookie"], token, **options)
            self.redirect("/")
            return
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish((_ASSETS / "page.html").read_bytes())


class Figures(Guarded):
    """The figures, without their lines."""

    def get(self) -> None:
        """Answer with the data from which the plotting library makes figures."""
        self.set_header("Content-Type", "application/json")
        self.finish(self.settings["figures"])


class File(Guarded, StaticFileHandler):
    """A style sheet, a script, or the plotting library."""

    def set_extra_headers(self, path: str) -> None:
        """Let browsers keep it, but check each time whether it has changed."""
        del path
        self.set_header("Cache-Control", "no-cache")


class Service(Guarded):
    """A button of the page.

    A request to start or to reset contains the state and the time at which the page made it; a
    stop may be late.
    """

    async def post(self, name: str) -> None:
        """Call the supervisor; answer with its answer."""
        why = "" if name in STOP_BUTTONS else self._lateness()
        done, text = (False, why) if why else await self.settings["call"](name)
        self.finish({"done": done, "text": text})

    def _lateness(self) -> str:
        try:
            request = json.loads(self.request.body)
            state, at_ms = int(request["state"]), float(request["at"])
            if not math.isfinite(at_ms):
                raise ValueError(at_ms)
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
            reason = "the request does not say in which state and when it was made"
            raise HTTPError(400, reason=reason) from None
        return str(self.settings["lateness"](state, at_ms))


class Live(Guarded, WebSocketHandler):
    """Live frames to an open page."""

    waiting = 0
    """Bytes that are not sent yet."""

    def open(self, *_: str, **__: str) -> None:
        """Begin to send."""
        self.set_nodelay(True)
        self.settings["pages"].add(self)

    def on_message(self, message: str | bytes) -> None:
        """Ignore messages."""

    def on_close(self) -> None:
        """Stop sending."""
        self.settings["pages"].remove(self)

    def send(self, frame: Frame) -> None:
        """Send a frame, without waiting for the end of sending."""
        try:
            sending = self.write_message(frame, binary=isinstance(frame, bytes))
        except WebSocketClosedError:
            self.on_close()
            return
        self.waiting += len(frame)
        sending.add_done_callback(partial(self._sent, len(frame)))

    def _sent(self, size: int, sending: asyncio.Future[None]) -> None:
        self.waiting -= size
        if not sending.cancelled():
            sending.exception()  # a closed page is no failure


class Pages:
    """The open pages.

    Parameters
    ----------
    everything : callable
        Gives all frames for a newly opened page.
    """

    def __init__(self, everything: Callable[[], list[Frame]]) -> None:
        self._everything = everything
        self._open: dict[Live, bool] = {}  # page -> whether it has all frames

    def __len__(self) -> int:
        return len(self._open)

    def add(self, page: Live) -> None:
        """Add a page."""
        self._open[page] = False
        self.send([])

    def remove(self, page: Live) -> None:
        """Forget a page."""
        self._open.pop(page, None)

    def close(self) -> None:
        """Close all pages."""
        for page in list(self._open):
            page.close(1001, "the monitor has ended")

    def send(self, frames: list[Frame]) -> None:
        """Send the news to every page, and all frames to new and skipped pages."""
        for page, knows_all in list(self._open.items()):
            if page.waiting > BEHIND:
                self._open[page] = False
                continue
            for frame in frames if knows_all else self._everything():
                page.send(frame)
            if page in self._open:
                self._open[page] = True


def _figure(name: str, label: str, lines: tuple[str, ...]) -> figure:
    """Make a figure; the page's script adds the data.

    Each line has a data source with its name, with columns x in s and y in the unit of the axis.
    """
    is_spectrum, is_timing = name == "spectrum", name == "timing"
    x_label, ends = ("frequency / Hz", (1, 50)) if is_spectrum else ("time / s", (0, 20))
    scales: dict[str, Any] = {"log_x": is_spectrum, "log_y": is_timing, "height": HEIGHT}
    panel = plot(x_label, label, x_range=Range1d(*map(float, ends)), **scales)
    panel.y_range = Range1d(0.1, 10.0) if is_timing else Range1d(-1.0, 1.0)
    if is_timing:
        panel.yaxis.formatter = NumeralTickFormatter(format="0.[000]")
    panel.background_fill_alpha = panel.border_fill_alpha = 0.0  # the page's own, dark or light
    panel.min_border_left = LEFT_MARGIN
    for axis in panel.axis:
        axis.ticker.desired_num_ticks = 5  # each number costs time whenever it is drawn
    for line in lines:
        source = ColumnDataSource({"x": [], "y": []}, name=line)
        draw = panel.step if line in STEPPED else panel.line
        mode = {"mode": "before"} if line in STEPPED else {}
        draw("x", "y", source=source, line_width=WIDTHS.get(line, 1.3), **mode)
    return panel


@cache
def _figures() -> str:
    """All figures as JSON, made once."""
    return json.dumps({name: json_item(_figure(name, *_LINES[name])) for name in _LINES})


def application(token: str, port: int, pages: Pages, call: Call, lateness: Lateness) -> Application:
    """Make the web application; see `Watch.lateness` for lateness."""
    return Application(
        [
            (r"/", Page),
            (r"/figures\.json", Figures),
            (r"/live", Live),
            (r"/service/(start|stop|estop|reset)", Service),
            (r"/assets/([a-z_]+\.(?:css|js))", File, {"path": str(_ASSETS)}),
            (r"/library/(bokeh\.min\.js)", File, {"path": str(_LIBRARY)}),
        ],
        token=token,
        lateness=lateness,
        cookie=f"seft_monitor_{port}",  # a host's cookies are shared by its ports
        pages=pages,
        call=call,
        figures=_figures(),  # now: it takes a second, and a stop would have to wait
        log_function=lambda _: None,
        websocket_ping_interval=20,
        websocket_max_message_size=4096,
        compress_response=False,
    )
