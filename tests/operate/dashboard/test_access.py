"""Access: who may watch and who may command, and how requests are refused."""

from __future__ import annotations

import contextlib
import json
import socket as socket_module
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from structlog.testing import capture_logs
from websockets.exceptions import ConnectionClosed

from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.network_model import is_loopback
from eal_actors.operate.dashboard import Access, Dashboard
from eal_actors.operate.dashboard.access import Role
from eal_actors.operate.dashboard.limits import COMMANDS_AT_ONCE, MAX_BROWSERS, MESSAGES_AT_ONCE, TokenBucket
from eal_actors.operate.dashboard.session import POLICY_VIOLATION
from tests.operate.dashboard.rig import WAIT_S, connect_to, counting_fleet, open_dashboard, page_of

TOKEN = "the-token-of-these-tests"  # noqa: S105  # fixed, because it is part of test names
ALL = "0.0.0.0"  # noqa: S104  # nothing is bound to it here


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[Dashboard]:
    with counting_fleet(tmp_path, "one").connect() as fleet, open_dashboard(fleet, TOKEN) as opened:
        yield opened


@pytest.fixture
def client(dashboard: Dashboard) -> Iterator[TestClient]:
    """Speaks with the application itself: without a server."""
    with TestClient(dashboard.app.asgi, base_url=f"http://127.0.0.1:{dashboard.port}") as opened:
        yield opened


# The rules alone.


@pytest.mark.parametrize(
    ("host", "token", "shown", "may"),
    [
        ("127.0.0.1", None, None, True),
        ("::1", None, None, True),
        ("localhost", None, "whatever", True),
        (ALL, None, None, False),
        ("192.168.1.4", None, "whatever", False),
        ("127.0.0.1", TOKEN, None, False),
        ("127.0.0.1", TOKEN, TOKEN[:-1], False),
        ("127.0.0.1", TOKEN, "ä" * 32, False),
        (ALL, TOKEN, TOKEN, True),
    ],
)
def test_who_may_command(host: str, token: str | None, shown: str | None, may: bool) -> None:
    assert (Access(host, token).visitor(shown).role is Role.ADMINISTER) is may


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost"])
def test_loopback_is_loopback(host: str) -> None:
    assert is_loopback(host)


@pytest.mark.parametrize("host", [ALL, "::", "10.0.0.1", "localhost.evil.example", ""])
def test_anything_else_is_not(host: str) -> None:
    assert not is_loopback(host)


@pytest.mark.parametrize(
    ("header", "is_known"),
    [
        ("127.0.0.1:8080", True),
        ("localhost:9", True),
        ("[::1]:8080", True),
        ("192.168.0.7:8080", True),
        ("evil.example:8080", False),
        ("127.0.0.1.evil.example", False),
        ("", False),
        ("[::1", False),
        (None, False),
    ],
)
def test_only_names_of_this_machine_are_known_hosts(header: str | None, is_known: bool) -> None:
    assert Access("127.0.0.1").knows_host(header) is is_known


@pytest.mark.parametrize(
    ("origin", "is_own"),
    [
        ("http://127.0.0.1:8080", True),
        ("https://127.0.0.1:8080", True),
        ("http://127.0.0.1:8081", False),
        ("http://evil.example", False),
        ("null", False),
        ("file://127.0.0.1:8080", False),
        (None, False),
    ],
)
def test_only_the_own_origin_is_known(origin: str | None, is_own: bool) -> None:
    assert Access("127.0.0.1").knows_origin(origin, "127.0.0.1:8080") is is_own


def test_a_token_bucket_refills() -> None:
    bucket = TokenBucket(per_s=2, at_once=3)
    assert [bucket.take(0.0) for _ in range(4)] == [True, True, True, False]
    assert [bucket.take(0.5), bucket.take(0.5)] == [True, False]
    assert [bucket.take(100.0) for _ in range(4)] == [True, True, True, False]


# The application.


def test_every_answer_carries_the_security_headers(client: TestClient) -> None:
    for path in ("/", "/static/main.js", "/static/style.css", "/nowhere"):
        headers = client.get(path).headers
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"


def test_only_the_files_of_the_page_are_served(client: TestClient) -> None:
    assert client.get("/").headers["content-type"] == "text/html; charset=utf-8"
    for path in ("/static/../server.py", "/static/%2e%2e/server.py", "/static//etc/passwd", "/static/", "/server.py"):
        assert client.get(path).status_code == 404, path


def test_the_page_loads_nothing_from_elsewhere_and_runs_nothing_inline(client: TestClient) -> None:
    page = client.get("/").text
    assert "http://" not in page
    assert "https://" not in page
    assert "style=" not in page
    assert page.count("<script") == page.count('<script type="module" src="/static/')


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_nothing_is_commanded_by_http(client: TestClient, method: str) -> None:
    assert client.request(method, "/").status_code == 405


def test_a_request_with_a_foreign_host_is_refused(client: TestClient) -> None:
    assert client.get("/", headers={"host": "evil.example"}).status_code == 403


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://evil.example", "host": "evil.example"},
    ],
)
def test_only_the_dashboards_own_page_can_connect(client: TestClient, headers: dict[str, str]) -> None:
    address = str(client.base_url).rstrip("/").replace("http://", "ws://")
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(f"{address}/ws", headers=headers):
        pass


