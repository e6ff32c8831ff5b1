"""`connect` to robots by an address of a fleet file, and to robots that no fleet file lists."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from eal_actors import Fleet, classic, connect
from eal_actors.facade.connections import find_robot
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import ConfigError, RobotNotFoundError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.wire.session import open_session, router_config
from tests.net.links import eventually, fleet_of, free_port

LOCALHOST = "127.0.0.1"


def endpoint(port: int) -> str:
    return f"tcp/{LOCALHOST}:{port}"


@pytest.fixture
def port() -> Iterator[int]:
    """The port of a robot `r1` that is served."""
    number = free_port()
    with RobotService(fleet_of({}, {"r1": endpoint(number)}), "r1"):
        yield number


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fleet file without the robot; it is the default fleet file."""
    file = tmp_path / "other.yaml"
    file.write_text("version: 1\nrobots: {here: {plugins: {sample: {}}}}\n", encoding="utf-8")
    monkeypatch.setenv("EAL_FLEET", str(file))
    return file


def test_a_robot_in_no_fleet_file_is_reached_by_host_and_port(port: int, file: Path) -> None:
    with connect(LOCALHOST, port) as eal:
        assert repr(eal) == "<EAL r1>"
        sample = eal.find_resource("SampleResource")
        assert eal.set_value(sample, 7) == 1
        assert eal.get_value(sample).value == 7


def test_connections_to_one_endpoint_share_a_robot(port: int, file: Path) -> None:
    with connect(LOCALHOST, port) as first, connect(endpoint(port)) as second:
        first.set_value(first.find_resource("SampleResource"), 3)  # else the actuator would be held by another
        assert second.set_value(second.find_resource("SampleResource"), 4) == 1


def test_the_thesis_s_call_reaches_it(port: int, file: Path) -> None:
    eal = classic.EALconnect(LOCALHOST, port)
    assert eal is not None
    assert eal.getResourceList() == ["SampleResource"]
    classic.EALdisconnect(eal)
    assert classic.EALconnect(LOCALHOST, free_port()) is None


def test_a_robot_of_the_fleet_file_is_found_by_its_address(port: int, file: Path) -> None:
    file.write_text(f"version: 1\nname: f\nrobots: {{r1: {{address: '{endpoint(port)}'}}}}\n", encoding="utf-8")
    with Fleet.load(file) as fleet, connect(LOCALHOST, port, fleet=fleet) as eal:
        assert repr(eal) == "<EAL r1>"
        with pytest.raises(RobotNotFoundError, match=f"has no robot '{LOCALHOST}'"):
            connect(LOCALHOST, port + 1, fleet=fleet)


def test_where_nobody_answers_that_is_told(file: Path) -> None:
    number = free_port()
    with pytest.raises(UnavailableError, match=f"'other' has no robot there, and nobody answers at {endpoint(number)}"):
        connect(LOCALHOST, number)


def test_what_is_no_endpoint_is_told(file: Path) -> None:
    with pytest.raises(RobotNotFoundError, match="unknown protocol 'tpc' in 'tpc/x:1'; did you mean 'tcp'"):
        connect("tpc/x:1")


def test_a_name_of_nothing_at_all_is_told_at_once(file: Path) -> None:
    with pytest.raises(RobotNotFoundError, match=r"fleet 'other' has no robot 'no_such'.*it has here"):
        connect("no_such")


def test_one_robot_behind_a_router_is_reached_and_several_are_named(file: Path) -> None:
    number = free_port()
    behind = fleet_of({"routers": [endpoint(number)]}, {"r1": "router", "r2": "router"})
    with open_session(router_config([endpoint(number)])):
        with pytest.raises(RobotNotFoundError, match="leads to no robot"):
            connect(LOCALHOST, number)
        with RobotService(behind, "r1"):
            with connect(LOCALHOST, number) as eal:
                assert eal.get_value(eal.find_resource("SampleResource")).value == 0
            with RobotService(behind, "r2"), pytest.raises(RobotNotFoundError, match="2 robots, r1, r2: name one"):
                connect(LOCALHOST, number)


def greet_all(listener: socket.socket) -> Callable[[], None]:
    """Accept all connections in a thread, say a few bytes and no more; return a function that ends this."""

    def greet() -> None:
        with ExitStack() as stack, suppress(OSError):  # it was shut down
            while True:
                end = stack.enter_context(listener.accept()[0])
                end.sendall(b"SSH-2.0-other\r\n")

    thread = threading.Thread(target=greet)
    thread.start()

    def end() -> None:
        listener.shutdown(socket.SHUT_RDWR)
        thread.join()

    return end


