"""Who gets the page and may press its buttons, and what a page gets."""

import asyncio
import json

import pytest
from seft_msgs_py.errors import InputError
from seft_ros.monitor.access import (
    FIRST_WAIT,
    LONGEST_WAIT,
    MAX_ADDRESSES,
    Token,
    TooEarlyError,
    is_loopback,
    page_address,
)
from seft_ros.monitor.connections import MOST, PageServer
from seft_ros.monitor.server import listen
from seft_ros.monitor.web import Pages, application
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect


def serving(scenario, token="", local_only=True, everything=lambda: ["all"]):
    """Serve, and do what ``scenario(ask, pages, calls)`` does."""
    calls = []

    async def call(service):
        calls.append(service)
        return True, f"{service} it is"

    async def run():
        socket = listen("127.0.0.1", 0)
        port = socket.getsockname()[1]
        pages = Pages(everything)
        known = Token(token, lambda: ask.now)
        late = lambda state, at_ms: "" if (state, at_ms) == (3, 500.0) else "late"  # noqa: E731
        server = PageServer(application(known, local_only, port, pages, call, late))
        server.add_socket(socket)
        client = AsyncHTTPClient()

        def request(path, host=f"127.0.0.1:{port}", kind="http", **options):
            headers = {"Host": host, **options.pop("headers", {})}
            address = f"{kind}://127.0.0.1:{port}{path}"
            return HTTPRequest(address, headers=headers, follow_redirects=False, **options)

        async def ask(path, **options):
            return await client.fetch(request(path, **options), raise_error=False)

        ask.own = f"http://127.0.0.1:{port}"
        ask.request, ask.now = request, 0.0
        try:
            await scenario(ask, pages, calls)
        finally:
            client.close()
            server.stop()
            await server.close_all_connections()

    asyncio.run(run())


def post(path, origin=None, headers=None, **options):
    headers = ({"Origin": origin} if origin else {}) | (headers or {})
    return {"path": path, "method": "POST", "body": "", "headers": headers, **options}


def cookie_of(answer):
    """Header with which a browser that got this answer asks from then on."""
    return {"Cookie": answer.headers["Set-Cookie"].split(";")[0]}


def test_the_page_comes_with_all_it_needs_and_may_load_nothing_else():
    async def scenario(ask, *_):
        page = await ask("/")
        assert page.code == 200
        assert "Server" not in page.headers
        policy = page.headers["Content-Security-Policy"]
        assert "default-src 'none'; script-src 'self';" in policy
        assert "frame-ancestors 'none'" in policy
        assert page.headers["X-Content-Type-Options"] == "nosniff"
        text = page.body.decode()
        assert "http:" not in text and "https:" not in text and "<script>" not in text
        for path in ("/assets/monitor.js", "/assets/monitor.css", "/library/bokeh.min.js"):
            assert path in text
            assert (await ask(path)).code == 200
        assert json.loads((await ask("/figures.json")).body).keys() >= {"displacement", "force"}

    serving(scenario)


@pytest.mark.parametrize(
    "path", ["/nothing", "/assets/../web.py", "/assets/page.html", "/service/x"]
)
def test_nothing_else_is_there(path):
    async def scenario(ask, *_):
        assert (await ask(path)).code == 404

    serving(scenario)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "10.0.0.1", "a b", ""])
def test_a_page_for_this_host_has_no_other_name(host):
    async def scenario(ask, _, calls):
        assert (await ask("/", host=host)).code in (400, 403)
        assert (await ask(**post("/service/estop", f"http://{host}", host=host))).code in (400, 403)
        assert not calls

    serving(scenario)


def test_only_the_page_itself_presses_buttons():
    async def scenario(ask, _, calls):
        others = ("null", "http://evil.example", "http://127.0.0.1", "http://localhost:1")
        for origin in (None, *others):
            assert (await ask(**post("/service/stop", origin))).code == 403
        assert (await ask("/service/stop")).code == 405
        assert not calls
        answer = await ask(**post("/service/stop", ask.own))
        assert json.loads(answer.body) == {"done": True, "text": "stop it is"}
        assert calls == ["stop"]

    serving(scenario)


