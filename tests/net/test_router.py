"""Routers, compression, and sessions that open and close in time, over real links on this machine."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from eal_actors.cli.router import default_endpoint
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import ConfigError, ProtocolError, UnavailableError
from eal_actors.wire.session import controller_config, open_session, robot_config, router_config
from tests.net.links import PATIENCE_S, answering, ask, eventually, fleet_of, free_port
from tests.program import eal_processes

SEGMENTS = Path("/dev/shm")  # noqa: S108  # where shared memory shows


def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


def segments() -> set[Path]:
    return set(SEGMENTS.glob("*zenoh*"))


@pytest.fixture(autouse=True)
def no_leaked_segments() -> Iterator[None]:
    before = segments()
    yield
    assert segments() <= before


def test_robot_and_controller_share_nothing_but_a_router() -> None:
    router = endpoint()
    fleet = fleet_of({"routers": [router]}, {"r1": "router", "r2": "router"})

    with (
        open_session(router_config([router])),
        open_session(robot_config(fleet, "r1")) as one,
        open_session(robot_config(fleet, "r2")) as two,
        answering(one, "r1"),
        answering(two, "r2"),
        open_session(controller_config(fleet)) as controller,
    ):
        assert eventually(lambda: ask(controller, "eal/f/*/_/ping") == ["r1", "r2"])
        tokens = [str(reply.ok.key_expr) for reply in controller.liveliness().get("eal/f/@alive/*/*") if reply.ok]
        assert sorted(tokens) == ["eal/f/@alive/3/r1", "eal/f/@alive/3/r2"]


@pytest.mark.parametrize(
    ("routers", "listens"),
    [
        (["tcp/10.0.0.1:57801"], "tcp/0.0.0.0:57801"),
        (["tcp/10.0.0.1:57801", "tcp/10.0.0.2:57801"], "tcp/0.0.0.0:57801"),
        (["tcp/10.0.0.1:57801", "tcp/10.0.0.1:57802"], "tcp/0.0.0.0:7447"),
        ([], "tcp/0.0.0.0:7447"),
    ],
)
def test_a_router_listens_where_its_fleet_dials(routers: list[str], listens: str) -> None:
    fleet = fleet_of({"routers": routers}, {"r1": "router" if routers else None})
    assert default_endpoint(fleet) == listens


def test_two_routers_joined() -> None:
    near, far = endpoint(), endpoint()
    at_robot = fleet_of({"routers": [far]}, {"r1": "router"})
    at_desk = fleet_of({"routers": [near]}, {"r1": "router"})

    with (
        open_session(router_config([far], [near])),  # which does not exist yet
        open_session(robot_config(at_robot, "r1")) as robot,
        answering(robot, "r1"),
        open_session(router_config([near])),
        open_session(controller_config(at_desk)) as controller,
    ):
        assert eventually(lambda: ask(controller, "eal/f/r1/_/ping") == ["r1"])


def test_of_two_joined_routers_the_second_takes_over_and_nothing_comes_twice() -> None:
    routers, asked = [endpoint(), endpoint()], list[str]()
    fleet = fleet_of({"routers": routers}, {"r1": "router"})

    with (
        open_session(router_config([routers[1]], [routers[0]])),
        open_session(robot_config(fleet, "r1")) as robot,
        answering(robot, "r1", asked),
    ):
        with (
            open_session(router_config([routers[0]])),
            open_session(controller_config(fleet)) as controller,
        ):
            assert eventually(lambda: ask(controller, "eal/f/r1/_/ping") == ["r1"])
            asked.clear()
            assert ask(controller, "eal/f/r1/Wheels/send_cmd", least=1) == ["r1"]
            assert asked == ["eal/f/r1/Wheels/send_cmd"]
        with open_session(controller_config(fleet)) as controller:
            assert eventually(lambda: ask(controller, "eal/f/r1/_/ping") == ["r1"])


def test_robots_with_addresses_and_robots_behind_routers_in_one_fleet() -> None:
    routers, asked = [endpoint(), endpoint()], list[str]()
    fleet = fleet_of({"routers": routers}, {"r1": endpoint(), "r2": "router", "here": None})

    with (
        open_session(router_config([routers[0]])),
        open_session(router_config([routers[1]], [routers[0]])),
        open_session(robot_config(fleet, "r1")) as direct,
        open_session(robot_config(fleet, "r2")) as routed,
        answering(direct, "r1", asked),
        answering(routed, "r2", asked),
        open_session(controller_config(fleet)) as controller,
    ):
        assert eventually(lambda: ask(controller, "eal/f/*/_/ping") == ["r1", "r2"])
        asked.clear()
        assert ask(controller, "eal/f/*/_/hello", least=2) == ["r1", "r2"]
        assert asked == ["eal/f/*/_/hello"] * 2


def test_absent_robots_hold_up_nobody_and_are_found_when_they_come() -> None:
    fleet = fleet_of({}, {name: endpoint() for name in ("r1", "r2", "r3")})

    with open_session(robot_config(fleet, "r2")) as robot, answering(robot, "r2"):
        clock = SystemClock()
        with open_session(controller_config(fleet)) as controller:
            assert clock.now() < 1.0
            assert eventually(lambda: ask(controller, "eal/f/*/_/ping") == ["r2"])
            for _ in range(2):  # it restarts
                with open_session(robot_config(fleet, "r3")) as late, answering(late, "r3"):
                    assert eventually(lambda: ask(controller, "eal/f/*/_/ping") == ["r2", "r3"])


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_compression_at_both_ends(protocol: str) -> None:
    fleet = fleet_of({"compression": True}, {"r1": f"{protocol}/127.0.0.1:{free_port()}"})
    config = robot_config(fleet, "r1")
    frame = bytes(range(256)) * 256

    came: list[bytes] = []
    with (
        open_session(config) as robot,
        open_session(controller_config(fleet)) as controller,
        controller.declare_subscriber("eal/f/@streams/r1/**", lambda sample: came.append(sample.payload.to_bytes())),
    ):
        assert config["transport"]["unicast"]["compression"] == {"enabled": True}

        def publish() -> list[bytes]:
            robot.put("eal/f/@streams/r1/Camera/raw/5", frame)
            return came

        assert eventually(publish)
        assert set(came) == {frame}


class TestOpening:
    def test_a_port_in_use_is_told(self) -> None:
        with socket.socket() as other:
            other.bind(("127.0.0.1", 0))
            other.listen()
            place = f"tcp/127.0.0.1:{other.getsockname()[1]}"
            with (
                pytest.raises(UnavailableError, match=f"{place}: cannot listen there: the port is in use"),
                open_session(router_config([place])),
            ):
                pass

    def test_an_address_of_another_machine_is_told(self) -> None:
        fleet = fleet_of({}, {"r1": "tcp/192.0.2.1:50000"})

        with (
            pytest.raises(UnavailableError, match=r"tcp/192\.0\.2\.1:50000: .* this machine has no such address"),
            open_session(robot_config(fleet, "r1")),
        ):
            pass

    def test_without_a_router_it_gives_up_in_time(self) -> None:
        router, clock = endpoint(), SystemClock()
        fleet = fleet_of({"routers": [router]}, {"r1": "router"})

        with (
            pytest.raises(
                UnavailableError, match=f"{router}: (no router answers there|the .* did not open)"
            ),  # if busy
            open_session(robot_config(fleet, "r1"), timeout_s=0.3),
        ):
            pass

        assert clock.now() < 1.5

    def test_a_router_that_is_silent_is_not_waited_for(self) -> None:
        with socket.socket() as silent:
            silent.bind(("127.0.0.1", 0))
            silent.listen()
            router = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
            fleet = fleet_of({"routers": [router]}, {"r1": "router"})
            with (
                pytest.raises(UnavailableError, match=f"{router}: the network session did not open within 0.3 s"),
                open_session(robot_config(fleet, "r1"), timeout_s=0.3),
            ):
                pass
            silent.accept()[0].close()  # which ends the attempt

    def test_the_next_router_is_used_where_one_is_frozen(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as frozen:
            routers = [f"tcp/127.0.0.1:{frozen.getsockname()[1]}", endpoint()]
            fleet = fleet_of({"routers": routers}, {"r1": "router"})
            with open_session(router_config(routers[1:])), open_session(robot_config(fleet, "r1")) as robot:
                assert eventually(lambda: list(robot.info.routers_zid()))

    def test_it_waits_for_a_router_that_comes(self) -> None:
        router, opened = endpoint(), threading.Event()
        fleet = fleet_of({"routers": [router]}, {"r1": "router"})

        def serve() -> None:
            with open_session(robot_config(fleet, "r1"), timeout_s=PATIENCE_S):
                opened.set()

        robot = threading.Thread(target=serve)
        robot.start()
        with open_session(router_config([router])):
            assert opened.wait(PATIENCE_S)
            robot.join(PATIENCE_S)

    def test_what_zenoh_does_not_take_is_told(self) -> None:
        config = {**router_config([endpoint()]), "mode": "zebra"}

        with (
            pytest.raises(ProtocolError, match=r"does not take the configuration: .*zebra"),
            open_session(config),
        ):
            pass


def test_sessions_leave_no_threads_of_the_system_behind() -> None:
    def open_and_close() -> int:
        with open_session(router_config([endpoint()])):
            pass
        return len(list(Path("/proc/self/task").iterdir()))

    for _ in range(3):  # zenoh starts its threads on demand; all sessions share them
        open_and_close()
    before = open_and_close()
    counts = [open_and_close() for _ in range(6)]
    assert min(counts) <= before


FLOODED = """
import sys
from eal_actors.wire.session import open_session, robot_config
from tests.net.links import fleet_of

