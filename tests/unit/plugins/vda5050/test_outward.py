"""`eal bridge vda5050`: simulated robots as AGVs of a master that is made with vda5050-sdk."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from vda5050 import Action, ActionParameter, BlockingType, OrderBuilder

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.plugins import EALPluginManager
from tests.log_lines import log_lines
from tests.unit.plugins.mqtt.rig import Broker, Device, error_of
from tests.unit.plugins.ros2.rig import free_port, wait_for
from tests.unit.plugins.served_robot import served_robot
from tests.unit.plugins.vda5050.rig import Judge, SdkMaster

TARGET = "EAL/roomba-1"
PAIRS = (("Base", "l90"), ("Horn", "blow"), ("Base", "f50"))
"""Resources and commands of nodes."""


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


def order(
    name: str,
    *places: tuple[float, ...],
    released: int = 99,
    actions: Sequence[Mapping[str, str]] = (),
    **more: Any,
) -> Any:
    """Return an order whose last node has commands as actions."""
    builder = OrderBuilder(order_id=name, manufacturer="EAL", serial_number="roomba-1", **more)
    for number, (x, y, *theta) in enumerate(places):
        is_released = number < released
        builder.add_node(
            f"n{number}", x=x, y=y, theta=theta[0] if theta else None, map_id="map", released=is_released,
            allowed_deviation_xy=0.3,
            actions=[_command(f"{name}-{index}", one) for index, one in enumerate(actions)]
            if number + 1 == len(places) else None,
        )  # fmt: skip
        if number + 1 < len(places):
            builder.add_edge(f"n{number}", f"n{number + 1}", released=number + 1 < released, max_speed=0.3)
    return builder.build()


def _command(name: str, parameters: Mapping[str, str]) -> Action:
    pairs = [ActionParameter(key=key, value=value) for key, value in parameters.items()]
    return Action(action_type="command", action_id=name, blocking_type=BlockingType.HARD, action_parameters=pairs)


def test_a_master_drives_a_robot_by_orders_updates_and_actions(broker: Broker, tmp_path: Path) -> None:
    """The true path is the simulation's; every message fits the published schemas."""
    with Judge(broker) as judge, SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        truth = fleet["roomba-1"]["TruePose"]

        def place() -> list[float]:
            return [float(number) for number in truth.get_value().get().value]

        def state() -> Any:
            return master.state("roomba-1")

        def is_done(name: str) -> bool:
            return state().order_id == name and not state().node_states and not state().driving

        wait_for(lambda: state() is not None, "no state")
        wait_for(lambda: len(master.factsheets) == 2, "no factsheets")
        wait_for(lambda: state().agv_position is not None, "no position")
        assert "ONLINE" in master.connections

        first = order("A", (1.0, 0.5), (1.3, 0.5), (1.3, 0.8, math.pi / 2), released=2)
        master.dispatch(first)
        wait_for(lambda: state().last_node_id == "n1" and state().new_base_request, "the base is not driven")
        assert place()[:2] == pytest.approx([1.3, 0.5], abs=0.05)
        assert [one.node_id for one in state().node_states] == ["n2"]
        update = order("A", (1.3, 0.5), (1.3, 0.8, math.pi / 2), order_update_id=1, start_sequence_id=2)
        update.nodes[0].node_id, update.nodes[1].node_id = "n1", "n2"
        update.edges[0].start_node_id, update.edges[0].end_node_id = "n1", "n2"
        master.dispatch(update)
        wait_for(lambda: is_done("A") and state().last_node_id == "n2", "the update is not driven")
        assert place() == pytest.approx([1.3, 0.8, math.pi / 2], abs=0.06)

        master.dispatch(order("B", (1.3, 0.8), (3.0, 0.8)))
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