def test_only_the_page_itself_gets_all():
    async def scenario(ask, *_):
        for headers in ({}, {"Origin": "http://evil.example"}):
            with pytest.raises(HTTPClientError, match="403"):
                await websocket_connect(ask.request("/live", kind="ws", headers=headers))

    serving(scenario)


def test_without_the_token_there_is_nothing():
    async def scenario(ask, _, calls):
        for path in ("/", "/live", "/assets/monitor.js", "/figures.json", "/nothing"):
            answer = await ask(path, host="rig.lab:8765")
            assert answer.code == 401
            assert b"running" not in answer.body
        assert (await ask(**post("/service/estop", ask.own))).code == 401
        with pytest.raises(HTTPClientError, match="401"):
            await websocket_connect(ask.request("/live", kind="ws", headers={"Origin": ask.own}))
        assert not calls
        assert b"<form" in (await ask("/")).body

    serving(scenario, "a secret", local_only=False)


def test_a_token_in_the_address_becomes_a_cookie():
    async def scenario(ask, _, calls):
        answer = await ask("/?token=secret")
        assert (answer.code, answer.headers["Location"]) == (302, "/")
        cookie = answer.headers["Set-Cookie"]
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        known = cookie_of(answer)
        assert (await ask("/", headers=known)).code == 200
        assert (await ask("/", headers={"Authorization": "Bearer secret"})).code == 200
        assert (await ask(**post("/service/stop", ask.own, known))).code == 200
        assert calls == ["stop"]

    serving(scenario, "secret", local_only=False)


def test_a_wrong_token_is_reported_and_the_next_has_to_wait_but_not_who_has_a_cookie():
    async def scenario(ask, *_):
        assert b"wrong" not in (await ask("/")).body
        known = cookie_of(await ask("/?token=secret"))
        wrong = await ask("/?token=guess")
        assert (wrong.code, b"this token is wrong." in wrong.body) == (401, True)
        early = await ask("/?token=secret")
        assert (early.code, early.headers["Retry-After"]) == (429, "1")
        assert b"wait 1 s" in early.body and b"<form" in early.body
        assert (await ask("/", headers=known)).code == 200
        assert (await ask("/?token=secret", headers=known)).code == 302
        ask.now += 1.0
        assert (await ask("/?token=secret")).code == 302

    serving(scenario, "secret", local_only=False)


def test_who_guesses_waits_longer_each_time_and_holds_up_nobody_else():
    now = 0.0
    token = Token("secret", lambda: now)
    waits = []
    for _ in range(10):
        assert not token.is_right("guess", "10.0.0.1")
        with pytest.raises(TooEarlyError) as caught:
            token.is_right("secret", "10.0.0.1")
        waits.append(caught.value.wait)
        assert token.is_right("secret", "10.0.0.2")
        now += waits[-1]
    assert waits[:3] == [FIRST_WAIT, 2 * FIRST_WAIT, 4 * FIRST_WAIT]
    assert waits[-1] == LONGEST_WAIT
    assert token.is_right("secret", "10.0.0.1")
    assert not token.is_right("guess", "10.0.0.1")  # all is forgiven
    with pytest.raises(TooEarlyError) as caught:
        token.is_right("guess", "10.0.0.1")
    assert caught.value.wait == FIRST_WAIT
    for number in range(2 * MAX_ADDRESSES):
        token.is_right("guess", f"of many {number}")
    assert len(token._failures) == MAX_ADDRESSES


def test_who_sends_halves_of_requests_keeps_nobody_out():
    """And a page that is open stays so."""

    async def scenario(ask, pages, calls):
        port = int(ask.own.rpartition(":")[2])
        headers = {"Origin": ask.own, "Authorization": "Bearer secret"}
        page = await websocket_connect(ask.request("/live", kind="ws", headers=headers))
        halves = []
        for _ in range(2 * MOST):
            halves.append(await asyncio.open_connection("127.0.0.1", port))
            halves[-1][1].write(b"POST /service/estop HTTP/1.1\r\nHost: ")
        for reader, _ in halves[:MOST]:
            assert await reader.read() == b""  # the oldest are closed
        assert (await ask(**post("/service/estop", headers=headers))).code == 200
        assert calls == ["estop"]
        assert len(pages) == 1
        page.close()
        for _, writer in halves:
            writer.close()
        while await page.read_message() is not None:
            pass  # until it is closed

    serving(scenario, "secret", local_only=False)


