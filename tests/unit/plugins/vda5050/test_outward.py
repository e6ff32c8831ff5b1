"""`eal bridge vda5050`: simulated robots as AGVs of a master that is made with vda5050-sdk."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from vda5050 import OrderBuilder

from eal_actors import Fleet
from eal_actors.managers.plugins import EALPluginManager
from tests.unit.plugins.mqtt.rig import Broker, Device
from tests.unit.plugins.ros2.rig import wait_for
from tests.unit.plugins.vda5050.rig import Judge, SdkMaster

TARGET = "EAL/roomba-1"


@contextmanager
def bridged(broker: Broker, folder: Path) -> Iterator[Fleet]:
    """Serve two simulated robots as AGVs."""
    robots = {
        "roomba-1": {"plugins": {"sim": {"model": "roomba", "start": {"x_m": 1.0, "y_m": 0.5}}}},
        "evbot3-1": {"plugins": {"sim": {"model": "evbot3"}}},
    }
    file = folder / "fleet.yaml"
    file.write_text(json.dumps({"version": 1, "name": "two", "clock": {"rate": 4}, "robots": robots}))
    with Fleet.load(file) as fleet:
        bridge, settings = EALPluginManager().bridge("vda5050", {"broker": broker.url, "state_period_s": 0.2})
        with bridge.open_bridge(fleet, settings) as line:
            assert line.startswith("2 AGVs at ")
            yield fleet


def order(name: str, *places: tuple[float, ...], released: int = 99, **more: Any) -> Any:
    builder = OrderBuilder(order_id=name, manufacturer="EAL", serial_number="roomba-1", **more)
    for number, (x, y, *theta) in enumerate(places):
        is_released = number < released
        builder.add_node(
            f"n{number}", x=x, y=y, theta=theta[0] if theta else None, map_id="map", released=is_released,
            allowed_deviation_xy=0.3,
        )  # fmt: skip
        if number + 1 < len(places):
            builder.add_edge(f"n{number}", f"n{number + 1}", released=number + 1 < released, max_speed=0.3)
    return builder.build()


def test_a_master_drives_a_robot_by_orders_updates_and_actions(broker: Broker, tmp_path: Path) -> None:
    """The true path is the simulation's; every message fits the published schemas."""
    with Judge(broker) as judge, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        truth = fleet["roomba-1"]["TruePose"]

        def place() -> list[float]:
            return [float(number) for number in truth.get_value().get().value]

        def state() -> Any:
            return [one for one in master.states if one.serial_number == "roomba-1"][-1]

        def is_done(name: str) -> bool:
            return state().order_id == name and not state().node_states and not state().driving

        wait_for(lambda: any(one.serial_number == "roomba-1" for one in master.states), "no state")
        wait_for(lambda: len(master.factsheets) == 2, "no factsheets")
        wait_for(lambda: state().agv_position is not None, "no position")
        assert "ONLINE" in master.connections

        def dispatch(wanted: Any) -> None:
            accepted = master.run(master.client.dispatch(wanted, TARGET))
            assert accepted.accepted, accepted

        first = order("A", (1.0, 0.5), (1.3, 0.5), (1.3, 0.8, math.pi / 2), released=2)
        dispatch(first)
        wait_for(lambda: state().last_node_id == "n1" and state().new_base_request, "the base is not driven")
        assert place()[:2] == pytest.approx([1.3, 0.5], abs=0.05)
        assert [one.node_id for one in state().node_states] == ["n2"]
        update = order("A", (1.3, 0.5), (1.3, 0.8, math.pi / 2), order_update_id=1, start_sequence_id=2)
        update.nodes[0].node_id, update.nodes[1].node_id = "n1", "n2"
        update.edges[0].start_node_id, update.edges[0].end_node_id = "n1", "n2"
        dispatch(update)
        wait_for(lambda: is_done("A") and state().last_node_id == "n2", "the update is not driven")
        assert place() == pytest.approx([1.3, 0.8, math.pi / 2], abs=0.06)

        dispatch(order("B", (1.3, 0.8), (3.0, 0.8)))
        wait_for(lambda: state().order_id == "B" and state().driving and place()[0] > 1.35, "it does not drive")
        master.run(master.client.pause(TARGET))
        wait_for(lambda: state().paused and fleet["roomba-1"]["Base"].get_status().get() == 0, "it does not pause")
        paused_m = place()[0]
        master.run(master.client.resume(TARGET))
        wait_for(lambda: place()[0] > paused_m + 0.02, "it does not go on")
        master.run(master.client.cancel_order(TARGET))
        wait_for(lambda: is_done("B") and fleet["roomba-1"]["Base"].get_status().get() == 0, "it is not cancelled")
        assert place()[0] < 2.9
        wait_for(lambda: bool(master.poses), "no visualization")
        assert state().safety_state.e_stop.value == "NONE"
        fleet["roomba-1"].stop("a person is in the way").get()
        wait_for(lambda: state().safety_state.e_stop.value == "REMOTE", "the emergency stop is not reported")
    assert {"state", "connection", "order", "instantActions", "visualization", "factsheet"} <= set(judge.counts)


@pytest.mark.slow
def test_wrong_orders_are_refused_by_name_and_move_nothing(broker: Broker, tmp_path: Path) -> None:
    with Device(broker) as intruder, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        truth = fleet["roomba-1"]["TruePose"]
        wait_for(lambda: any(one.agv_position is not None for one in master.states), "no position")
        begin = list(truth.get_value().get().value)
        good = order("C", (1.0, 0.5), (1.3, 0.5)).to_wire()
        node, edge = good["nodes"][1], good["edges"][0]

        def changed(**fields: Any) -> bytes:
            return json.dumps(good | fields).encode()

        for payload, words in (
            (b"{", "no order of VDA 5050"),
            (b"x" * 2_000_000, "longer than"),
            (changed(version="3.0.0"), "speaks VDA 5050 3.0.0"),
            (changed(edges=[]), "2 nodes and 0 edges"),
            (changed(nodes=[good["nodes"][0], node | {"sequenceId": 7}]), "sequenceId 7, not 2"),
            (changed(edges=[edge | {"endNodeId": "elsewhere"}]), "does not join"),
            (changed(nodes=[good["nodes"][0] | {"released": False}, node]), "must come first"),
            (json.dumps(good).replace('"map"', '"moon"').encode(), "is on map moon"),
            (json.dumps(good).replace('"x": 1.3', '"x": NaN').encode(), "finite"),
            (json.dumps(good).replace('"x": 1.0', '"x": 9.0').encode(), "m away"),
        ):
            intruder.say("uagv/v2/EAL/roomba-1/order", payload)
            wait_for(
                lambda words=words: (
                    any(words in (one.error_description or "") for one in master.states[-1].errors)  # type: ignore[misc]
                    or any(
                        words in (one.error_description or "") for state in master.states[-4:] for one in state.errors
                    )
                ),
                words,
            )
        for _ in range(500):
            intruder.say("uagv/v2/EAL/roomba-1/order", b"{", qos=0)
        assert list(truth.get_value().get().value) == pytest.approx(begin)
        master.run(master.client.dispatch(order("D", (1.0, 0.5), (1.2, 0.5)), TARGET))
        wait_for(lambda: truth.get_value().get().value[0] > 1.15, "it does not drive after them")
