from __future__ import annotations

import re
from pathlib import Path

import pytest

from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_loader import load_fleet
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import Grant, NetworkConfig, parse_endpoint
from tests.problems import problem_texts

PLUGINS = "plugins: {s: {}}"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def load(text: str) -> FleetConfig:
    Path("f.yaml").write_text(f"version: 1\n{text}", encoding="utf-8")
    return load_fleet("f.yaml", {})


def problems(text: str) -> list[str]:
    return problem_texts(lambda: load(text))


def test_without_a_network_section_robots_are_local_and_the_defaults_hold() -> None:
    fleet = load(f"robots: {{r: {{{PLUGINS}}}}}")

    assert (fleet.robots["r"].address, fleet.robots["r"].listen) == (None, None)
    assert fleet.network == NetworkConfig(2.0, 2.0, False, False, (), None)


def test_everything_a_network_may_say() -> None:
    network = load(f"""
network:
  lease_s: 1
  dead_man_s: 0.5
  compression: true
  discovery: true
  routers: ['tls/10.0.0.1:7447', 'quic/[fe80::1]:7447']
  security:
    keys: secrets
    controller: desk
    roles:
      controllers: [desk, {{name: student, robots: [r], resources: [Wheels]}}]
      observers: [student, {{name: display, robots: [r]}}]
      routers: [gate]
robots: {{r: {{{PLUGINS}, address: router}}}}
""").network

    assert (network.lease_s, network.dead_man_s, network.compression, network.discovery) == (1.0, 0.5, True, True)
    assert network.routers == ("tls/10.0.0.1:7447", "quic/[fe80::1]:7447")
    assert network.security is not None
    assert (network.security.keys, network.security.controller) == (Path("secrets"), "desk")
    assert network.security.grants == (
        Grant("desk", "controller"),
        Grant("student", "controller", ("r",), ("Wheels",)),
        Grant("student", "observer"),
        Grant("display", "observer", ("r",)),
    )
    assert network.security.routers == ("gate",)


def test_keys_are_beside_the_file_that_names_them() -> None:
    Path("parts").mkdir()
    roles = "roles: {controllers: [controller]}"
    Path("parts/named.yaml").write_text(f"version: 1\nnetwork: {{security: {{keys: secrets, {roles}}}}}")
    Path("parts/silent.yaml").write_text(f"version: 1\nnetwork: {{security: {{{roles}}}}}")
    robots = f"network: {{lease_s: 1}}\nrobots: {{r: {{{PLUGINS}}}}}"

    for part, folder in (("named", "parts/secrets"), ("silent", "parts/keys")):
        network = load(f"include: [parts/{part}.yaml]\n{robots}").network
        assert network.security is not None
        assert (network.security.keys, network.lease_s) == (Path(folder), 1.0)


def test_counted_robots_have_counted_addresses() -> None:
    fleet = load(
        f"robots: {{'b{{n}}': {{count: 2, {PLUGINS}, address: 'tcp/10.0.0.{{n}}:500{{n}}', "
        "listen: 'tcp/0.0.0.0:500{n}'}}"
    )

    assert [(robot.address, robot.listen) for robot in fleet.robots.values()] == [
        ("tcp/10.0.0.1:5001", "tcp/0.0.0.0:5001"),
        ("tcp/10.0.0.2:5002", "tcp/0.0.0.0:5002"),
    ]


def test_a_fleet_in_memory_may_have_a_network_too() -> None:
    content = {"version": 1, "robots": {"r": {"address": "tcp/r.local:50000", "plugins": {"s": {}}}}}

    assert EALConfigManager.of(content).fleet.robots["r"].address == "tcp/r.local:50000"


