"""The page's connections: few, small, and those with access before all others.

Whoever reaches the port can connect and send a part of a request. That must neither use up the
process's files and memory nor keep the operator out.
"""

from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.web import Application

MOST = 200
"""Connections at the same time; a process may have 1024 files by default."""
_HEADERS, _BODY, _BUFFER = 1 << 15, 1 << 12, 1 << 16  # bytes, at most
_HEADERS_WITHIN, _BODY_WITHIN = 20.0, 5.0  # s
_UNKNOWN, _ADMITTED, _PAGE = range(3)


class PageServer(HTTPServer):
    """Serves an application on at most `MOST` connections.

    One more takes the place of the oldest that has shown no access yet; if there is none, of the
    oldest that is no open page.
    """

    def initialize(self, application: Application, **options: Any) -> None:  # type: ignore[override]
        """Make the server of an application, which finds it in its settings as ``server``."""
        application.settings["server"] = self
        self._ranks: dict[IOStream, int] = {}  # of the connections, the oldest first
        super().initialize(
            application,
            max_header_size=_HEADERS,
            max_body_size=_BODY,
            max_buffer_size=_BUFFER,
            chunk_size=_BUFFER,
            idle_connection_timeout=_HEADERS_WITHIN,
            body_timeout=_BODY_WITHIN,
            **options,
        )

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        """Serve a connection."""
        self._ranks = {each: rank for each, rank in self._ranks.items() if not each.closed()}
        if len(self._ranks) >= MOST:
            self._drop_one()
        self._ranks[stream] = _UNKNOWN
        super().handle_stream(stream, address)

    def admit(self, stream: IOStream | None, *, is_page: bool = False) -> None:
        """Note that a request on a connection has access; or that a page keeps it open."""
        if stream in self._ranks:
            self._ranks[stream] = max(self._ranks[stream], _PAGE if is_page else _ADMITTED)

    def _drop_one(self) -> None:
        oldest = min(self._ranks, key=self._ranks.__getitem__)  # the first of the lowest
        if self._ranks[oldest] < _PAGE:
            del self._ranks[oldest]
            oldest.close()
