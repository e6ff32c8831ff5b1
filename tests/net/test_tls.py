"""Certificates and roles over real TLS and QUIC links on this machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import zenoh

from eal_actors import Fleet
from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.wire.session import controller_config, open_session, robot_config, router_config
from tests.net.links import answering, ask, eventually, fleet_of, free_port
from tests.security.forging import as_seen_by

ROLES = {
    "controllers": ["controller", {"name": "driver", "robots": ["r1"], "resources": ["Wheels"]}],
    "observers": ["display", {"name": "guest", "robots": ["r2"]}, {"name": "driver"}],
    "routers": ["gate"],
}


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a fleet file, with the keys of all roles."""
    folder = tmp_path_factory.mktemp("fleet")
    make_authority(folder / "keys", "f")
    for robot in ("r1", "r2", "gate"):
        make_certificate(folder / "keys", robot, ["127.0.0.1"])
    for name in ("controller", "driver", "display", "guest", "stranger"):
        make_certificate(folder / "keys", name)
    return folder


def secured(folder: Path, robots: Mapping[str, str | None], routers: tuple[str, ...] = ()) -> FleetConfig:
    """Return a fleet with keys in the folder; r1 and r2, which its roles name, are local where no address is given."""
    network = {"security": {"roles": ROLES}, "routers": list(routers)}
    return fleet_of(network, {"r1": None, "r2": None, **robots}, folder)


@dataclass
class Served:
    """Two robots that listen, and the calls that each received."""

    fleet: FleetConfig
    asked: list[str]
    robots: dict[str, zenoh.Session]


@pytest.fixture
def served(keys: Path) -> Iterator[Served]:
    robots = {name: f"tls/127.0.0.1:{free_port()}" for name in ("r1", "r2")}
    fleet, asked = secured(keys, robots), list[str]()
    with ExitStack() as stack:
        sessions = {name: stack.enter_context(open_session(robot_config(fleet, name))) for name in robots}
        for name, session in sessions.items():
            stack.enter_context(answering(session, name, asked))
        yield Served(fleet, asked, sessions)


def ask_each(session: zenoh.Session, method: str, caller: str) -> list[str]:
    """Call a method of both robots, and return which answer."""
    return [name for robot in ("r1", "r2") for name in ask(session, f"eal/f/{robot}/{method}", caller)]


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_both_ends_prove_who_they_are(keys: Path, protocol: str) -> None:
    fleet = secured(keys, {"r1": f"{protocol}/127.0.0.1:{free_port()}"})

    with (
        open_session(robot_config(fleet, "r1")) as robot,
        answering(robot, "r1"),
        open_session(controller_config(fleet)) as controller,
    ):
        assert eventually(lambda: ask(controller, "eal/f/r1/Wheels/send_cmd", "controller") == ["r1"])


def test_a_controller_may_do_everything_with_every_robot(served: Served) -> None:
    with open_session(controller_config(served.fleet)) as controller:
        assert eventually(lambda: ask_each(controller, "_/ping", "controller") == ["r1", "r2"])
        assert ask(controller, "eal/f/r1/Wheels/send_cmd", "controller", least=1) == ["r1"]
        assert ask(controller, "eal/f/r2/_/resume", "controller", least=1) == ["r2"]
        assert ask(controller, "eal/f/*/_/resume", "controller") == []  # a call is for one robot


def test_a_heartbeat_reaches_the_robots_from_a_controller_in_its_own_name_alone(served: Served) -> None:
    beats: list[str] = []
    names = "controller", "driver", "display"
    with ExitStack() as stack:
        stack.enter_context(
            served.robots["r1"].declare_subscriber(
                "eal/f/@heartbeats/*/*", lambda beat: beats.append(str(beat.key_expr).partition("@heartbeats/")[2])
            )
        )
        sessions = {
            name: stack.enter_context(open_session(controller_config(as_seen_by(served.fleet, name)))) for name in names
        }
        assert eventually(lambda: ask(sessions["display"], "eal/f/r1/_/ping", "display"))

        def beat() -> bool:
            for sender, session in sessions.items():
                for name in names:
                    session.put(f"eal/f/@heartbeats/{name}/{sender}", b"")
            return {"controller/controller", "driver/driver"} <= set(beats)

        assert eventually(beat)
    assert set(beats) == {"controller/controller", "driver/driver"}