@pytest.mark.parametrize("token", [None, "wrong", TOKEN + "x"])
def test_without_the_token_one_may_only_watch(dashboard: Dashboard, token: str) -> None:
    with page_of(dashboard, token) as page:
        page.hear_until(lambda: "one" in page.poses)
        assert page.hello["may_command"] is False
        assert "read only" in page.hello["why"]
        commands = (
            {"do": "stop"},
            {"do": "resume"},
            {"do": "call", "robot": "one", "resource": "Base", "method": "send_cmd", "text": "hold"},
            {"do": "start", "file": "dance.yaml"},
            {"do": "control", "what": "abort"},
        )
        for command in commands:
            answer = page.ask(**command)
            assert (answer["ok"], answer["code"]) == (False, "access_denied"), command
        page.drive(robot="one", press=1, speed_m_s=0.1, turn_rad_s=0.0)
        page.hear_until(lambda: None in page.answers)
        assert page.answers[None]["code"] == "access_denied"
        assert page.robots["one"]["stopped"] is None


def test_with_the_token_one_may_command(dashboard: Dashboard) -> None:
    with page_of(dashboard, TOKEN) as page:
        assert page.hello["may_command"] is True
        assert page.ask(do="call", robot="one", resource="Base", method="send_cmd", text="turn90")["ok"] is True


def test_reading_a_value_is_a_command_because_it_reaches_the_robot(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        answer = page.ask(do="call", robot="one", resource="Pose", method="get_value")
        assert answer["code"] == "access_denied"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no json",
        "[]",
        "{}",
        '{"do": "fly"}',
        '{"do": "stop"}',
        '{"do": "stop", "id": -1}',
        '{"do": "stop", "id": 1, "more": 1}',
        '{"do": "drive", "robot": "one", "press": 1, "speed_m_s": 1e99, "turn_rad_s": 0}',
        '{"do": "drive", "robot": "one", "press": 1, "speed_m_s": NaN, "turn_rad_s": 0}',
        '{"do": "watch", "cameras": [["a","b"],["a","b"],["a","b"],["a","b"],["a","b"]]}',
        '{"do": "call", "id": 1, "robot": "one", "resource": "Base", "method": "write_comm"}',
        '{"do": "describe", "id": 1, "robot": "' + "x" * 300 + '"}',
    ],
)
def test_an_invalid_message_ends_the_connection(dashboard: Dashboard, text: str) -> None:
    with page_of(dashboard, TOKEN) as page:
        page.socket.send(text)
        assert page.hear_the_end() == 1008


def test_a_browser_that_does_not_send_hello_first_is_disconnected(dashboard: Dashboard) -> None:
    with connect_to(dashboard) as socket:
        socket.send(json.dumps({"do": "stop", "id": 1}))
        with pytest.raises(ConnectionClosed) as ending:
            socket.recv(WAIT_S)
        assert ending.value.rcvd is not None
        assert ending.value.rcvd.code == 1008


def test_too_many_commands_are_refused_but_never_a_stop(dashboard: Dashboard) -> None:
    with page_of(dashboard, TOKEN) as page:
        number = int(COMMANDS_AT_ONCE) + 30
        for index in range(number):
            page.say(do="describe", id=1000 + index, robot="one")
        assert page.ask(do="stop")["ok"] is True
        page.hear_until(lambda: len(page.answers) == number + 1)
        refused = [answer for answer in page.answers.values() if answer.get("code") == "busy"]
        assert refused
        assert page.ask(do="resume")["ok"] in (True, False)


def test_a_flood_ends_the_connection(dashboard: Dashboard) -> None:
    with page_of(dashboard, TOKEN) as page:
        with contextlib.suppress(ConnectionClosed):
            for _ in range(int(MESSAGES_AT_ONCE) * 3):
                page.say(do="release", robot="one")
        assert page.hear_the_end() == 1008


def test_the_number_of_browsers_is_limited(dashboard: Dashboard) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(MAX_BROWSERS):
            stack.enter_context(page_of(dashboard))
        with pytest.raises(ConnectionClosed) as ending, page_of(dashboard):
            pass
        assert ending.value.rcvd is not None
        assert ending.value.rcvd.code == 1013


def test_the_link_keeps_the_token_where_no_server_sees_it(dashboard: Dashboard) -> None:
    assert dashboard.link == f"{dashboard.url}#token={TOKEN}"


def test_a_port_in_use_is_reported(dashboard: Dashboard, tmp_path: Path) -> None:
    fleet = counting_fleet(tmp_path / "other", "two")
    with pytest.raises(ConfigError, match="cannot listen there"):
        Dashboard(fleet, port=dashboard.port)


def test_users_who_may_only_watch_do_not_fill_the_log(dashboard: Dashboard) -> None:
    """Each of their connections that ended badly was a line, and the pages keep the last thousand."""
    with capture_logs() as logs:
        for _ in range(20):
            with page_of(dashboard) as page:
                page.say(do="nothing")
                assert page.hear_the_end() == POLICY_VIOLATION
    assert len(logs) <= 1


def test_strangers_do_not_fill_the_log(dashboard: Dashboard, client: TestClient) -> None:
    long = "x" * 4000
    with capture_logs() as logs:
        for number in range(50):
            answer = client.get("/", headers={"host": f"{number}.{long}.example"})
            assert answer.status_code == 403
            with connect_to(dashboard) as socket:
                socket.send(json.dumps({"do": f"{number}{long}"}))
                with pytest.raises(ConnectionClosed):
                    socket.recv(WAIT_S)
            with socket_module.create_connection(("127.0.0.1", dashboard.port), WAIT_S) as raw:
                raw.sendall(b"\x16\x03\x01 no HTTP at all\r\n\r\n")
                raw.recv(1000)
    assert len(logs) <= 3
    assert len(str(logs)) < 3000