with (
    open_session(robot_config(fleet_of({}, {"r1": sys.argv[1]}), "r1")) as robot,
    robot.declare_subscriber("eal/f/**", lambda sample: None),
):
    print("ready", flush=True)
    sys.stdin.read()
"""


def test_a_session_closes_in_time_while_a_peer_stalls() -> None:
    import zenoh

    fleet = fleet_of({}, {"r1": endpoint()})
    process = subprocess.Popen(
        [sys.executable, "-c", FLOODED, str(fleet.robots["r1"].address)],
        cwd=bundled_path("."),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdin is not None
    try:
        assert process.stdout.readline() == b"ready\n"
        with open_session(controller_config(fleet)) as controller:
            publisher = controller.declare_publisher("eal/f/x", congestion_control=zenoh.CongestionControl.BLOCK)
            assert eventually(lambda: publisher.matching_status.matching)  # type: ignore[attr-defined]  # no bool
            process.send_signal(signal.SIGSTOP)

            def put_much() -> None:
                with contextlib.suppress(zenoh.ZError):  # the session is closed under it
                    for _ in range(100):
                        publisher.put(bytes(1_000_000))

            flood = threading.Thread(target=put_much)
            flood.start()
            flood.join(0.2)  # by then it blocks in the middle of a write
            assert flood.is_alive()
            clock = SystemClock()
        assert clock.now() < 2.0
        flood.join(PATIENCE_S)
        assert not flood.is_alive()
    finally:
        process.kill()
        process.stdout.close()
        process.stdin.close()
        process.wait()


class TestCommand:
    """`eal router` in a process of its own."""

    @pytest.fixture
    def start(self, tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
        with eal_processes(tmp_path) as start:
            yield partial(start, "router", environment={"COLUMNS": "200", "PATH": ""})

    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_it_routes_until_a_signal(
        self, start: Callable[..., subprocess.Popen[str]], number: signal.Signals
    ) -> None:
        router = endpoint()
        fleet = fleet_of({"routers": [router]}, {"r1": "router"})
        process = start("--listen", router)
        assert process.stderr is not None
        assert router in process.stderr.readline()

        with (
            open_session(robot_config(fleet, "r1")) as robot,
            answering(robot, "r1"),
            open_session(controller_config(fleet)) as controller,
        ):
            assert eventually(lambda: ask(controller, "eal/f/r1/_/ping") == ["r1"])
            clock = SystemClock()
            process.send_signal(number)
            process.wait(PATIENCE_S)
            assert clock.now() < 10.0  # 0.3 s on an idle machine
        assert process.returncode == 0

    def test_a_port_in_use_is_told(self, start: Callable[..., subprocess.Popen[str]]) -> None:
        with socket.socket() as other:
            other.bind(("127.0.0.1", 0))
            other.listen()
            process = start("--listen", f"tcp/127.0.0.1:{other.getsockname()[1]}")
            _, errors = process.communicate(timeout=PATIENCE_S)

        assert process.returncode == 3
        assert "cannot listen there: the port is in use by " in errors
        assert f" (pid {os.getpid()})\n" in errors

    def test_it_keeps_to_the_security_of_a_fleet(
        self, start: Callable[..., subprocess.Popen[str]], tmp_path: Path
    ) -> None:
        (tmp_path / "f.yaml").write_text(
            "version: 1\nnetwork: {security: {roles: {controllers: [controller], routers: [router]}}}\n"
            "robots: {r: {plugins: {sample: {}}}}\n"
        )
        process = start("--fleet", "f.yaml", "--listen", f"tls/127.0.0.1:{free_port()}")
        _, errors = process.communicate(timeout=PATIENCE_S)

        assert process.returncode == 2
        assert "keys/router.pem: is missing" in errors


def test_a_controller_needs_its_keys(tmp_path: Path) -> None:
    fleet = fleet_of({"security": {"roles": {"controllers": ["controller"]}}}, {"r1": "tls/h:1"}, tmp_path)

    with pytest.raises(ConfigError, match=r"controller\.pem: is missing"):
        controller_config(fleet)