def test_an_observer_reads_but_does_not_command(served: Served) -> None:
    with open_session(controller_config(as_seen_by(served.fleet, "display"))) as display:
        assert eventually(lambda: ask_each(display, "_/hello", "display") == ["r1", "r2"])
        for method in ("get_status", "get_value", "send_req", "get_config"):
            assert ask(display, f"eal/f/r1/Wheels/{method}", "display", least=1) == ["r1"], method
        served.asked.clear()
        for key in (
            *(
                f"r1/Wheels/{method}"
                for method in ("send_cmd", "set_value", "set_config", "read_comm", "write_comm", "halt")
            ),
            *(f"r1/_/{method}" for method in ("stop", "resume", "reattach")),
            "r1/**",
            "*/*/send_cmd",
        ):
            assert ask(display, f"eal/f/{key}", "display") == [], key
        assert eventually(lambda: ask(display, "eal/f/r1/_/ping", "display") == ["r1"])  # which comes after them
        assert set(served.asked) == {"eal/f/r1/_/ping"}


def test_an_observer_sees_events_streams_and_who_lives(served: Served) -> None:
    seen: list[str] = []
    with (
        open_session(controller_config(as_seen_by(served.fleet, "display"))) as display,
        display.declare_subscriber("eal/f/@events/*", lambda event: seen.append(event.payload.to_string())),
        display.declare_subscriber(
            "eal/f/@streams/r1/Camera/raw/5", lambda frame: seen.append(frame.payload.to_string())
        ),
        display.liveliness().declare_subscriber(
            "eal/f/@alive/*/*", lambda token: seen.append(str(token.key_expr)), history=True
        ),
    ):

        def tell() -> bool:
            served.robots["r2"].put("eal/f/@events/r2", "event")
            served.robots["r1"].put("eal/f/@streams/r1/Camera/raw/5", "frame")
            return {"event", "frame", "eal/f/@alive/3/r1", "eal/f/@alive/3/r2"} <= set(seen)

        assert eventually(tell), seen


def test_a_role_may_be_limited_to_robots_and_to_resources(served: Served) -> None:
    with open_session(controller_config(as_seen_by(served.fleet, "driver"))) as driver:
        assert eventually(lambda: ask(driver, "eal/f/r1/Wheels/send_cmd", "driver") == ["r1"])
        assert ask(driver, "eal/f/r1/_/stop", "driver", least=1) == ["r1"]
        assert ask(driver, "eal/f/r1/Camera/get_value", "driver", least=1) == ["r1"]  # named twice: both rights
        for key in ("r1/Camera/send_cmd", "r2/Wheels/send_cmd", "r1/_/resume", "r2/_/stop"):
            assert ask(driver, f"eal/f/{key}", "driver") == [], key
    with open_session(controller_config(as_seen_by(served.fleet, "guest"))) as guest:
        assert eventually(lambda: ask(guest, "eal/f/r2/Camera/get_value", "guest") == ["r2"])
        assert ask(guest, "eal/f/r1/Camera/get_value", "guest") == []


