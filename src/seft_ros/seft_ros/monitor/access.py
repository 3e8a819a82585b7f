"""Access control: who may see the page and press its buttons.

Any page in a browser can send requests here. So each request must name this host, and come from
this page. Other hosts also need the token.
"""

import hmac
import ipaddress
import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tornado.web import HTTPError, RequestHandler

ASSETS = Path(__file__).with_name("assets")
FIRST_WAIT, LONGEST_WAIT = 0.5, 30.0
"""s, wait of an address after its first wrong token; each further one doubles it."""
MAX_ADDRESSES = 1000

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
    """Whether a host's name or address is the loopback of this host."""
    if name.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def page_address(host: str, port: int) -> str:
    """Address of the page for a browser on this host."""
    if host in ("", "0.0.0.0", "::"):
        host = "127.0.0.1"
    text = f"[{host}]" if ":" in host else host
    return f"http://{text}:{port}/"


class TooEarlyError(HTTPError):
    """A token is offered too early; ``wait`` is the remaining wait of its address, s."""

    def __init__(self, wait: float) -> None:
        seconds = math.ceil(wait)
        super().__init__(429, reason=f"after a wrong token wait {seconds} s, then try again")
        self.wait = wait


class Token:
    """Checks the token, and delays guessing.

    Parameters
    ----------
    text : str
        The token; empty: none is needed.
    monotonic : callable, optional
        Time, s.
    """

    def __init__(self, text: str, monotonic: Callable[[], float] = time.monotonic) -> None:
        self.text, self._monotonic = text, monotonic
        self._failures: dict[str, tuple[int, float]] = {}  # address -> number, blocked until

    def is_right(self, offered: str, address: str) -> bool:
        """Whether an address offers the token.

        Raises
        ------
        TooEarlyError
            If the address must wait. Then the token is not checked.
        """
        number, until = self._failures.get(address, (0, 0.0))
        now = self._monotonic()
        if now < until:
            raise TooEarlyError(until - now)
        self._failures.pop(address, None)  # the newest is last
        if hmac.compare_digest(offered.encode(), self.text.encode()):
            return True
        wait = min(FIRST_WAIT * 2.0 ** min(number, 30), LONGEST_WAIT)
        self._failures[address] = (number + 1, now + wait)
        if len(self._failures) > MAX_ADDRESSES:
            del self._failures[next(iter(self._failures))]
        return False


class Guarded(RequestHandler):
    """Checks of every request, and headers of every answer.

    The application's settings have ``token``, a `Token`; ``local_only``, whether the page is
    served on this host alone; and ``cookie``, the name of the cookie. With ``local_only`` the only
    name is localhost; another name points here by DNS rebinding. ``server`` is its `PageServer`.

    The token is exchanged for a signed cookie. Cookies are checked without delay, also while
    somebody else guesses tokens from the same address.
    """

    def set_default_headers(self) -> None:
        """Allow the page its own files only; forbid frames and caches."""
        host = self.host if self._is_host() else ""  # no invalid name in a header
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
        """Refuse requests under a foreign name, from a foreign page, or without the token."""
        if not self._is_host():
            raise HTTPError(403, reason="this page is served to its own host only")
        acts = self.request.method != "GET" or "Upgrade" in self.request.headers
        if acts and not self.is_own_page(self.request.headers.get("Origin", "")):
            raise HTTPError(403, reason="a request of another page")
        self._admit()
        stream = getattr(self.request.connection, "stream", None)
        self.settings["server"].admit(stream, is_page="Upgrade" in self.request.headers)

    def _admit(self) -> None:
        """Refuse the request without a valid cookie or the token."""
        token: Token = self.settings["token"]
        if not token.text:
            return
        bearer = self.request.headers.get("Authorization", "").removeprefix("Bearer ")
        offered = self.get_query_argument("token", "") or bearer
        is_known = bool(self.get_signed_cookie(self.settings["cookie"]))
        is_right = is_known
        if offered:
            try:
                is_right = token.is_right(offered, self.request.remote_ip or "")
            except TooEarlyError:
                if not is_known:
                    raise  # else somebody guesses at the address of an operator
        if not is_right:
            raise HTTPError(401, reason="this token is wrong" if offered else "a token is needed")

    def write_error(self, status_code: int, **details: Any) -> None:
        """Say in plain text what is wrong; without a token, offer to enter one."""
        _, error, _ = details.get("exc_info", (None, None, None))
        if isinstance(error, TooEarlyError):
            self.set_header("Retry-After", str(math.ceil(error.wait)))
        wants_page = self.request.method == "GET" and self.request.path == "/"
        if status_code in (401, 429) and wants_page:
            page = (ASSETS / "token.html").read_text(encoding="utf-8")
            offered = self.get_query_argument("token", "")
            self.finish(page.replace("<!--reason-->", f"{self._reason}." if offered else ""))
            return
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")

    def is_own_page(self, origin: str) -> bool:
        """Whether a header Origin says that a request comes from the page itself."""
        host = self.host.lower()
        return origin.lower() in (f"http://{host}", f"https://{host}")

    @property
    def host(self) -> str:
        """Requested host name; Tornado's own attribute may have a default."""
        return self.request.headers.get("Host", "")

    def _is_host(self) -> bool:
        """Whether the header Host is one under which the page is served."""
        match = _AUTHORITY.fullmatch(self.host)
        local_only = self.settings["local_only"]
        return match is not None and (not local_only or is_loopback(match[1].strip("[]")))


class Missing(Guarded):
    """An address that does not exist."""

    async def prepare(self) -> None:
        """Answer 404 to a request with access."""
        await super().prepare()
        raise HTTPError(404, reason="there is nothing here")
