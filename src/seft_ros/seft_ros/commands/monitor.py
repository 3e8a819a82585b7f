"""``seft monitor``: a page that shows a running test."""

import re
import secrets
import webbrowser
from typing import Annotated

from seft_msgs_py.errors import InputError

from seft_ros.commands.options import option


def monitor(
    host: Annotated[
        str,
        option(
            "Address to serve at; others than this host's own need a token, and show the test "
            "to whoever has it.",
            "ADDRESS",
        ),
    ] = "127.0.0.1",
    port: Annotated[int, option("Port; 0: any that is free.", "N", min=0, max=65535)] = 8765,
    token: Annotated[
        str,
        option(
            "What a browser must know; one is made where it is needed and not given. "
            "SEFT_MONITOR_TOKEN keeps it out of the list of processes.",
            "TEXT",
            envvar="SEFT_MONITOR_TOKEN",
        ),
    ] = "",
    watch_token: Annotated[
        str,
        option(
            "What a browser must know to watch only, without buttons; control needs a token then, "
            "also on this host. SEFT_MONITOR_WATCH_TOKEN keeps it out of the list of processes.",
            "TEXT",
            envvar="SEFT_MONITOR_WATCH_TOKEN",
        ),
    ] = "",
    namespace: Annotated[str, option("Namespace of the test's topics.", "NAME")] = "",
    open_page: Annotated[
        bool, option("Open the page in the browser, off the loop's core too.", "--open")
    ] = False,
) -> int:
    """Show a running test on a page in the browser, with buttons to start and stop it.

    Any test on the ROS domain: of seft run, of ros2 run, several one after another. It shows the
    state and trips, displacement, acceleration and force with their reference, round trip and
    missed commands, margins to the limits. What it has seen survives a reload of the page.

    Buttons call the supervisor: Start, Stop and Reset ask once more, Abort test takes one press.
    A button in a browser is no emergency stop: that is a circuit in hardware.

    It listens at 127.0.0.1 alone unless --host says otherwise. Ctrl-C ends it, not the test.

    Examples:

        seft monitor

        seft monitor --open

        ROS_DOMAIN_ID=7 seft monitor --port 8801

        seft monitor --host 0.0.0.0 --token "$(openssl rand -hex 16)"
    """
    from seft_ros.monitor.access import Tokens, is_loopback, page_address
    from seft_ros.monitor.serve import keep_off_the_loop, listen, serve

    for name, text in (("--token", token), ("--watch-token", watch_token)):
        if any(not c.isprintable() or c.isspace() for c in text) or not text.isascii():
            raise InputError(f"{name}: use printable ASCII characters without blanks")
    if token and token == watch_token:
        raise InputError("--watch-token: is the token that controls; use another")
    if not re.fullmatch(r"(/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*)?", namespace, re.ASCII):
        raise InputError(f"--namespace {namespace}: is no name of ROS, such as /lab2")
    if not token and (watch_token or not is_loopback(host)):
        token = secrets.token_urlsafe(24)
    keep_off_the_loop()
    listening = listen(host, port)
    page = page_address(host, listening.getsockname()[1])
    address = f"{page}?token={token}" if token else page

    def ready() -> None:
        print(f"seft monitor: {address}", flush=True)
        if watch_token:
            print(f"to watch only: {page}?token={watch_token}", flush=True)
        if open_page:
            webbrowser.open(address)

    serve(listening, host, Tokens(token, watch_token), namespace, ready)
    return 0
