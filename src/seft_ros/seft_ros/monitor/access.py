"""Access control: who may see the page and press its buttons.

Any page in a browser can send requests here. So each request must name this host, and come from
this page. Other hosts also need a token: one that controls, or one that only watches.
"""

import hmac
import ipaddress
import math
import re
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tornado.web import HTTPError, RequestHandler

ASSETS = Path(__file__).with_name("assets")
FIRST_WAIT, LONGEST_WAIT = 0.5, 30.0
"""s, wait of an address after its first wrong token; each further one doubles it."""
MOST_ADDRESSES = 1000

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
    assert urlsplit(f"http://{text}").hostname
    return f"http://{text}:{port}/"


class TooEarlyError(Exception):
    """A token is offered too early; the argument is the remaining wait of its address, s."""

    def __init__(self, wait: float) -> None:
        super().__init__(wait)
        self.wait = wait


@dataclass(frozen=True)
class Tokens:
    """Tokens that give a request its rights.

    Attributes
    ----------
    control : str
        Permits to see all and to press buttons; empty: no token is needed.
    watch : str
        Permits to see all, without buttons; empty: there is no such token.
    """

    control: str = ""
    watch: str = ""


class Access:
    """Checks tokens and keys, and delays guessing.

    A token is exchanged for a random key, which the browser keeps. Keys are checked without delay,
    also while somebody else guesses tokens from the same address.

    Parameters
    ----------
    tokens : Tokens
        The accepted tokens.
    monotonic : callable, optional
        Time, s.
    """

    def __init__(self, tokens: Tokens, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._tokens, self._monotonic = tokens, monotonic
        self._keys: dict[str, bool] = {}  # key -> whether it controls
        self._failures: dict[str, tuple[int, float]] = {}  # address -> number, blocked until

    @property
    def is_open(self) -> bool:
        """Whether no token is needed."""
        return not self._tokens.control

    def of_key(self, key: str) -> bool | None:
        """Say whether a key controls; None if it is not valid."""
        return self._keys.get(key)

    def of_token(self, given: str, address: str) -> bool | None:
        """Say whether a token controls; None if it is wrong.

        Raises
        ------
        TooEarlyError
            If the address must wait. Then the token is not checked.
        """
        number, until = self._failures.get(address, (0, 0.0))
        now = self._monotonic()
        if now < until:
            raise TooEarlyError(until - now)
        for token, controls in ((self._tokens.control, True), (self._tokens.watch, False)):
            if token and hmac.compare_digest(given.encode(), token.encode()):
                self._failures.pop(address, None)
                return controls
        wait = min(FIRST_WAIT * 2.0 ** min(number, 30), LONGEST_WAIT)
        self._failures.pop(address, None)  # the newest is last
        self._failures[address] = (number + 1, now + wait)
        if len(self._failures) > MOST_ADDRESSES:
            del self._failures[next(iter(self._failures))]
        return None

    def new_key(self, controls: bool) -> str:
        """Make a key for a browser that has sent a token."""
        key = secrets.token_urlsafe(24)
        self._keys[key] = controls
        return key


class Guarded(RequestHandler):
    """Checks of every request, and headers of every answer.

    The application's settings have ``access``, an `Access`; ``local_only``, whether the page is
    served on this host alone; and ``port``. With ``local_only`` the only name is localhost; another
    name points here by DNS rebinding.

    Attributes
    ----------
    controls : bool
        Whether the request may press buttons.
    """

    controls = False
    _wait = 0  # s

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
        rights = True if self.access.is_open else self._rights()
        if rights is None:
            raise HTTPError(401, reason="a token is needed")
        self.controls = rights

    def _rights(self) -> bool | None:
        """Say whether the request may control; None without a valid key or token."""
        bearer = self.request.headers.get("Authorization", "").removeprefix("Bearer ")
        offered = self.get_query_argument("token", "") or bearer
        if not offered:
            return self.access.of_key(self.get_cookie(self.cookie, "") or "")
        try:
            rights = self.access.of_token(offered, self.request.remote_ip or "")
        except TooEarlyError as error:
            self._wait = math.ceil(error.wait)
            text = f"after a wrong token wait {self._wait} s, then try again"
            raise HTTPError(429, reason=text) from None
        if rights is None:
            raise HTTPError(401, reason="this token is wrong")
        return rights

    def write_error(self, status_code: int, **_: Any) -> None:
        """Say in plain text what is wrong; without a token, offer to enter one."""
        if self._wait:
            self.set_header("Retry-After", str(self._wait))
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
    def access(self) -> Access:
        """The access control."""
        found: Access = self.settings["access"]
        return found

    @property
    def host(self) -> str:
        """Requested host name; Tornado's own attribute may have a default."""
        return self.request.headers.get("Host", "")

    @property
    def cookie(self) -> str:
        """Name of the key's cookie, with the port: a host's cookies are shared by its ports."""
        return f"seft_monitor_{self.settings['port']}"

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
