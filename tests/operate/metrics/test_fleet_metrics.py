"""Metrics, scraped over HTTP from working robots."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from eal_actors.actors import call as calls
from eal_actors.actors.combine import gather
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import ResourceFaultError, UnavailableError
from eal_actors.operate.metrics.call_observer import observe_calls
from eal_actors.operate.metrics.fleet_metrics import FleetMetrics
from tests.manual_clock import ManualClock
from tests.operate.metrics.scraping import samples, scrape
from tests.robots import WAIT_S, advance_until_done, running_robot


class Base(Resource):
    types = ResourceType.ACTUATOR

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.entered = threading.Event()

    def get_status(self) -> int:
        return 1

    @command("go")
    def go(self) -> Activity:
        yield 2.0

    @command("fail")
    def fail(self) -> None:
        raise OSError("no motor")

    @command("block")
    def block(self) -> None:
        self.entered.set()
        self.gate.wait(WAIT_S)

    @command("crash")
    def crash(self) -> None:
        raise KeyboardInterrupt


class Eye(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(None, None, 3))

    def get_value(self) -> EALData:
        return EALData.of(np.zeros((2, 2, 3), np.uint8))


@contextmanager
def measured(robot: RobotHandle, trips: Mapping[str, int] | None = None) -> Iterator[FleetMetrics]:
    with FleetMetrics({robot.name: robot}, robot.clock, 0, trips) as metrics:
        yield metrics


class TestCalls:
    def test_are_counted_by_outcome_and_measured(self) -> None:
        clock = ManualClock()
        with running_robot({"Base": Base}, clock=clock) as robot, measured(robot) as metrics:
            gather([robot["Base"].get_status() for _ in range(3)]).get()
            drive = robot["Base"].send_cmd("go")
            advance_until_done(clock, drive, step_s=0.5)
            with pytest.raises(ResourceFaultError):
                robot["Base"].send_cmd("fail").get()
            preempted = robot["Base"].send_cmd("go")
            robot["Base"].halt().get()
            assert preempted.exception() is not None
            found = samples(scrape(metrics.port))
        assert found["eal_calls_total", ("get_status", "done", "Base", "robot")] == 3
        assert found["eal_calls_total", ("send_cmd", "done", "Base", "robot")] == 1
        assert found["eal_calls_total", ("send_cmd", "resource_fault", "Base", "robot")] == 1
        assert found["eal_calls_total", ("send_cmd", "preempted", "Base", "robot")] == 1
        assert found["eal_calls_total", ("halt", "done", "Base", "robot")] == 1
        assert found["eal_call_seconds_count", ("send_cmd", "Base", "robot")] == 3
        assert 2.0 <= found["eal_call_seconds_sum", ("send_cmd", "Base", "robot")] <= clock.now()  # the drive
        assert found["eal_call_seconds_bucket", ("3.0", "send_cmd", "Base", "robot")] == 3
        assert found["eal_call_seconds_bucket", ("1.0", "send_cmd", "Base", "robot")] == 2

    def test_pictures_are_counted(self) -> None:
        with running_robot({"Eye": Eye, "Base": Base}) as robot, measured(robot) as metrics:
            gather([robot["Eye"].get_value() for _ in range(4)]).get()
            robot["Base"].get_status().get()
            found = samples(scrape(metrics.port))
        assert found["eal_frames_total", ("Eye", "robot")] == 4
        assert ("eal_frames_total", ("Base", "robot")) not in found

    def test_calls_of_another_fleet_are_not_counted(self) -> None:
        with (
            running_robot({"Base": Base}, name="ours") as ours,
            running_robot({"Base": Base}, name="theirs") as theirs,
            measured(ours) as metrics,
        ):
            theirs["Base"].get_status().get()
            ours["Base"].get_status().get()
            text = scrape(metrics.port)
        assert "theirs" not in text
        assert 'eal_calls_total{method="get_status",outcome="done",resource="Base",robot="ours"} 1.0' in text

    def test_calls_are_not_observed_without_an_observer(self) -> None:
        heard: list[Any] = []
        with running_robot({"Base": Base}) as robot:
            with observe_calls(robot.clock, lambda call, outcome, _: heard.append((call.method, outcome))):
                robot["Base"].get_status().get()
                assert len(calls._watchers) == 1
            assert not calls._watchers
            robot["Base"].get_status().get()
        assert heard == [("get_status", "done")]


class TestStanding:
    def test_waiting_calls_are_read_at_the_scrape(self) -> None:
        clock = ManualClock()
        base = Base()
        with running_robot({"Base": lambda: base}, clock=clock, timeout_s=100.0) as robot, measured(robot) as metrics:
            blocked = robot["Base"].send_cmd("block")
            assert base.entered.wait(WAIT_S)
            empty = samples(scrape(metrics.port))
            waiting = [robot["Base"].send_cmd("fail") for _ in range(5)]
            clock.advance(1.5)
            full = samples(scrape(metrics.port))
            base.gate.set()
            blocked.get()
            assert all(isinstance(call.exception(), ResourceFaultError) for call in waiting)
            after = samples(scrape(metrics.port))
        place = ("Base", "robot")
        assert [found["eal_mailbox_depth", place] for found in (empty, full, after)] == [0, 5, 0]
        assert [found["eal_mailbox_oldest_seconds", place] for found in (empty, full, after)] == [0, 1.5, 0]

    def test_states_stops_and_readiness(self) -> None:
        with running_robot({"Base": Base}) as robot, measured(robot, {"Base": 2}) as metrics:
            robot.stop("fire").get()
            found = samples(scrape(metrics.port))
            robot.resume().get()
            resumed = samples(scrape(metrics.port))
        assert found["eal_robot_state", ("robot", "ready")] == 1
        assert found["eal_robot_state", ("robot", "lost")] == 0
        assert (found["eal_emergency_stop", ("robot",)], resumed["eal_emergency_stop", ("robot",)]) == (1, 0)
        assert found["eal_not_ready", ("Base", "robot")] == 0
        assert found["eal_restarts_total", ("Base", "robot")] == 0
        assert found["eal_dead_man_trips_total", ("Base", "robot")] == 2

    def test_restarts_are_counted(self) -> None:
        clock = ManualClock()
        with running_robot({"Base": Base}, clock=clock) as robot, measured(robot) as metrics:
            assert robot["Base"].send_cmd("crash").exception() is not None
            restarted = threading.Event()
            while not restarted.wait(0.002):
                clock.advance(0.05)
                if robot.restarts.get("Base") == 1:
                    restarted.set()
            found = samples(scrape(metrics.port))
        assert found["eal_restarts_total", ("Base", "robot")] == 1


class TestEndpoint:
    def test_a_port_in_use_is_refused_by_name(self) -> None:
        with running_robot({"Base": Base}) as robot, measured(robot) as metrics:
            second = FleetMetrics({}, SystemClock(), metrics.port)
            with pytest.raises(UnavailableError, match=f"port {metrics.port}"):
                second.__enter__()
            assert len(calls._watchers) == 1

    def test_it_listens_on_loopback_only_and_ends(self) -> None:
        with running_robot({"Base": Base}) as robot:
            with measured(robot) as metrics:
                assert metrics.url == f"http://127.0.0.1:{metrics.port}/metrics"
                scrape(metrics.port)
            with pytest.raises(ConnectionRefusedError):
                scrape(metrics.port)