def test_a_node_has_commands_that_run_fail_and_are_cancelled(broker: Broker, tmp_path: Path) -> None:
    with Judge(broker), SdkMaster(broker) as master, bridged(broker, tmp_path) as fleet:
        base, truth = fleet["roomba-1"]["Base"], fleet["roomba-1"]["TruePose"]

        def state() -> Any:
            return master.state("roomba-1")

        def is_action(name: str, status: str) -> bool:
            return any((one.action_id, one.action_status.value) == (name, status) for one in state().action_states)

        wait_for(lambda: state() is not None and state().agv_position is not None, "no position")
        turn, missing, far = ({"resource": name, "command": cmd} for name, cmd in PAIRS)
        master.dispatch(order("A", (1.0, 0.5), (1.1, 0.5), actions=[turn, turn]))
        wait_for(lambda: is_action("A-1", "FINISHED"), "the commands of the node do not run")
        assert is_action("A-0", "FINISHED")
        assert list(truth.get_value().get().value) == pytest.approx([1.1, 0.5, math.pi], abs=0.06)

        master.dispatch(order("B", (1.1, 0.5), actions=[missing, turn]))
        wait_for(lambda: is_action("B-0", "FAILED"), "an unknown resource is no error")
        assert is_action("B-1", "WAITING")  # nothing goes on before the error is cleared
        assert [(one.error_type, one.error_level.value) for one in state().errors] == [("actionError", "FATAL")]
        assert "Horn" in state().errors[0].error_description
        master.run(master.client.cancel_order(TARGET))
        wait_for(
            lambda: is_action("B-1", "FAILED") and not state().errors and not state().driving,
            "the order is not cancelled",
        )

        master.dispatch(order("C", (1.1, 0.5), actions=[far]))
        wait_for(lambda: is_action("C-0", "RUNNING") and base.get_status().get() == 1, "the command does not run")
        master.run(master.client.cancel_order(TARGET))
        wait_for(lambda: is_action("C-0", "FAILED") and not state().driving, "the command is not cancelled")
        assert base.get_status().get() == 0
        master.dispatch(order("D", (float(truth.get_value().get().value[0]), 0.5), actions=[turn]))
        wait_for(lambda: is_action("D-0", "FINISHED"), "no order is taken afterwards")


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Path]:
    """The file of a simulated robot that this process serves."""
    with served_robot(tmp_path, "roomba-1") as file:
        yield file


@pytest.mark.slow
def test_an_order_for_a_robot_that_another_controller_holds_fails_and_says_so(broker: Broker, served: Path) -> None:
    with SdkMaster(broker) as master, Fleet.load(served) as holder, Fleet.load(served) as fleet:
        bridge, settings = EALPluginManager().bridge("vda5050", {"broker": broker.url, "state_period_s": 0.2})
        truth = holder["roomba-1"]["TruePose"]

        def state() -> Any:
            return master.state("roomba-1")

        with bridge.open_bridge(fleet, settings):
            wait_for(lambda: state() is not None and state().agv_position is not None, "no position")
            assert holder["roomba-1"]["Base"].send_cmd("l90").get() == 1  # it is the holder's from now on
            begin = list(truth.get_value().get().value)
            master.dispatch(order("A", (0.0, 0.0), (0.5, 0.0)))
            wait_for(lambda: bool(state().errors), "the state has no error")
            error = state().errors[0]
            assert (error.error_type, error.error_level.value) == ("drivingError", "FATAL")
            assert "holds" in error.error_description or "held" in error.error_description
            assert list(truth.get_value().get().value) == pytest.approx(begin)
            assert [one.node_id for one in state().node_states] == ["n1"]
            holder["roomba-1"].release("Base").get()
            master.run(master.client.cancel_order(TARGET))
            wait_for(
                lambda: not state().errors and not state().node_states and not state().driving,
                "the order is not cancelled",
            )
            master.dispatch(order("B", (0.0, 0.0), (0.3, 0.0)))
            wait_for(lambda: state().last_node_id == "n1", "it does not drive after the release")
            assert truth.get_value().get().value[0] == pytest.approx(0.3, abs=0.06)
            wait_for(lambda: not error_of(holder["roomba-1"]["Base"].send_cmd("r10").get), "it is not released")


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
        intruder.say("uagv/v2/EAL/roomba-1/order", b"{").wait_for_publish(10)  # the broker has the others too
        assert list(truth.get_value().get().value) == pytest.approx(begin)
        master.run(master.client.dispatch(order("D", (1.0, 0.5), (1.2, 0.5)), TARGET))
        wait_for(lambda: truth.get_value().get().value[0] > 1.15, "it does not drive after them")


