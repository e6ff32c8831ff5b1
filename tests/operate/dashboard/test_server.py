"""The whole server with real sockets: browsers that stop reading, and an end without leftovers."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard import Dashboard, LogTap, session
from eal_actors.operate.dashboard.state_store import MOST_LINES
from tests.operate.dashboard.rig import WAIT_S, counting_fleet, open_dashboard, page_of, resource_of
from tests.plugin_files import write_plugin

LONG = "x" * 2000


@contextmanager
def deaf_browser(dashboard: Dashboard) -> Iterator[socket.socket]:
    """Yield a connection that has sent hello and reads nothing, with the smallest buffer that the system allows."""
    with socket.socket() as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        opened.settimeout(WAIT_S)
        opened.connect(("127.0.0.1", dashboard.port))
        place = f"127.0.0.1:{dashboard.port}"
        key = base64.b64encode(os.urandom(16)).decode()
        opened.sendall(
            f"GET /ws HTTP/1.1\r\nHost: {place}\r\nOrigin: http://{place}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        answer = b""
        while not answer.endswith(b"\r\n\r\n"):
            answer += opened.recv(1)
        assert answer.startswith(b"HTTP/1.1 101")
        opened.sendall(_frame(json.dumps({"do": "hello"})))
        assert opened.recv(1) == b"\x81"  # the start of the answer to hello
        yield opened


def _frame(text: str) -> bytes:
    data, mask = text.encode(), b"\0\0\0\0"  # which leaves the data as it is
    return struct.pack("!BB", 0x81, 0x80 | len(data)) + mask + data


def flood(dashboard: Dashboard) -> None:
    """Log far more than all buffers between server and browser hold."""
    for _ in range(3 * MOST_LINES["logs"]):
        dashboard.store.append("logs", {"level": "info", "text": LONG, "details": {}, "at": "", "robot": None})


def test_a_browser_that_stops_reading_slows_neither_the_fleet_nor_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "STUCK_S", 1000.0)  # it stays connected: another test covers its disconnection
    with counting_fleet(tmp_path, "one", "two").connect() as fleet, open_dashboard(fleet) as dashboard:
        poses = [resource_of(fleet, name, "Pose") for name in fleet]
        with page_of(dashboard) as page:
            page.hear_until(lambda: "one" in page.poses)
            with deaf_browser(dashboard):
                flood(dashboard)
                before = [pose.asked for pose in poses]
                seen = page.poses["one"]["at"][0]
                page.hear_until(lambda: all(now.asked > then + 50 for now, then in zip(poses, before, strict=True)))
                page.hear_until(lambda: page.poses["one"]["at"][0] > seen + 5.0 - 1e-6)
                answer = page.ask(do="call", robot="one", resource="Base", method="send_cmd", text="turn9")
                assert answer["ok"] is True
                assert page.ask(do="stop")["confirmed"] == ["one", "two"]


def test_a_browser_that_stops_reading_is_disconnected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "STUCK_S", 0.5)
    with (
        counting_fleet(tmp_path, "one").connect() as fleet,
        open_dashboard(fleet) as dashboard,
        page_of(dashboard) as page,
        deaf_browser(dashboard) as deaf,
    ):
        flood(dashboard)
        page.hear_until(lambda: any(line["details"].get("reason") == "it stopped reading" for line in page.logs))
        with contextlib.suppress(ConnectionResetError):
            while deaf.recv(65536):  # the last bytes on their way, then the end
                pass


def test_close_waits_for_no_browser(tmp_path: Path) -> None:
    with counting_fleet(tmp_path, "one").connect() as fleet:
        before = set(threading.enumerate())
        dashboard = open_dashboard(fleet).start()
        with deaf_browser(dashboard), deaf_browser(dashboard):
            flood(dashboard)
            dashboard.close()
        assert {thread.name for thread in threading.enumerate()} == {thread.name for thread in before}
        dashboard.close()


def test_close_does_not_stumble_over_a_browser_that_is_just_leaving(tmp_path: Path) -> None:
    with counting_fleet(tmp_path, "one").connect() as fleet:
        dashboard = open_dashboard(fleet).start()
        with deaf_browser(dashboard) as leaving, deaf_browser(dashboard), page_of(dashboard) as page:
            flood(dashboard)
            leaving.sendall(b"\x88\x80\0\0\0\0")  # an empty close frame; the flood is before its answer
            for _ in range(3):  # by then the server has read it
                assert page.ask(do="describe", robot="one")["ok"]
            dashboard.close()  # the thread of the web server must end without an exception, which fails the test


def test_the_same_port_can_be_used_again_at_once(tmp_path: Path) -> None:
    with counting_fleet(tmp_path, "one").connect() as fleet:
        with open_dashboard(fleet) as first, deaf_browser(first):
            port = first.port
        with open_dashboard(fleet, port=port) as second:
            assert second.port == port


def test_close_aborts_the_run_and_halts_the_robots(tmp_path: Path) -> None:
    scenarios = tmp_path / "scenarios"
    scenarios.mkdir()
    (scenarios / "hold.yaml").write_text(
        "version: 1\nname: hold\nroles: {all: {}}\ntimeout_s: 3600\n"
        "steps:\n  - on: all\n    do:\n      - send_cmd: {resource: Base, cmd: hold}\n"
    )
    with counting_fleet(tmp_path, "one").connect() as fleet:
        base = resource_of(fleet, "one", "Base")
        with open_dashboard(fleet, scenarios=scenarios) as dashboard:
            with page_of(dashboard) as page:
                assert page.ask(do="start", file="hold.yaml")["ok"] is True
                page.hear_until(lambda: bool(page.robots["one"]["running"]))
            assert dashboard.store.get("run", "")["phase"] == "running"  # the browser that started it may disconnect
        assert dashboard.store.get("run", "")["outcome"] == "aborted"
        assert base.halts >= 1


def test_lists_that_a_view_asks_for_at_once_are_all_answered(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        for number, what in enumerate(("plans", "scenarios") * 4):
            page.say(do=what, id=1000 + number)
        page.hear_until(lambda: len(page.answers) == 8)
        assert [answer for answer in page.answers.values() if not answer["ok"]] == []
        assert list(page.answers) == list(range(1000, 1008)), "in their order"


def test_no_poses_are_asked_for_without_a_browser(tmp_path: Path) -> None:
    with counting_fleet(tmp_path, "one").connect() as fleet, open_dashboard(fleet) as dashboard:
        pose = resource_of(fleet, "one", "Pose")
        with page_of(dashboard) as page:
            page.hear_until(lambda: "one" in page.poses)
        looks = threading.Event()
        dashboard.store.on_change = looks.set
        fleet.stop("seen").get(timeout=WAIT_S)  # the next state is stored after all poses asked for
        assert looks.wait(WAIT_S)
        asked = pose.asked
        looks.clear()
        fleet.resume().get(timeout=WAIT_S)
        assert looks.wait(WAIT_S)
        assert pose.asked == asked


def test_the_log_begins_before_the_fleet_is_connected(tmp_path: Path) -> None:
    """Why a robot did not start was missing."""
    write_plugin(tmp_path, "failing", "\ndef connect():\n    raise OSError('no port')\n", "Base")
    fleet = counting_fleet(tmp_path, "one", more="  broken: {plugins: {failing: {}}}\n")
    with LogTap() as log, fleet.connect(), open_dashboard(fleet, log=log) as dashboard, page_of(dashboard) as page:
        page.hear_until(lambda: any("no port" in str(line) for line in page.logs))
        get_logger(robot="one").info("begins")
        page.hear_until(lambda: page.logs[-1]["text"] == "begins")
