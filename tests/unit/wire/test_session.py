"""The generated configurations; tests over real links prove that zenoh accepts them."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zenoh

from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.wire.format import keys
from eal_actors.wire.security.access import controller_access, robot_access, router_access
from eal_actors.wire.session import controller_config, endpoints_of, robot_config, router_config
from tests.net.links import fleet_of

DIRECT, ROUTED = "tcp/10.0.0.1:50000", "router"
ROUTERS = ["tcp/10.0.0.8:7447", "tcp/10.0.0.9:7447"]


def mixed(**network: object) -> FleetConfig:
    return fleet_of({"routers": ROUTERS, **network}, {"direct": DIRECT, "routed": ROUTED, "here": None})


def all_configs(fleet: FleetConfig) -> list[dict[str, Any]]:
    return [
        robot_config(fleet, "direct"),
        robot_config(fleet, "routed"),
        controller_config(fleet),
        controller_config(fleet, ["routed"]),
        router_config(["tcp/0.0.0.0:7447"], fleet=fleet),
    ]


def test_zenoh_takes_them_all_and_every_guard_rail_is_in_each() -> None:
    for number, config in enumerate(all_configs(mixed(lease_s=0.5))):
        is_robot = number < 2
        taken = json.loads(str(zenoh.Config.from_json5(json.dumps(config))))
        transport = taken["transport"]
        assert transport["shared_memory"]["enabled"] is False
        assert transport["link"]["tx"]["lease"] == 500
        assert transport["link"]["tx"]["queue"]["congestion_control"]["block"]["wait_before_close"] == 500_000
        assert transport["link"]["protocols"] == ["tcp"]
        assert transport["unicast"]["compression"]["enabled"] is False
        assert transport["unicast"]["max_sessions"] == (256 if is_robot else 1000)
        assert transport["link"]["rx"]["max_message_size"] == (0 if is_robot else 66 * 1024**2)
        assert taken["scouting"]["multicast"]["enabled"] is False
        assert taken["scouting"]["gossip"]["enabled"] is False
        assert taken["connect"]["exit_on_failure"] is False
        assert config["connect"]["retry"] == {
            "period_init_ms": 20,
            "period_max_ms": 20,
            "period_increase_factor": 1,
        }


def test_absent_ends_are_dialled_at_a_constant_rate_with_tls_too() -> None:
    """A restarted robot is found within one period."""
    retry = router_config(["tcp/h:1"], ["tls/a:1"])["connect"]["retry"]
    assert retry == {"period_init_ms": 40, "period_max_ms": 40, "period_increase_factor": 1}
    many = router_config(["tcp/h:1"], [f"tls/a:{port}" for port in range(1, 101)])["connect"]["retry"]
    assert many["period_max_ms"] == 200


def test_discovery_lets_those_be_found_who_listen_but_connects_nobody() -> None:
    for config in all_configs(mixed(discovery=True)):
        listens = bool(config["listen"]["endpoints"])
        assert config["scouting"]["multicast"] == {"enabled": listens, "listen": listens, "autoconnect": []}
        assert config["scouting"]["gossip"] == {"enabled": False}


def test_compression_is_asked_for_at_every_end() -> None:
    for config in all_configs(mixed(compression=True)):
        assert config["transport"]["unicast"]["compression"] == {"enabled": True}


@pytest.mark.parametrize(
    ("config", "mode", "listen", "connect"),
    [
        (lambda fleet: robot_config(fleet, "direct"), "peer", [DIRECT], []),
        (lambda fleet: robot_config(fleet, "routed"), "client", [], ROUTERS),
        (lambda fleet: controller_config(fleet), "peer", [], [ROUTERS[0], DIRECT]),
        (lambda fleet: controller_config(fleet, ["direct", "here"]), "peer", [], [DIRECT]),
        (lambda fleet: controller_config(fleet, ["routed"]), "client", [], ROUTERS),
        (lambda fleet: controller_config(fleet, ["here"]), "peer", [], []),
    ],
)
def test_who_listens_and_who_dials_where(config: Any, mode: str, listen: list[str], connect: list[str]) -> None:
    made = config(mixed())

    assert (made["mode"], made["listen"]["endpoints"], made["connect"]["endpoints"]) == (mode, listen, connect)
    assert endpoints_of(made) == (*listen, *connect)


def test_a_robot_may_listen_elsewhere_than_at_its_address() -> None:
    fleet = fleet_of({}, {"r": "tcp/robot.local:50000"})
    fleet.robots["r"] = replace(fleet.robots["r"], listen="tcp/[::]:50000")

    assert robot_config(fleet, "r")["listen"]["endpoints"] == ["tcp/[::]:50000"]


def test_a_robot_without_an_address_has_no_configuration() -> None:
    with pytest.raises(ValueError, match="'here' has no address"):
        robot_config(mixed(), "here")


def test_large_fleets_have_room() -> None:
    fleet = fleet_of({}, {f"r{n}": f"tcp/10.0.{n // 200}.{n % 200 + 1}:50000" for n in range(700)})

    assert controller_config(fleet)["transport"]["unicast"]["max_sessions"] == 1400
    assert router_config(["tcp/h:1"], fleet=fleet)["transport"]["unicast"]["max_sessions"] == 1400


class TestSecurity:
    @pytest.fixture
    def fleet(self, tmp_path: Path) -> FleetConfig:
        make_authority(tmp_path / "keys", "f")
        for name in ("r1", "controller", "router"):
            make_certificate(tmp_path / "keys", name)
        roles = {
            "controllers": ["controller", {"name": "student", "robots": ["r1"], "resources": ["Wheels"]}],
            "observers": ["display"],
            "routers": ["router"],
        }
        robots = {"r1": "tls/10.0.0.1:50000", "r2": "quic/10.0.0.2:50000"}
        return fleet_of({"security": {"roles": roles}}, robots, tmp_path)

    def test_everybody_shows_the_own_certificate_and_asks_for_one(self, fleet: FleetConfig, tmp_path: Path) -> None:
        configs = {
            "r1": robot_config(fleet, "r1"),
            "controller": controller_config(fleet),
            "router": router_config(["tls/h:1"], fleet=fleet),
        }

        for name, config in configs.items():
            tls = config["transport"]["link"]["tls"]
            assert (tls["enable_mtls"], tls["verify_name_on_connect"]) == (True, True)
            assert tls["root_ca_certificate"] == str(tmp_path / "keys" / "ca.pem")
            assert {Path(tls[f"{way}_certificate"]).name for way in ("listen", "connect")} == {f"{name}.pem"}
            assert {Path(tls[f"{way}_private_key"]).name for way in ("listen", "connect")} == {f"{name}.key"}
            assert config["access_control"]["default_permission"] == "deny"
            zenoh.Config.from_json5(json.dumps(config))
        assert configs["controller"]["transport"]["link"]["protocols"] == ["quic", "tls"]

    def test_every_rule_has_a_name_of_its_own_and_is_used(self, fleet: FleetConfig) -> None:
        assert fleet.network.security is not None
        for access in (
            robot_access(fleet, fleet.network.security, "r1"),
            controller_access(fleet, fleet.network.security, ["r1", "r2"]),
            router_access(fleet, fleet.network.security),
        ):
            rules = [rule["id"] for rule in access["rules"]]
            assert len(rules) == len(set(rules))
            assert rules == [rule for policy in access["policies"] for rule in policy["rules"]]
            assert {rule["permission"] for rule in access["rules"]} == {"allow"}

    def test_who_is_known_where(self, fleet: FleetConfig) -> None:
        security = fleet.network.security
        assert security is not None

        def names(access: dict[str, Any]) -> set[str]:
            return {name for subject in access["subjects"] for name in subject["cert_common_names"]}

        everywhere = {"router", "controller", "display", keys.AUTHORITY_CALLER}
        assert names(robot_access(fleet, security, "r1")) == {*everywhere, "student"}
        assert names(robot_access(fleet, security, "r2")) == everywhere
        assert names(controller_access(fleet, security, ["r2"])) == {"router", "r2"}
        assert names(router_access(fleet, security)) == {*everywhere, "r1", "r2", "student"}


def test_the_network_is_imported_only_where_it_is_used() -> None:
    program = (
        "import sys, eal_actors, eal_actors.cli.app, eal_actors.wire.session, eal_actors.managers.keys.certificates\n"
        "print([name for name in ('zenoh', 'cryptography') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)

    assert done.stdout == "[]\n"
