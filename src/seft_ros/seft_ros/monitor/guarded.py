"""What every request to the monitor must pass."""

import asyncio
from pathlib import Path
from typing import Any

from tornado.web import HTTPError, RequestHandler

from seft_ros.monitor.access import Access

ASSETS = Path(__file__).with_name("assets")
WRONG_TOKEN = 0.5  # s that a wrong token costs who tries it


class Guarded(RequestHandler):
    """What every request must pass, and every answer says."""

    def initialize(self, access: Access, **_: Any) -> None:
        """Take what the application gives."""
        self.access = access

    def set_default_headers(self) -> None:
        """Let the page load what is its own, be shown in no other page, and be kept nowhere."""
        known = self.application.settings["access"].is_host(self.host)
        host = self.host if known else ""  # what is no name does not go into a header
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
        if not self.access.is_host(self.host):
            raise HTTPError(403, reason="this page is served to its own host alone")
        acts = self.request.method != "GET" or "Upgrade" in self.request.headers
        if acts and not self.access.is_own_page(self.request.headers.get("Origin", ""), self.host):
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
    def host(self) -> str:
        """Name that was asked; Tornado's own may be a name for none."""
        return self.request.headers.get("Host", "")

    @property
    def cookie(self) -> str:
        """Name of the cookie that holds the token; cookies of all ports of a host are one."""
        return f"seft_monitor_{self.application.settings['port']}"

    def _given_token(self) -> str:
        bearer = self.request.headers.get("Authorization", "").removeprefix("Bearer ")
        return self.get_query_argument("token", "") or bearer or self.get_cookie(self.cookie, "")

    def _knows_token(self) -> bool:
        return self.access.knows_token(self._given_token())


class Missing(Guarded):
    """An address behind which is nothing."""

    async def prepare(self) -> None:
        """Say so, to who may know."""
        await super().prepare()
        raise HTTPError(404, reason="there is nothing here")
