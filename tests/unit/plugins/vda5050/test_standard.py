"""Rules of VDA 5050 about repeated and old orders, pauses and places, by messages that are written by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.unit.plugins.mqtt.rig import Broker, Device
from tests.unit.plugins.ros2.rig import wait_for
from tests.unit.plugins.vda5050.rig import SdkMaster
from tests.unit.plugins.vda5050.test_bad_input import HEAD, TOPIC, instant, placed, said, statuses
from tests.unit.plugins.vda5050.test_outward import TARGET, bridged, order

pytestmark = pytest.mark.slow

FORWARD = {"resource": "Base", "command": "f1"}


def errors(master: SdkMaster) -> list[str]:
    return [one.error_type for one in master.state("roomba-1").errors]


def act(device: Device, action: Mapping[str, Any]) -> None:
    device.say(TOPIC + "instantActions", json.dumps(HEAD | {"actions": [action]}))


def test_a_repeated_order_and_an_update_end_no_fatal_error(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as device, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        bad = order("A", (1.0, 0.5), (1.3, 0.5, 0.0)).to_wire()
        bad["edges"][0]["maxSpeed"] = 1e-6  # the robot cannot drive at it
        device.say(TOPIC + "order", json.dumps(bad))
        wait_for(lambda: "drivingError" in errors(master), "no error")
        update = order("A", (1.3, 0.5), (1.6, 0.5), order_update_id=1, start_sequence_id=2).to_wire()
        update["nodes"][0]["nodeId"] = update["edges"][0]["startNodeId"] = "n1"
        update["nodes"][1]["nodeId"] = update["edges"][0]["endNodeId"] = "n2"
        for message in (bad, update):
            before = len(master.states)
            device.say(TOPIC + "order", json.dumps(message))
            act(device, instant("stateRequest", f"seen-{message['orderUpdateId']}"))
            name = f"seen-{message['orderUpdateId']}"
            wait_for(lambda name=name: name in statuses(master), "no state")  # type: ignore[misc]
            seen = [state for state in master.states[before:] if state.serial_number == "roomba-1"]
            assert all(state.errors for state in seen)
        assert master.state("roomba-1").order_update_id == 1
        act(device, instant("cancelOrder", "cancel"))
        wait_for(lambda: not errors(master), "the error does not end")


def test_a_retained_order_moves_nothing(broker: Broker, tmp_path: Path) -> None:
    """The broker sends it at each new connection, however old it is."""
    with Device(broker) as device, SdkMaster(broker) as master:
        device.say(TOPIC + "order", json.dumps(order("A", (1.0, 0.5), (1.3, 0.5)).to_wire()), retain=True)
        with bridged(broker, tmp_path) as fleet:
            begin = placed(master, fleet)
            wait_for(lambda: said(master, "retained"), "it does not say so")
            assert not master.state("roomba-1").order_id
            assert fleet["roomba-1"]["TruePose"].get_value().get().value == pytest.approx(begin)
        device.say(TOPIC + "order", b"", retain=True)


def test_a_pause_stops_a_motion_that_is_an_action(broker: Broker, tmp_path: Path) -> None:
    with SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        base = fleet["roomba-1"]["Base"]
        master.dispatch(order("A", (1.0, 0.5), actions=[FORWARD, FORWARD]))
        wait_for(lambda: master.state("roomba-1").driving and base.get_status().get() == 1, "it does not drive")
        master.run(master.client.pause(TARGET))
        wait_for(lambda: statuses(master)["A-0"] == "FAILED", "the motion goes on")
        wait_for(lambda: base.get_status().get() == 0, "it does not stand")
        assert statuses(master)["A-1"] == "WAITING"


def test_an_order_is_refused_while_actions_of_the_last_one_run(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as device, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        master.dispatch(order("A", (1.0, 0.5), actions=[FORWARD]))
        wait_for(lambda: "RUNNING" in statuses(master), "the action does not run")
        device.say(TOPIC + "order", json.dumps(order("B", (1.0, 0.5), (1.3, 0.5)).to_wire()))
        wait_for(lambda: said(master, "order A is not over"), "it is accepted")
        wait_for(lambda: statuses(master)["A-0"] == "FINISHED", "the action does not end")


def test_a_fatal_error_without_anything_left_can_be_cancelled(broker: Broker, tmp_path: Path) -> None:
    with SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        master.dispatch(order("A", (1.0, 0.5), actions=[{"resource": "Horn", "command": "blow"}]))
        wait_for(lambda: "actionError" in errors(master), "no error")
        master.run(master.client.cancel_order(TARGET))
        wait_for(lambda: not errors(master), "the error does not end")


def test_headings_are_rad(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as device, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        wrong = json.dumps(order("A", (1.0, 0.5), (1.3, 0.5, 1.5)).to_wire()).replace('"theta": 1.5', '"theta": 90')
        device.say(TOPIC + "order", wrong)
        wait_for(lambda: said(master, "theta of 90"), "degrees are accepted")
        act(device, instant("initPosition", "a", x=1, y=0.5, theta=90, mapId="map"))
        wait_for(lambda: statuses(master).get("a") == "FAILED", "degrees are accepted")
        assert not master.state("roomba-1").order_id


def test_a_new_position_has_its_own_last_node(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as device, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        master.dispatch(order("A", (1.0, 0.5), (1.2, 0.5), (9.0, 0.5), released=2))
        wait_for(lambda: master.state("roomba-1").last_node_id == "n1", "it does not drive")
        place = {"x": 2.0, "y": 1.0, "theta": math.pi / 2, "mapId": "map"}
        act(device, instant("initPosition", "a", **place, lastNodeId="dock"))
        wait_for(lambda: said(master, "order A is not over"), "it is taken out of its order")
        master.run(master.client.cancel_order(TARGET))
        act(device, instant("initPosition", "b", **place, lastNodeId="dock"))
        wait_for(lambda: master.state("roomba-1").last_node_id == "dock", "the node is not taken over")
        device.say(TOPIC + "order", json.dumps(order("B", (1.2, 0.5), (1.0, 0.5)).to_wire()).replace('"n0"', '"n1"'))
        wait_for(lambda: said(master, "m away"), "it believes that it is still at the former node")