@pytest.mark.parametrize(
    ("text", "host"),
    [
        ("tcp/192.168.1.11:50000", "192.168.1.11"),
        ("tls/robot-1.local:50000", "robot-1.local"),
        ("quic/[2001:db8::1]:50000", "2001:db8::1"),
        ("udp/localhost:50000", "localhost"),
    ],
)
def test_endpoints(text: str, host: str) -> None:
    endpoint = parse_endpoint(text)

    assert (endpoint.protocol, endpoint.host, endpoint.port) == (text.split("/")[0], host, 50000)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("10.0.0.1:50000", "'10.0.0.1:50000' lacks the protocol; write tcp/10.0.0.1:50000"),
        ("tpc/10.0.0.1:50000", "unknown protocol 'tpc' in 'tpc/10.0.0.1:50000'; did you mean 'tcp'?"),
        ("ws/10.0.0.1:50000", "unknown protocol 'ws' in 'ws/10.0.0.1:50000'; known: quic, tcp, tls, udp"),
        ("tcp/10.0.0.1", "'tcp/10.0.0.1' lacks the port; write it as tcp/192.168.1.11:50000"),
        ("tcp/[::1]", "'tcp/[::1]' lacks the port; write it as tcp/192.168.1.11:50000"),
        (
            "tcp/fe80::1:50000",
            "'tcp/fe80::1:50000' has an IPv6 address without brackets; write it as tcp/[fe80::1]:50000",
        ),
        ("tcp/h:0", "the port in 'tcp/h:0' must be a whole number from 1 to 65535, not '0'"),
        ("tcp/h:65536", "the port in 'tcp/h:65536' must be a whole number from 1 to 65535, not '65536'"),
        ("tcp/h:http", "the port in 'tcp/h:http' must be a whole number from 1 to 65535, not 'http'"),
        (
            "tcp/10.0.0.256:5",
            (
                "'10.0.0.256' in 'tcp/10.0.0.256:5' is neither a host name nor an IP address; "
                "write it as tcp/192.168.1.11:50000"
            ),
        ),
        (
            "tcp/a b:5",
            "'a b' in 'tcp/a b:5' is neither a host name nor an IP address; write it as tcp/192.168.1.11:50000",
        ),
        (
            "tcp/[10.0.0.1]:5",
            (
                "'[10.0.0.1]' in 'tcp/[10.0.0.1]:5': brackets are for IPv6 addresses alone; "
                "write it as tcp/192.168.1.11:50000"
            ),
        ),
    ],
)
def test_what_is_no_endpoint(text: str, expected: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(expected)}$"):
        parse_endpoint(text)


