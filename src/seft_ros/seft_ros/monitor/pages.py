"""The pages that are open, and what they are told."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from tornado.iostream import StreamClosedError
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from seft_ros.monitor.access import Access
from seft_ros.monitor.guarded import Guarded
from seft_ros.monitor.watch import Frame

MOST_PAGES = 32
BEHIND = 4_000_000
"""Bytes that may wait for a slow page before it is left out, and later told all anew."""


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


class Live(Guarded, WebSocketHandler):
    """What a page is told while it is open."""

    def initialize(self, access: Access, pages: Pages) -> None:  # type: ignore[override]
        """Take what the application gives."""
        super().initialize(access)
        self._pages = pages
        self._waiting = 0

    def check_origin(self, origin: str) -> bool:
        """Look at the page that asks."""
        return self.access.is_own_page(origin, self.host)

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
