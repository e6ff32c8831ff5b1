"""Orders, actions and states at the edge of the standard, and floods: a clear state, and the others go on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from tests.log_lines import log_lines
from tests.unit.plugins.mqtt.rig import Broker, Device, mqtt_fleet, until_ready, why
from tests.unit.plugins.ros2.rig import wait_for
from tests.unit.plugins.vda5050.rig import SdkAgv, SdkMaster
from tests.unit.plugins.vda5050.test_inward import CALL_S, agv_settings, ready
from tests.unit.plugins.vda5050.test_outward import TARGET, bridged, order

pytestmark = pytest.mark.slow

HEAD = {
    "headerId": 1,
    "timestamp": "2026-01-01T00:00:00.000Z",
    "version": "2.1.0",
    "manufacturer": "EAL",
    "serialNumber": "roomba-1",
}
TOPIC = "uagv/v2/EAL/roomba-1/"


def instant(kind: str, name: str, **parameters: Any) -> dict[str, Any]:
    pairs = [{"key": key, "value": value} for key, value in parameters.items()]
    return {"actionType": kind, "actionId": name, "blockingType": "NONE", "actionParameters": pairs}


def said(master: SdkMaster, words: str) -> bool:
    """Return whether a recent state of the first robot has an error or result with these words."""
    recent = [state for state in master.states[-20:] if state.serial_number == "roomba-1"]
    texts = [one.error_description for state in recent for one in state.errors]
    texts += [one.result_description for state in recent for one in state.action_states]
    return any(words in (text or "") for text in texts)


def placed(master: SdkMaster, fleet: Fleet) -> list[float]:
    """Wait until both robots tell where they are; return the true pose of the first."""
    wait_for(lambda: len({one.serial_number for one in master.states if one.agv_position}) == 2, "no position")
    return list(fleet["roomba-1"]["TruePose"].get_value().get().value)


def test_wrong_instant_actions_are_refused_and_halt_nothing(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as intruder, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        begin = placed(master, fleet)
        for number, (action, words) in enumerate(
            (
                (instant("initPosition", "a", x=10**400, y=0, theta=0, mapId="map"), "too large"),
                (instant("initPosition", "b", x=1e308, y=0, theta=0, mapId="map"), "1,000 km"),
                (instant("initPosition", "c", x="nan", y=0, theta=0, mapId="map"), "finite"),
                (instant("initPosition", "d", x=0), "'y'"),
                (instant("initPosition", "e", x=[0], y={}, theta=None), "must be a string or a real number"),
                (instant("explode", "f"), "unknown action"),
                (instant("x" * 1001, "g"), "at most 1000 characters"),
            )
        ):
            intruder.say(TOPIC + "instantActions", json.dumps(HEAD | {"headerId": number, "actions": [action]}))
            wait_for(lambda words=words: said(master, words), words)  # type: ignore[misc]
        many = [instant("explode", f"many-{number}") for number in range(8000)]
        intruder.say(TOPIC + "instantActions", json.dumps(HEAD | {"actions": many}))
        wait_for(lambda: said(master, "at most 100 actions"), "a thousand actions are taken")
        assert fleet["roomba-1"]["TruePose"].get_value().get().value == pytest.approx(begin)
        master.dispatch(order("D", (1.0, 0.5), (1.2, 0.5)))
        wait_for(lambda: fleet["roomba-1"]["TruePose"].get_value().get().value[0] > 1.15, "it does not drive then")


def test_a_place_that_the_robot_refuses_is_reported(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as intruder, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        place = {"x": 2.0, "y": 0.5, "theta": 0.0, "mapId": "map"}
        for name, status in (("good", "FINISHED"), ("refused", "FAILED")):
            action = instant("initPosition", name, **place)
            intruder.say(TOPIC + "instantActions", json.dumps(HEAD | {"actions": [action]}))
            wait_for(lambda expected=(name, status): expected in statuses(master).items(), name)  # type: ignore[misc]
            fleet["roomba-1"].stop("a person is in the way").get()
        assert said(master, "a person is in the way")


def test_a_robot_is_never_faster_than_its_order_allows(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as intruder, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        begin = placed(master, fleet)
        good = order("S", (1.0, 0.5), (1.5, 0.5)).to_wire()
        for speed_m_s, words in ((0.0, "maxSpeed of 0"), (-1.0, "maxSpeed of -1"), (1e-6, "speed_m_s")):
            edges = [good["edges"][0] | {"maxSpeed": speed_m_s}]
            intruder.say(TOPIC + "order", json.dumps(good | {"orderId": f"S{speed_m_s}", "edges": edges}))
            wait_for(lambda words=words: said(master, words), words)  # type: ignore[misc]
        assert fleet["roomba-1"]["TruePose"].get_value().get().value == pytest.approx(begin, abs=1e-3)


def test_the_actions_of_a_cancelled_order_are_over(broker: Broker, tmp_path: Path) -> None:
    with SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        placed(master, fleet)
        blow = {"resource": "Horn", "command": "blow"}
        master.dispatch(order("W", (1.0, 0.5), (9.0, 0.5), actions=[blow]))
        wait_for(lambda: "WAITING" in statuses(master), "its action does not wait")
        master.run(master.client.cancel_order(TARGET))
        wait_for(lambda: statuses(master)["W-0"] == "FAILED", f"its action is not over: {statuses(master)}")


def statuses(master: SdkMaster) -> dict[str, str]:
    state = master.state("roomba-1")
    found = {one.action_id: one.action_status.value for one in state.action_states}
    return found | {status: name for name, status in found.items()}


def test_a_sustained_flood_of_orders_delays_no_other_vehicle(broker: Broker, tmp_path: Path) -> None:
    """10 kHz of broken and of refused orders, as far as this machine can; the log stays short."""
    with (
        log_lines() as lines,
        Device(broker) as intruder,
        SdkMaster(broker) as master,
        bridged(broker, tmp_path) as fleet,
    ):
        placed(master, fleet)
        wrong = (b"{", b"x" * 2000, json.dumps(order("F", (90.0, 0.5), (1.5, 0.5)).to_wire()).encode())
        start = fleet["evbot3-1"]["Pose"].get_value().get().value
        goal = [float(start[0]), float(start[1])], [float(start[0]) + 0.2, float(start[1])]
        other = order("G", *map(tuple, goal)).model_copy(update={"serial_number": "evbot3-1"})
        for turn in range(300):
            for number in range(100):
                intruder.say(TOPIC + "order", wrong[number % 3], qos=0)
            REAL_TIME.sleep(0.01)
            if turn == 50:
                master.dispatch(other)
        truth = fleet["evbot3-1"]["TruePose"]
        wait_for(lambda: truth.get_value().get().value[0] > start[0] + 0.15, "the other does not drive")
        wait_for(lambda: said(master, "m away") and said(master, "no order of VDA 5050"), "they are not refused")
    assert 1 <= lines.getvalue().count("reports an error") < 50


def test_absurd_states_of_an_agv_are_named_and_move_no_estimate(broker: Broker, tmp_path: Path) -> None:
    topic = "uagv/v2/ACME/odd/"
    with (
        SdkAgv(broker, "odd") as agv,
        Device(broker) as intruder,
        mqtt_fleet(tmp_path, "vda5050", one=agv_settings(broker, "odd")) as fleet,
    ):
        ready(fleet, "one")
        good = json.loads(fleet["one"]["State"].get_value().get().value)
        agv.call(lambda: setattr(agv.client.publisher, "publish", _nothing))
        far = good["agvPosition"] | {"x": 1e300}
        for fields, words in (
            ({"agvPosition": far}, "agvPosition.x: "),
            ({"agvPosition": good["agvPosition"] | {"theta": 1e999}}, "agvPosition.theta"),
            ({"lastNodeId": "n" * 2000}, "lastNodeId: "),
            ({"batteryState": {"batteryCharge": "full", "charging": False}}, "batteryCharge: "),
        ):
            intruder.say(topic + "state", json.dumps(good | fields).replace("Infinity", "1e999"))
            assert "Traceback" not in why(fleet, "one", "Base", words)
            intruder.say(topic + "state", json.dumps(good))
            until_ready(fleet, "one", "Base")
        assert fleet["one"]["Pose"].get_value().get().value == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
        long = [{"errorType": "motor", "errorLevel": "FATAL", "errorDescription": "hot " * 200_000}]
        driving = fleet["one"]["Base"].send_cmd("goto", [5.0, 0.0], timeout_s=CALL_S)
        wait_for(lambda: agv.has_order, "it has no order")
        intruder.say(topic + "state", json.dumps(good | {"errors": long}))
        error = driving.exception(timeout=CALL_S)
        assert "the AGV reports motor (FATAL): hot hot" in str(error)
        assert len(str(error)) < 1000


async def _nothing() -> None:
    """Publish no state."""
