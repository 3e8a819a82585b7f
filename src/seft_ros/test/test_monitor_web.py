"""Who gets the page and may press its buttons, and what a page gets."""

import asyncio
import json

import pytest
from seft_msgs_py.errors import InputError
from seft_ros.monitor.server import LARGEST_REQUEST, listen, page_address
from seft_ros.monitor.web import Pages, application
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.httpserver import HTTPServer
from tornado.websocket import websocket_connect

TOKEN = "secret"


def serving(scenario, everything=lambda: ["all"]):
    """Serve, and do what ``scenario(ask, pages, calls)`` does."""
    calls = []

    async def call(service):
        calls.append(service)
        return True, f"{service} it is"

    async def run():
        socket = listen("127.0.0.1", 0)
        port = socket.getsockname()[1]
        pages = Pages(everything)
        late = lambda state, at_ms: "" if (state, at_ms) == (3, 500.0) else "late"  # noqa: E731
        web = application(TOKEN, port, pages, call, late)
        server = HTTPServer(web, max_body_size=LARGEST_REQUEST)
        server.add_socket(socket)
        client = AsyncHTTPClient()

        def request(path, kind="http", **options):
            address = f"{kind}://127.0.0.1:{port}{path}"
            return HTTPRequest(address, follow_redirects=False, **options)

        async def ask(path, **options):
            return await client.fetch(request(path, **options), raise_error=False)

        ask.own = f"http://127.0.0.1:{port}"
        ask.request, ask.known = request, {"Cookie": f"seft_monitor_{port}={TOKEN}"}
        try:
            await scenario(ask, pages, calls)
        finally:
            client.close()
            server.stop()
            await server.close_all_connections()

    asyncio.run(run())


def post(ask, path, origin=None, body=""):
    headers = {"Origin": ask.own if origin is None else origin, **ask.known}
    return {"path": path, "method": "POST", "body": body, "headers": headers}


def test_the_page_comes_with_all_it_needs():
    async def scenario(ask, *_):
        page = await ask("/", headers=ask.known)
        assert (page.code, page.headers["X-Frame-Options"]) == (200, "DENY")
        text = page.body.decode()
        assert "http:" not in text and "https:" not in text and "<script>" not in text
        for path in ("/assets/monitor.js", "/assets/monitor.css", "/library/bokeh.min.js"):
            assert path in text
            assert (await ask(path, headers=ask.known)).code == 200
        figures = await ask("/figures.json", headers=ask.known)
        assert json.loads(figures.body).keys() >= {"displacement", "force"}

    serving(scenario)


@pytest.mark.parametrize(
    "path", ["/nothing", "/assets/../web.py", "/assets/page.html", "/service/x"]
)
def test_nothing_else_is_there(path):
    async def scenario(ask, *_):
        assert (await ask(path, headers=ask.known)).code == 404

    serving(scenario)


def test_only_the_page_itself_presses_buttons_and_gets_all():
    async def scenario(ask, _, calls):
        for origin in ("", "null", "http://evil.example", "http://127.0.0.1", "http://localhost:1"):
            assert (await ask(**post(ask, "/service/stop", origin))).code == 403
            if origin:
                headers = {"Origin": origin, **ask.known}
                with pytest.raises(HTTPClientError, match="403"):
                    await websocket_connect(ask.request("/live", kind="ws", headers=headers))
        assert (await ask("/service/stop", headers=ask.known)).code == 405
        assert not calls
        answer = await ask(**post(ask, "/service/stop"))
        assert json.loads(answer.body) == {"done": True, "text": "stop it is"}
        assert calls == ["stop"]

    serving(scenario)


@pytest.mark.parametrize("offered", ["", "?token=guess", "?token=%C3%A9"])
def test_without_the_token_there_is_nothing(offered):
    async def scenario(ask, _, calls):
        ask.known = {}
        for path in ("/", "/live", "/assets/monitor.js", "/figures.json"):
            answer = await ask(path + offered)
            assert answer.code == 401
            assert b"running" not in answer.body
        assert (await ask(**post(ask, f"/service/estop{offered}"))).code == 401
        with pytest.raises(HTTPClientError, match="401"):
            await websocket_connect(ask.request(f"/live{offered}", kind="ws"))
        assert not calls
        assert b"<form" in (await ask(f"/{offered}")).body

    serving(scenario)


def test_a_token_in_the_address_becomes_a_cookie():
    async def scenario(ask, *_):
        answer = await ask("/?token=secret")
        assert (answer.code, answer.headers["Location"]) == (302, "/")
        cookie = answer.headers["Set-Cookie"]
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        assert {"Cookie": cookie.split(";")[0]} == ask.known

    serving(scenario)


def test_the_address_is_one_for_a_browser_on_this_host():
    assert page_address("0.0.0.0", 80, "a") == "http://127.0.0.1:80/?token=a"
    assert page_address("::1", 80, "a") == "http://[::1]:80/?token=a"


def test_a_large_body_is_not_waited_for():
    async def scenario(ask, *_):
        port = int(ask.own.rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"POST /service/stop HTTP/1.1\r\nHost: a\r\nContent-Length: 5000\r\n\r\n")
        assert b"400 Bad Request" in await reader.read()
        writer.close()
        await writer.wait_closed()

    serving(scenario)


@pytest.mark.parametrize("service", ["start", "reset"])
def test_a_start_that_is_late_is_not_carried_out(service):
    async def scenario(ask, _, calls):
        asked = post(ask, f"/service/{service}")
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
        await ask(**post(ask, f"/service/{service}", body='{"state": 2, "at": 0}'))
        assert calls == [service]

    serving(scenario)


def test_a_page_gets_all_and_then_what_is_new():
    async def scenario(ask, pages, _):
        headers = {"Origin": ask.own, **ask.known}
        request = ask.request("/live", kind="ws", headers=headers)
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


def test_a_port_in_use_is_named():
    held = listen("127.0.0.1", 0)
    port = held.getsockname()[1]
    try:
        with pytest.raises(InputError, match=f"127.0.0.1:{port}.*--port"):
            listen("127.0.0.1", port)
    finally:
        held.close()
