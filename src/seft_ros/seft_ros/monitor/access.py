"""Access control: who may see the page and press its buttons.

Any page in a browser can send requests here. So each request must name this host, and come from
this page. Other hosts also need a token: one that controls, or one that only watches.
"""

import hmac
import ipaddress
import math
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tornado.web import HTTPError, RequestHandler

ASSETS = Path(__file__).with_name("assets")
FIRST_WAIT, LONGEST_WAIT = 0.5, 30.0
"""s, wait of an address after its first wrong token; each further one doubles it."""
MAX_ADDRESSES = 1000
CONTROL, WATCH = "control", "watch"
"""Rights of a page: to see all and press buttons; to see all."""

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


class Tokens:
    """Checks tokens, and delays guessing.

    Parameters
    ----------
    rights : mapping of str to str
        Token -> its right, `CONTROL` or `WATCH`; empty: no token is needed.
    monotonic : callable, optional
        Time, s.
    """

    def __init__(
        self, rights: Mapping[str, str], monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self.rights, self._monotonic = rights, monotonic
        self._failures: dict[str, tuple[int, float]] = {}  # address -> number, blocked until

    def right_of(self, given: str, address: str) -> str | None:
        """Look up the right of a token; None if it is wrong.

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
        for token, right in self.rights.items():
            if hmac.compare_digest(given.encode(), token.encode()):
                return right
        wait = min(FIRST_WAIT * 2.0 ** min(number, 30), LONGEST_WAIT)
        self._failures[address] = (number + 1, now + wait)
        if len(self._failures) > MAX_ADDRESSES:
            del self._failures[next(iter(self._failures))]
        return None


class Guarded(RequestHandler):
    """Checks of every request, and headers of every answer.

    The application's settings have ``tokens``, a `Tokens`; ``local_only``, whether the page is
    served on this host alone; and ``cookie``, the name of the cookie. With ``local_only`` the only
    name is localhost; another name points here by DNS rebinding. ``server`` is its `PageServer`.

    A token is exchanged for a signed cookie with its right. Cookies are checked without delay, also
    while somebody else guesses tokens from the same address.

    Attributes
    ----------
    right : str
        Of the request: `CONTROL` or `WATCH`.
    """

    right = ""

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
        self.right = self._right()
        stream = getattr(self.request.connection, "stream", None)
        self.settings["server"].admit(stream, is_page="Upgrade" in self.request.headers)

    def _right(self) -> str:
        """Look up the right of the request; refuse it without a valid cookie or token."""
        tokens: Tokens = self.settings["tokens"]
        if not tokens.rights:
            return CONTROL
        bearer = self.request.headers.get("Authorization", "").removeprefix("Bearer ")
        offered = self.get_query_argument("token", "") or bearer
        known = (self.get_signed_cookie(self.settings["cookie"]) or b"").decode()
        right: str | None = known
        if offered:
            try:
                right = tokens.right_of(offered, self.request.remote_ip or "")
            except TooEarlyError:
                if not known:
                    raise  # else somebody guesses at the address of an operator
        if not right:
            raise HTTPError(401, reason="this token is wrong" if offered else "a token is needed")
        return right

    def write_error(self, status_code: int, **details: Any) -> None:
        """Say in plain text what is wrong; without a token, offer to enter one."""
        _, error, _ = details.get("exc_info", (None, None, None))
        if isinstance(error, TooEarlyError):
            self.set_header("Retry-After", str(math.ceil(error.wait)))
        wants_page = self.request.method == "GET" and self.request.path == "/"
        if status_code in (401, 429) and wants_page:
            page = (ASSETS / "token.html").read_text(encoding="utf-8")
            offered = self.get_query_argument("token", "")
            self.finish(page.replace("<!--told-->", f"{self._reason}." if offered else ""))
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