def test_a_large_body_is_not_waited_for():
    async def scenario(ask, *_):
        port = int(ask.own.rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"POST /service/stop HTTP/1.1\r\nHost: a\r\nContent-Length: 5000\r\n\r\n")
        assert b"400 Bad Request" in await reader.read()
        writer.close()
        await writer.wait_closed()

    serving(scenario)


def test_the_cookie_is_not_the_token():
    async def scenario(ask, *_):
        name = cookie_of(await ask("/?token=secret"))["Cookie"].split("=")[0]
        assert (await ask("/", headers={"Cookie": f"{name}=secret"})).code == 401

    serving(scenario, "secret", local_only=False)


@pytest.mark.parametrize("service", ["start", "reset"])
def test_a_start_that_is_late_is_not_carried_out(service):
    async def scenario(ask, _, calls):
        asked = post(f"/service/{service}", ask.own)
        for body in ('{"state": 2, "at": 500}', '{"state": 3, "at": 400}'):
            answer = json.loads((await ask(**asked | {"body": body})).body)
            assert not answer["done"] and "late" in answer["text"]
        deep = "[" * 4000
        for body in (
            *("", "{}", "[]", deep, '{"state": 3, "at": "soon"}', '{"state": 3, "at": NaN}'),
            *('{"state": 1e400, "at": 500}', '{"state": 3, "at": 1e400}'),
        ):
            answer = await ask(**asked | {"body": body})
            assert (answer.code, b"does not say" in answer.body) == (400, True)
        assert not calls
        done = json.loads((await ask(**asked | {"body": '{"state": 3, "at": 500}'})).body)
        assert done["done"] and calls == [service]

    serving(scenario)


@pytest.mark.parametrize("service", ["stop", "estop"])
def test_a_stop_may_come_late(service):
    async def scenario(ask, _, calls):
        await ask(**post(f"/service/{service}", ask.own, body='{"state": 2, "at": 0}'))
        assert calls == [service]

    serving(scenario)


def test_a_page_gets_all_and_then_what_is_new():
    async def scenario(ask, pages, _):
        request = ask.request("/live", kind="ws", headers={"Origin": ask.own})
        page = await websocket_connect(request)
        assert await page.read_message() == "all"
        pages.send(["new", b"\x01\x02"])
        assert await page.read_message() == "new"
        assert await page.read_message() == b"\x01\x02"
        assert len(pages) == 1
        page.close()
        while len(pages):
            await asyncio.sleep(0.01)
        pages.send(["nobody"])

    serving(scenario)


def test_a_page_that_does_not_keep_up_is_left_out_and_later_gets_all_anew():
    class Slow:
        def __init__(self):
            self.sent, self.waiting = [], 0

        def send(self, frame):
            self.sent.append(frame)

    pages, slow = Pages(lambda: ["all"]), Slow()
    pages.add(slow)
    slow.waiting = 10**9
    pages.send(["one"])
    slow.waiting = 0
    pages.send(["two"])
    pages.send(["three"])
    assert slow.sent == ["all", "all", "three"]


def test_loopback_is_distinguished_from_what_others_reach():
    assert all(map(is_loopback, ("localhost", "127.0.0.1", "127.3.2.1", "::1")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "10.0.0.1", "lab", "127.0.0.1.evil", "")))
    assert page_address("0.0.0.0", 80) == "http://127.0.0.1:80/"
    assert page_address("::1", 80) == "http://[::1]:80/"


def test_a_port_in_use_is_named():
    held = listen("127.0.0.1", 0)
    port = held.getsockname()[1]
    try:
        with pytest.raises(InputError, match=f"127.0.0.1:{port}.*--port"):
            listen("127.0.0.1", port)
    finally:
        held.close()