class TestSilentEnds:
    """The engine waits 10 s for the handshake of a silent end, and the end of the program for the engine."""

    @pytest.fixture(params=["accepts", "greets", "is switched off"])
    def silent(self, request: pytest.FixtureRequest) -> Iterator[int]:
        """The port of an end that accepts connections and says nothing more, or does not answer at all."""
        with ExitStack() as stack:
            end = stack.enter_context(socket.create_server((LOCALHOST, 0), backlog=0))
            number: int = end.getsockname()[1]
            if request.param == "greets":  # as the servers of many other protocols do
                stack.callback(greet_all(end))
            elif request.param == "is switched off":  # the kernel drops what comes beyond a full backlog
                stack.enter_context(socket.create_connection((LOCALHOST, number)))
            yield number

    def test_a_fleet_closes_at_once(self, silent: int) -> None:
        with capture_logs() as logs:
            fleet = Fleet(fleet_of({}, {"r1": endpoint(silent)}))
            fleet.connect(timeout_s=0.2)
            fleet.close()
        assert not [line["event"] for line in logs if "abandoned" in line["event"]]
        assert not engine_calls()

    def test_a_fleet_closes_at_once_while_no_router_answers(self, silent: int) -> None:
        with capture_logs() as logs:
            fleet = Fleet(fleet_of({"routers": [endpoint(silent)]}, {"r1": "router"}))
            fleet.connect()
            assert f"no router answers at {endpoint(silent)}" in str(fleet.problems[0])
            fleet.close(timeout_s=1.5)
        assert not [line["event"] for line in logs if "in time" in line["event"] or "abandoned" in line["event"]]
        assert eventually(lambda: not engine_calls())

    def test_a_search_for_a_robot_ends_at_its_time_out(self, silent: int, file: Path) -> None:
        with pytest.raises(UnavailableError, match="nobody answers"):
            connect(LOCALHOST, silent)
        assert eventually(lambda: not engine_calls())


def engine_calls() -> list[str]:
    """Return the names of the threads in which the engine opens or closes a session."""
    return [thread.name for thread in threading.enumerate() if thread.name in {"eal-net-open", "eal-net-close"}]


class TestKeys:
    def test_an_endpoint_that_wants_keys_takes_those_of_the_fleet_file(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        keys, number = tmp_path / "keys", free_port()
        make_authority(keys, "f")
        make_certificate(keys, "r1", [LOCALHOST])
        make_certificate(keys, "controller")
        security = "network: {security: {keys: keys, roles: {controllers: [controller]}}}\n"
        file = tmp_path / "f.yaml"
        file.write_text(
            f"version: 1\nname: f\n{security}robots: {{r1: {{address: 'tls/{LOCALHOST}:{number}', "
            "plugins: {sample: {}}}}\n",
            encoding="utf-8",
        )
        desk = tmp_path / "desk.yaml"
        desk.write_text(f"version: 1\nname: f\n{security}robots: {{here: {{plugins: {{sample: {{}}}}}}}}\n", "utf-8")
        with RobotService(EALConfigManager.load(file).fleet, "r1"):
            with connect(f"tls/{LOCALHOST}:{number}", fleet=desk) as eal:
                assert eal.set_value(eal.find_resource("SampleResource"), 1) == 1
            with pytest.raises(UnavailableError, match="nobody answers"):
                connect(f"tcp/{LOCALHOST}:{number}", fleet=desk)

    def test_without_keys_it_is_refused(self, file: Path) -> None:
        with pytest.raises(ConfigError, match="needs keys, and this fleet file names none"):
            connect(f"tls/{LOCALHOST}:1")


@pytest.mark.parametrize(
    ("host", "port", "robot"),
    [
        ("a", 1, "a"),
        ("10.0.0.1", 50000, "a"),
        ("tcp/10.0.0.1:50000", 1, "a"),
        ("udp/10.0.0.1:50000", 1, None),
        ("10.0.0.1", 50001, None),
        ("fe80::1", 5, "b"),
        ("c", 50000, "c"),
        ("d", 50000, None),
        ("no host", 50000, None),
    ],
)
def test_a_name_comes_before_an_address(host: str, port: int, robot: str | None) -> None:
    fleet: FleetConfig = fleet_of({}, {"a": "tcp/10.0.0.1:50000", "b": "tcp/[fe80::1]:5", "c": None})
    assert find_robot(fleet, host, port) == robot


def test_sockets_of_visits_are_closed(port: int, file: Path) -> None:
    def connected() -> bool:
        with socket.create_connection((LOCALHOST, port)):
            return True

    for _ in range(3):
        connect(LOCALHOST, port).disconnect()
    assert eventually(connected)
