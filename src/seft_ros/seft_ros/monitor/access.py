"""Who may see the page and press its buttons.

A page in a browser can be asked for by any other page that the browser shows: so the names under
which this one is asked for, and the page that a request comes from, are looked at. Beyond this
host a token is needed as well.
"""

import hmac
import ipaddress
import re
from urllib.parse import urlsplit

_AUTHORITY = re.compile(r"(\[[0-9A-Fa-f:.%]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")


class Access:
    """Decides about requests.

    Parameters
    ----------
    token : str
        What a request must know; empty: nothing.
    local_only : bool
        Whether the page is served on this host alone: then it has no name but localhost, and
        who asks for another was led here by a name server (DNS rebinding).
    """

    def __init__(self, token: str, local_only: bool) -> None:
        self._token = token.encode()
        self._local_only = local_only

    @property
    def needs_token(self) -> bool:
        """Whether a request must know a token."""
        return bool(self._token)

    def knows_token(self, given: str) -> bool:
        """Compare a token, in a time that does not tell how much of it is right."""
        return hmac.compare_digest(given.encode(), self._token)

    def is_host(self, host: str) -> bool:
        """Whether a header Host is one under which the page is served."""
        match = _AUTHORITY.fullmatch(host)
        return match is not None and (not self._local_only or is_loopback(match[1].strip("[]")))

    def is_own_page(self, origin: str, host: str) -> bool:
        """Whether a header Origin says that a request comes from the page itself."""
        return origin.lower() in (f"http://{host.lower()}", f"https://{host.lower()}")


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