OPEN = f"robots: {{r: {{{PLUGINS}}}}}"
TLS = "network: {security: {roles: {controllers: [controller]}}}\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f"netwrok: {{}}\n{OPEN}", ["2:1: netwrok: unknown key 'netwrok'; did you mean 'network'?"]),
        (
            f"network: {{leas_s: 2}}\n{OPEN}",
            ["2:11: network.leas_s: unknown key 'leas_s'; did you mean 'lease_s'?"],
        ),
        (f"network: {{lease_s: 0.1}}\n{OPEN}", ["2:20: network.lease_s: must be at least 0.3, not 0.1"]),
        (f"network: {{dead_man_s: 90}}\n{OPEN}", ["2:23: network.dead_man_s: must be at most 60, not 90"]),
        (
            f"network: {{routers: ['tcp/a:1', 'tcl/b:1']}}\n{OPEN}",
            ["2:32: network.routers[1]: unknown protocol 'tcl' in 'tcl/b:1'; did you mean 'tls'?"],
        ),
        (
            f"network: {{routers: ['tcp/a:1', 'tcp/a:1']}}\n{OPEN}",
            ["2:32: network.routers[1]: 'tcp/a:1' is named already"],
        ),
        (
            f"robots: {{r: {{{PLUGINS}, address: 'tpc/a:1'}}}}",
            ["2:41: robots.r.address: unknown protocol 'tpc' in 'tpc/a:1'; did you mean 'tcp'?"],
        ),
        (
            f"robots: {{r: {{{PLUGINS}, address: 'tcp/0.0.0.0:1'}}}}",
            [
                (
                    "2:41: robots.r.address: 0.0.0.0 is where a robot may listen, not where it is reached; "
                    "put it under 'listen'"
                )
            ],
        ),
        (
            f"robots: {{r: {{{PLUGINS}, listen: 'tcp/0.0.0.0:1'}}}}",
            [
                (
                    "2:32: robots.r.listen: a robot without an address lives in the controller's process; "
                    "give it one under 'address'"
                )
            ],
        ),
        (
            f"robots: {{a: {{{PLUGINS}, address: 'tcp/h:1'}}, b: {{{PLUGINS}, address: 'tcp/h:1'}}}}",
            ["2:84: robots.b.address: 'tcp/h:1' is the address of 'a' already"],
        ),
        (
            f"{TLS}robots: {{'b{{n}}': {{range: [7, 8], {PLUGINS}, address: 'tls/h:1'}}}}",
            ["3:61: robots.b{n}.address: 'tls/h:1' is the address of 'b7' already"],
        ),
        (
            (
                f"robots: {{'b{{n}}': {{range: [7, 8], {PLUGINS}, address: 'tcp/h:1'}}, "
                f"c: {{{PLUGINS}, address: 'tcp/h:1'}}}}"
            ),
            ["2:104: robots.c.address: 'tcp/h:1' is the address of 'b7' already"],
        ),
        (
            f"robots: {{'b{{n}}': {{range: [255, 256], {PLUGINS}, address: 'tcp/10.0.0.{{n}}:1'}}}}",
            [
                (
                    "2:65: robots.b{n}.address: '10.0.0.256' in 'tcp/10.0.0.256:1' is neither a host name nor an IP "
                    "address; write it as tcp/192.168.1.11:50000"
                )
            ],
        ),
        (
            f"robots: {{r: {{{PLUGINS}, address: router}}}}",
            ["2:41: robots.r.address: the network has no routers; name them under network.routers"],
        ),
        (
            f"network: {{routers: ['tcp/a:1']}}\nrobots: {{r: {{{PLUGINS}, address: router, listen: 'tcp/a:2'}}}}",
            [
                (
                    "3:49: robots.r.listen: a robot behind a router listens nowhere: leave this out, "
                    "or give it an address of its own"
                )
            ],
        ),
        (
            f"robots: {{r: {{{PLUGINS}, address: 'tls/h:1'}}}}",
            [
                (
                    "2:41: robots.r.address: tls needs keys: make them with `eal keys init`, "
                    "and name them under network.security"
                )
            ],
        ),
        (
            f"{TLS}robots: {{r: {{{PLUGINS}, address: 'tls/h:1', listen: 'udp/h:1'}}}}",
            [("3:60: robots.r.listen: udp carries no certificates, which network.security asks for; use tls")],
        ),
        (
            f"network: {{security: {{}}}}\n{OPEN}",
            [
                (
                    "2:21: network.security.controller: 'controller' has no role; "
                    "name it under roles.controllers or roles.observers"
                )
            ],
        ),
        (
            f"network: {{security: {{controller: dsek, roles: {{controllers: [desk]}}}}}}\n{OPEN}",
            [
                (
                    "2:34: network.security.controller: 'dsek' has no role; "
                    "name it under roles.controllers or roles.observers"
                )
            ],
        ),
        (
            f"network: {{security: {{roles: {{controllers: [controller], observers: [r]}}}}}}\n{OPEN}",
            ["2:69: network.security.roles.observers[0]: 'r' is a robot, whose certificate has no other role"],
        ),
        (
            (
                "network: {security: {roles: {controllers: [{name: controller, robots: [scuot]}]}}}\n"
                f"robots: {{scout: {{{PLUGINS}}}}}"
            ),
            [("2:72: network.security.roles.controllers[0].robots[0]: unknown robot 'scuot'; did you mean 'scout'?")],
        ),
        (
            f"network: {{security: {{roles: {{controllers: [{{nmae: x}}, controller]}}}}}}\n{OPEN}",
            [
                (
                    "2:44: network.security.roles.controllers[0]: must be text, not a mapping; put it in quotes if it "
                    "is meant as text"
                ),
                "2:44: network.security.roles.controllers[0].name: is missing",
                "2:45: network.security.roles.controllers[0].nmae: unknown key 'nmae'; did you mean 'name'?",
            ],
        ),
    ],
)
def test_what_is_wrong_with_a_network(text: str, expected: list[str]) -> None:
    assert problems(text) == [f"f.yaml:{line}" for line in expected]


def test_roles_are_not_checked_against_robots_of_a_file_that_is_missing() -> None:
    found = problems(f"include: [robots.yaml]\n{TLS.replace('controller]', '{name: controller, robots: [far]}]')}")

    assert found == ["f.yaml:2:11: include[0]: no such file: robots.yaml; known: f.yaml"]