def test_a_robot_that_is_absent_at_the_start_is_named_and_becomes_an_agv_when_it_comes(
    broker: Broker, tmp_path: Path
) -> None:
    sim = {"plugins": {"sim": {"model": "roomba"}}}
    robots = {"roomba-1": {**sim, "address": f"tcp/127.0.0.1:{free_port()}"}, "near-1": sim}
    file = tmp_path / "absent.yaml"
    file.write_text(json.dumps({"version": 1, "name": "absent", "robots": robots}))
    with SdkMaster(broker) as master, Fleet.load(file) as fleet, log_lines() as lines:
        bridge, settings = EALPluginManager().bridge("vda5050", {"broker": broker.url, "state_period_s": 0.2})
        with bridge.open_bridge(fleet, settings) as line:
            assert line.startswith("1 AGVs at ")
            with RobotService(EALConfigManager.load(file).fleet, "roomba-1"):
                wait_for(lambda: master.state("roomba-1") is not None, "it is no AGV")
                wait_for(lambda: master.state("roomba-1").agv_position is not None, "no position")
                master.dispatch(order("A", (0.0, 0.0), (0.5, 0.0)))
                wait_for(lambda: master.state("roomba-1").driving, "it does not drive")
            told = [line for line in lines.getvalue().splitlines() if "these robots are" in line]
            assert len(told) == 1
            assert "absent" in told[0]
            assert "roomba-1" in told[0]


def test_a_cancellation_that_does_not_reach_the_robot_fails_and_its_halt_is_repeated(
    broker: Broker, tmp_path: Path
) -> None:
    with SdkMaster(broker) as master, ExitStack() as service:
        file = service.enter_context(served_robot(tmp_path, "roomba-1"))
        bridge, settings = EALPluginManager().bridge("vda5050", {"broker": broker.url, "state_period_s": 0.2})

        def state() -> Any:
            return master.state("roomba-1")

        def has_cancelled(status: str) -> bool:
            return any(
                (one.action_type, one.action_status.value) == ("cancelOrder", status) for one in state().action_states
            )

        with Fleet.load(file) as fleet, bridge.open_bridge(fleet, settings):
            wait_for(lambda: state() is not None and state().agv_position is not None, "no position")
            master.dispatch(order("A", (0.0, 0.0), (2.0, 0.0)))
            wait_for(lambda: state().driving, "it does not drive")
            service.close()
            wait_for(lambda: fleet["roomba-1"].state is RobotState.LOST, "the robot is not lost")
            cancel = {"actionType": "cancelOrder", "actionId": "c", "blockingType": "HARD", "actionParameters": []}
            with Device(broker) as device:
                head = {"headerId": 1, "timestamp": "2026-01-01T00:00:00.00Z", "version": "2.1.0"}
                head |= {"manufacturer": "EAL", "serialNumber": "roomba-1", "actions": [cancel]}
                device.say("uagv/v2/EAL/roomba-1/instantActions", json.dumps(head).encode())
            wait_for(lambda: has_cancelled("FAILED"), "the cancellation does not fail")
            assert not state().node_states
            assert state().driving  # as far as anybody knows
            assert any("the halt is repeated" in (one.error_description or "") for one in state().errors)
            service.enter_context(RobotService(EALConfigManager.load(file).fleet, "roomba-1"))
            wait_for(lambda: not state().driving, "the halt is not repeated")
            service.close()
