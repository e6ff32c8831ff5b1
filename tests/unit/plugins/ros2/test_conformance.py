"""The plugin passes the conformance checks of every plugin, with a robot that is made with zenoh-ros2-sdk."""

from __future__ import annotations

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.testing.conformance import CHECKS, Bench, Check, run_check, settings_of
from tests.unit.plugins.ros2.rig import Ros2Peer, SdkRobot

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_it_conforms(peer: Ros2Peer, check: Check) -> None:
    settings = {
        "router": peer.endpoint,
        "namespace": "/turtle",
        "drive": {"max_speed_m_s": 1.0},
        "topics": {"Say": {"topic": "say", "type": "std_msgs/String", "writable": True}},
    }
    with SdkRobot(peer, "/turtle"):
        result = run_check(check, Bench(bundled_path("plugins/ros2"), settings_of(settings), timeout_s=30.0))
    assert result.outcome != "failed", "\n".join([check.description, *result.problems])
