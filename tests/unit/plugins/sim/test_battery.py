"""Batteries of simulated robots: drained by time and driving, independent of readers."""

from __future__ import annotations

import pytest

from eal_actors.kernel.errors import UnavailableError
from plugins.sim.models import MAKES, Make
from plugins.sim.parts import SimBattery
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock
from tests.unit.plugins.sim.rig import Fleet, arena

makes = pytest.mark.parametrize("make", MAKES.values(), ids=lambda make: make.name)


@makes
def test_the_voltage_falls_with_the_charge_and_sags_under_a_current(make: Make) -> None:
    assert SimBattery(make.battery).fraction == 1
    voltages = []
    for percent in range(100, 0, -1):
        battery = SimBattery(make.battery, percent / 100)
        voltages.append(battery.voltage_v)
    assert voltages == sorted(voltages, reverse=True)
    assert make.battery.empty_v - 1 < voltages[-1] < voltages[0] < make.battery.full_v
    before_v = battery.voltage_v
    battery.follow(0.0, 0.0, 0.3)
    assert battery.voltage_v == pytest.approx(before_v - make.battery.resistance_ohm * make.battery.drive_as_m * 0.3)
    assert battery.temperature_c > 22


@makes
def test_it_is_drained_by_time_and_by_way(make: Make) -> None:
    battery = SimBattery(make.battery)
    battery.follow(3600.0, 100.0, 0.0)
    drawn_ah = make.battery.idle_a + make.battery.drive_as_m * 100.0 / 3600
    assert battery.charge_ah == pytest.approx(battery.capacity_ah - drawn_ah)
    assert battery.current_a == -make.battery.idle_a
    battery = SimBattery(make.battery, 0.5)
    assert battery.fraction == pytest.approx(0.5)
    battery.follow(1e6, 100.0, 0.0)
    assert (battery.charge_ah, battery.fraction, battery.current_a, battery.is_empty) == (0, 0, 0, True)
    assert battery.voltage_v == make.battery.empty_v


@makes
def test_a_full_one_lasts_for_hours(make: Make) -> None:
    hours = make.battery.capacity_ah / (make.battery.idle_a + make.battery.drive_as_m * make.speed_m_s)
    assert 1 < hours < 6


def test_the_resource_tells_the_figures() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", model="roomba", charge=0.5)
    battery = robot.resource("Battery")
    assert battery.get_value().value == 0.5
    assert (battery.send_req("charge").value, battery.send_req("charge").unit) == (1.35, "A h")
    assert battery.send_req("capacity").value == 2.7
    assert battery.send_req("current").value == -0.25
    assert 14 < battery.send_req("voltage").value < 16
    fleet.clock.advance(3600.0)
    assert battery.send_req("charge").value == pytest.approx(1.1)


def test_a_robot_that_joins_hours_later_has_its_initial_charge() -> None:
    fleet = Fleet()
    fleet.clock.advance(100 * 3600.0)
    robot = fleet.add("r1", model="roomba", charge=0.5)
    battery = robot.resource("Battery")
    assert battery.get_value().value == pytest.approx(0.5)
    fleet.clock.advance(3600.0)
    assert battery.send_req("charge").value == pytest.approx(1.1)
    robot.do("f0.2")


def test_an_empty_battery_stops_the_robot_and_refuses_the_next_command() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (-2, 0, 0), charge=0.00025)  # 2.4 A s
    with pytest.raises(UnavailableError, match="battery is empty"):
        robot.do("f3")
    assert -1.9 < robot.pose[0] < 0.5
    assert robot.base.get_status() == 0
    with pytest.raises(UnavailableError, match="battery is empty"):
        robot.do("l90")


def test_where_it_stops_does_not_depend_on_who_looks() -> None:
    def end(look_s: float) -> tuple[float, float, float]:
        clock = ManualClock()
        world = SimWorld(clock, 1, arena())
        robot = world.join("r1", MAKES["evbot3"], noise=True, start=(-2.0, 0.0, 0.0), charge=0.0003)
        with world.lock:
            world.catch_up()
            world.drive(robot, 0.3, 0.31)
        for _ in range(round(10.0 / look_s)):
            clock.advance(look_s)
            with world.lock:
                world.catch_up()
                assert robot.battery.fraction >= 0
        assert robot.battery.is_empty
        return robot.pose

    assert end(0.003) == end(0.7) == end(10.0)
