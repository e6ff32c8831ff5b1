"""The plugins pass the conformance checks of every plugin: an AGV of vda5050-sdk, and topics at a real mosquitto."""

from __future__ import annotations

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.testing.conformance import CHECKS, Bench, Check, run_check, settings_of
from tests.unit.plugins.mqtt.rig import Broker, Device
from tests.unit.plugins.vda5050.rig import SdkAgv

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_an_agv_conforms(broker: Broker, check: Check) -> None:
    settings = {"broker": broker.url, "manufacturer": "ACME", "serial_number": "check"}
    with SdkAgv(broker, "check"):
        result = run_check(check, Bench(bundled_path("plugins/vda5050"), settings_of(settings), timeout_s=30.0))
    assert result.outcome != "failed", "\n".join([check.description, *result.problems])


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_topics_conform(broker: Broker, check: Check) -> None:
    topics = {"Say": {"topic": "check/say", "writable": True, "halt": "stop"}, "Hear": {"topic": "check/say"}}
    settings = settings_of({"broker": broker.url, "topics": topics})
    with Device(broker) as device:
        device.say("check/say", "standing", retain=True)
        result = run_check(check, Bench(bundled_path("plugins/mqtt"), settings, timeout_s=30.0))
    assert result.outcome != "failed", "\n".join([check.description, *result.problems])