def test_nobody_calls_in_the_name_of_another_or_hears_what_another_is_answered(served: Served) -> None:
    with (
        open_session(controller_config(served.fleet)) as controller,
        open_session(controller_config(as_seen_by(served.fleet, "display"))) as display,
    ):
        assert eventually(lambda: ask(display, "eal/f/r1/_/ping", "display") == ["r1"])
        served.asked.clear()
        assert ask(display, "eal/f/r1/Wheels/get_value", "controller") == []
        assert ask(display, "eal/f/r1/Wheels/get_value", "controller", hears="display") == []
        assert ask(display, "eal/f/r1/Wheels/get_value", "display", least=1) == ["r1"]
        assert served.asked == ["eal/f/r1/Wheels/get_value"]

        overheard: list[str] = []
        with (
            display.declare_subscriber("eal/f/@answers/**", lambda answer: overheard.append(str(answer.key_expr))),
            display.declare_subscriber("eal/f/@answers/controller/*/*", lambda answer: overheard.append("precisely")),
            display.declare_subscriber(
                "eal/f/r1/**", lambda call: overheard.append("a call"), allowed_origin=zenoh.Locality.REMOTE
            ),
        ):
            for _ in range(3):
                assert ask(display, "eal/f/r1/_/ping", "display", least=1) == ["r1"]
                assert ask(controller, "eal/f/r1/Wheels/get_value", "controller", least=1) == ["r1"]
            assert ask(display, "eal/f/r1/_/ping", "display", least=1) == ["r1"]
        assert not [key for key in overheard if "display" not in key], overheard


@pytest.mark.parametrize("name", ["stranger", "r2"])
def test_a_certificate_without_a_role_opens_nothing(served: Served, name: str) -> None:
    with (
        open_session(controller_config(as_seen_by(served.fleet, name))) as stranger,
        open_session(controller_config(served.fleet)) as controller,
    ):
        assert eventually(lambda: list(stranger.info.peers_zid()))  # it is linked
        assert eventually(lambda: ask(controller, "eal/f/r1/_/ping", "controller"))
        served.asked.clear()
        for key in ("r1/_/hello", "r1/Wheels/get_value", "r1/Wheels/send_cmd", "**"):
            assert ask(stranger, f"eal/f/{key}", name) == [], key
        assert served.asked == []


@pytest.mark.parametrize("name", ["controller", "display", "r1"])
def test_a_certificate_of_another_authority_is_refused(served: Served, tmp_path: Path, name: str) -> None:
    """That of another fleet with the same names, which is served and commanded elsewhere."""
    make_authority(tmp_path / "keys", "f")
    make_certificate(tmp_path / "keys", name, ["127.0.0.1"])
    addresses = {name: robot.address for name, robot in served.fleet.robots.items()}
    forged = secured(tmp_path, addresses)

    check_refused(served, controller_config(as_seen_by(forged, name)))


def test_a_robot_of_another_authority_is_refused(keys: Path, tmp_path: Path) -> None:
    """It has the robot's name, listens at its address, and would take its commands."""
    make_authority(tmp_path / "keys", "f")
    make_certificate(tmp_path / "keys", "r1", ["127.0.0.1"])
    addresses = {name: f"tls/127.0.0.1:{free_port()}" for name in ("r1", "r2")}
    fleet, forged, asked = secured(keys, addresses), secured(tmp_path, addresses), list[str]()

    with (
        open_session(robot_config(forged, "r1")) as robot,
        answering(robot, "r1", asked),
        open_session(robot_config(fleet, "r2")) as honest,
        answering(honest, "r2"),
        open_session(controller_config(fleet)) as controller,
    ):
        assert eventually(lambda: ask_each(controller, "_/ping", "controller") == ["r2"])
        assert ask(controller, "eal/f/r1/Wheels/send_cmd", "controller") == []
        assert list(controller.info.peers_zid()) == [honest.zid()]
        assert asked == []


def test_no_certificate_is_refused(served: Served) -> None:
    config = controller_config(served.fleet)
    tls = config["transport"]["link"]["tls"]
    config["transport"]["link"]["tls"] = {"root_ca_certificate": tls["root_ca_certificate"]}

    check_refused(served, config)


def check_refused(served: Served, config: dict[str, object]) -> None:
    """An impostor's session opens, since peers open before they are linked, but no link is made."""
    with open_session(config) as impostor, open_session(controller_config(served.fleet)) as controller:
        assert eventually(lambda: ask_each(controller, "_/ping", "controller") == ["r1", "r2"])
        served.asked.clear()
        for _ in range(5):
            assert ask(impostor, "eal/f/r1/_/ping", "controller") == []
            assert list(impostor.info.peers_zid()) == []
            assert ask(controller, "eal/f/r1/_/ping", "controller", least=1) == ["r1"]
        assert len(served.asked) == 5


