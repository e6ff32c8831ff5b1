"""`eal discover`, where multicast works on this machine."""

from __future__ import annotations

import json
from typing import Any

import pytest

from eal_actors.facade.service import RobotService
from eal_actors.managers.config import EALConfigManager
from eal_actors.wire.rpc.client.discovery import discover
from tests.net.links import free_port


def service(name: str, *, discovery: bool) -> RobotService:
    port = free_port()
    robot = {"address": f"tcp/127.0.0.1:{port}", "listen": f"tcp/0.0.0.0:{port}", "plugins": {"sample": {}}}
    content = {"version": 1, "name": name, "network": {"discovery": discovery}, "robots": {"r1": robot}}
    return RobotService(EALConfigManager.of(content).fleet, "r1")


def test_robots_that_allow_it_are_found_and_no_others(eal: Any) -> None:
    with service("open", discovery=True), service("shy", discovery=False):
        if not any(found.fleet == "open" for found in discover(1.0).robots):
            pytest.skip("multicast does not come back to this machine")
        result = eal("discover", "--timeout", 1, "--json")
        assert result.exit_code == 0
        found = [entry for entry in json.loads(result.stdout)["robots"] if entry["fleet"] in ("open", "shy")]
        assert [(entry["fleet"], entry["robot"]) for entry in found] == [("open", "r1")]
        assert found[0]["endpoint"].startswith("tcp/")
        assert found[0]["endpoint"] in eal("discover", "--timeout", 1).stdout


def test_what_to_do_is_told_where_nothing_is_found(eal: Any) -> None:
    result = eal("discover", "--timeout", 0.1)
    if result.exit_code == 0:
        pytest.skip("there are robots on this network")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert "`discovery: true`" in result.stderr
