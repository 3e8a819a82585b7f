"""Who may see the page and press its buttons: what every request must pass.

A page in a browser can be asked for by any other page that the browser shows: so the names under
which this one is asked for, and the page that a request comes from, are looked at. Beyond this
host a token is needed as well.
"""

import asyncio
import hmac
import ipaddress
import re
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tornado.web import HTTPError, RequestHandler

ASSETS = Path(__file__).with_name("assets")
WRONG_TOKEN = 0.5  # s that a wrong token costs who tries it

_AUTHORITY = re.compile(r"(\[[0-9A-Fa-f:.%]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def is_loopback(name: str) -> bool:
    """Whether a host's name or address is this host's own, seen from nowhere else."""
    if name.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def page_address(host: str, port: int) -> str:
    """Address under which a browser on this host finds the page."""
    if host in ("", "0.0.0.0", "::"):
        host = "127.0.0.1"
    text = f"[{host}]" if ":" in host else host
    assert urlsplit(f"http://{text}").hostname
    return f"http://{text}:{port}/"


class Guarded(RequestHandler):
    """What every request must pass, and every answer says.

    The application's settings have ``token``, what a request must know, empty: nothing;
    ``local_only``, whether the page is served on this host alone: then it has no name but
    localhost, and who asks for another was led here by a name server (DNS rebinding); and
    ``port``.
    """

    def set_default_headers(self) -> None:
        """Let the page load what is its own, be shown in no other page, and be kept nowhere."""
        host = self.host if self._is_host() else ""  # what is no name does not go into a header
        policy = (
            "default-src 'none'; script-src 'self'; img-src 'self' data: blob:; "
            "style-src 'self' 'unsafe-inline'; "  # the plotting library makes style elements
            f"connect-src 'self' ws://{host} wss://{host}; "
            "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
        )
        self.clear_header("Server")
        for name, value in {"Content-Security-Policy": policy, **_HEADERS}.items():
            self.set_header(name, value)

    async def prepare(self) -> None:
        """Refuse who asks under a foreign name, from a foreign page, or without the token."""
        if not self._is_host():
            raise HTTPError(403, reason="this page is served to its own host alone")
        acts = self.request.method != "GET" or "Upgrade" in self.request.headers
        if acts and not self.is_own_page(self.request.headers.get("Origin", "")):
            raise HTTPError(403, reason="a request of another page")
        bearer = self.request.headers.get("Authorization", "").removeprefix("Bearer ")
        given = self.get_query_argument("token", "") or bearer or self.get_cookie(self.cookie, "")
        if self.token and not hmac.compare_digest(given.encode(), self.token.encode()):
            if given:
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

    def is_own_page(self, origin: str) -> bool:
        """Whether a header Origin says that a request comes from the page itself."""
        host = self.host.lower()
        return origin.lower() in (f"http://{host}", f"https://{host}")

    @property
    def token(self) -> str:
        """What a request must know; empty: nothing."""
        return str(self.settings["token"])

    @property
    def host(self) -> str:
        """Name that was asked; Tornado's own may be a name for none."""
        return self.request.headers.get("Host", "")

    @property
    def cookie(self) -> str:
        """Name of the cookie that holds the token; cookies of all ports of a host are one."""
        return f"seft_monitor_{self.settings['port']}"

    def _is_host(self) -> bool:
        """Whether the header Host is one under which the page is served."""
        match = _AUTHORITY.fullmatch(self.host)
        local_only = self.settings["local_only"]
        return match is not None and (not local_only or is_loopback(match[1].strip("[]")))


class Missing(Guarded):
    """An address behind which is nothing."""

    async def prepare(self) -> None:
        """Say so, to who may know."""
        await super().prepare()
        raise HTTPError(404, reason="there is nothing here")