def test_a_robot_that_is_not_at_its_address_is_refused(keys: Path) -> None:
    """The thief of one robot's key cannot listen at another robot's address."""
    make_certificate(keys / "keys", "elsewhere", ["10.99.0.1"])
    address = f"tls/127.0.0.1:{free_port()}"
    fleet = secured(keys, {"r1": address, "r2": f"tls/127.0.0.1:{free_port()}", "elsewhere": "tls/10.99.0.1:50000"})
    thief = replace(fleet, robots={**fleet.robots, "elsewhere": replace(fleet.robots["elsewhere"], address=address)})

    with (
        open_session(robot_config(thief, "elsewhere")) as robot,
        answering(robot, "r1"),
        open_session(robot_config(fleet, "r2")) as honest,
        answering(honest, "r2"),
        open_session(controller_config(fleet, ["r1", "r2"])) as controller,
    ):
        assert eventually(lambda: ask_each(controller, "_/ping", "controller") == ["r2"])
        assert ask(controller, "eal/f/r1/_/ping", "controller") == []
        assert list(controller.info.peers_zid()) == [honest.zid()]


def test_a_robot_speaks_for_itself_alone(keys: Path) -> None:
    fleet = secured(keys, {name: f"tls/127.0.0.1:{free_port()}" for name in ("r1", "r2")})
    dishonest = robot_config(fleet, "r2")
    del dishonest["access_control"]

    with (
        open_session(dishonest) as robot,
        answering(robot, "r2"),
        answering(robot, "r1"),
        open_session(controller_config(fleet)) as controller,
    ):
        assert eventually(lambda: ask(controller, "eal/f/r2/_/ping", "controller") == ["r2"])
        assert ask(controller, "eal/f/r1/_/ping", "controller") == []


def test_a_router_checks_what_robots_behind_it_cannot(keys: Path) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    fleet, asked = secured(keys, {"r1": "router", "r2": "router"}, (endpoint,)), list[str]()

    with (
        open_session(router_config([endpoint], fleet=fleet, name="gate")),
        open_session(robot_config(fleet, "r1")) as robot,
        answering(robot, "r1", asked),
        open_session(controller_config(fleet)) as controller,
        open_session(controller_config(as_seen_by(fleet, "display"))) as display,
        open_session(controller_config(as_seen_by(fleet, "driver"))) as driver,
        open_session(robot_config(fleet, "r2")) as other,
    ):
        assert eventually(lambda: ask(controller, "eal/f/r1/Wheels/send_cmd", "controller") == ["r1"])
        assert ask(controller, "eal/f/r1/_/ping", "controller", least=1) == ["r1"]
        assert ask(driver, "eal/f/r1/Wheels/send_cmd", "driver", least=1) == ["r1"]
        assert ask(display, "eal/f/r1/Wheels/get_value", "display", least=1) == ["r1"]
        asked.clear()
        assert ask(display, "eal/f/r1/Wheels/send_cmd", "display") == []
        assert ask(driver, "eal/f/r1/Camera/send_cmd", "driver") == []
        assert ask(other, "eal/f/r1/_/ping", "r2") == []
        with answering(other, "r1"):
            assert ask(controller, "eal/f/r1/_/ping", "controller", least=1) == ["r1"]
        assert asked == ["eal/f/r1/_/ping"]


def test_missing_keys_are_named(tmp_path: Path) -> None:
    fleet = secured(tmp_path, {"r1": "tls/127.0.0.1:50000"})

    with pytest.raises(ConfigError) as caught:
        robot_config(fleet, "r1")

    assert [Path(problem.file).name for problem in caught.value.problems] == ["ca.pem", "r1.key", "r1.pem"]
    with pytest.raises(ConfigError, match=r"controller\.pem"):
        Fleet(fleet).connect()
