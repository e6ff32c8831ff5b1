"""Simulated EvBots say of themselves what the drivers of real ones do, and their drivers drive them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import pytest

from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.errors import EALError, UnavailableError
from eal_actors.plugin import FleetServices, PluginContext, Resource
from eal_actors.testing import Simulation
from plugins.evbot2 import plugin as evbot2
from plugins.evbot2.emulator import TRACKS
from plugins.evbot3 import plugin as evbot3
from plugins.evbot3.emulator import WHEELS
from plugins.sim import plugin as sim
from plugins.sim.models import MAKES
from tests.manual_clock import ManualClock
from tests.unit.plugins.evbot2.rig import Rig
from tests.unit.plugins.evbot3.rig import Rig3

NAMES = {"evbot2": ("Base", "Odometry"), "evbot3": ("Base", "Odometry", "Turret", "Bump", "Battery")}
DRIVERS: dict[str, ModuleType] = {"evbot2": evbot2, "evbot3": evbot3}
PORTS = {"evbot2": {"port": "sim://world/body"}, "evbot3": {"address": "sim://world/body"}}
MAKE_NAMES = ("evbot2", "evbot3")
CASES = [(make, name) for make, names in NAMES.items() for name in names]


def resources_of(make: str, name: str) -> tuple[Resource, Resource]:
    """Return the same resource of a driven and of a simulated robot."""
    rig = Rig() if make == "evbot2" else Rig3()
    settings = sim.Settings.model_validate({"model": make})
    context = PluginContext("rob", "twin", settings, FleetServices(ManualClock()))
    driven: Resource = DRIVERS[make].plugin_of(context, rig.session, rig.odometer).makers[name]()
    simulated = sim.connect(context).makers[name]()
    driven.name = simulated.name = name
    return driven, simulated


@pytest.mark.parametrize(("make", "name"), CASES)
def test_it_says_the_same_of_itself(make: str, name: str) -> None:
    driven, simulated = resources_of(make, name)
    assert driven.info() == simulated.info()


@pytest.mark.parametrize(("make", "name"), CASES)
def test_it_is_configured_alike(make: str, name: str) -> None:
    driven, simulated = resources_of(make, name)
    for key in driven.info().configs:
        assert driven.get_config(key.name) == simulated.get_config(key.name), key.name


@pytest.mark.parametrize("make", MAKE_NAMES)
def test_the_driver_knows_the_wheels_of_its_make(make: str) -> None:
    wheels = TRACKS if make == "evbot2" else WHEELS
    known = MAKES["evbot2"] if make == "evbot2" else MAKES["evbot3"]
    assert (wheels.track_m, wheels.step_m) == (known.track_m, known.encoder_step_m)
    assert (wheels.max_speed_m_s, wheels.acceleration_m_s2) == (known.max_speed_m_s, known.acceleration_m_s2)


@pytest.mark.parametrize("make", MAKE_NAMES)
@pytest.mark.parametrize("twist", [[9.0, 0.0], [0.0, 9.0]])
def test_both_refuse_a_twist_with_the_same_words(make: str, twist: list[float]) -> None:
    with driven_and_twin(make) as (_, driver, twin):
        errors = [robot["Base"].set_value(twist).exception() for robot in (driver, twin)]
        messages = [error.message for error in errors if isinstance(error, EALError)]
        assert len(messages) == 2
        assert messages[0] == messages[1]


@contextmanager
def driven_and_twin(make: str, **body: Any) -> Iterator[tuple[Simulation, RobotHandle, RobotHandle]]:
    """A driver with its body in the world, and a twin of the body beside it."""
    robots: dict[str, Any] = {
        "driver": {"plugins": {make: PORTS[make]}},
        "body": {"model": make, "start": (-1.0, 1.0, 0), **body},
        "twin": {"model": make, "start": (-1.0, -1.0, 0)},
    }
    with Simulation(robots) as simulation:
        yield simulation, simulation["driver"], simulation["twin"]


@pytest.mark.parametrize("make", MAKE_NAMES)
def test_one_controller_fits_both(make: str) -> None:
    with driven_and_twin(make) as (simulation, driver, twin):
        for command in ("g", "r", "f0.3", "l45", "b0.2"):
            for robot in (driver, twin):
                assert robot["Base"].send_cmd(command).get() == 1
        seen = [robot["Odometry"].get_value().get().value for robot in (driver, twin)]
        assert seen[0] == pytest.approx(seen[1], abs=0.003)
        driven, mate = simulation.pose("body"), simulation.pose("twin")
        assert (driven.x_m, driven.y_m) == pytest.approx((mate.x_m, mate.y_m + 2.0), abs=0.06)


@pytest.mark.parametrize("make", MAKE_NAMES)
def test_it_feels_what_holds_it_up(make: str) -> None:
    with driven_and_twin(make, start=(-2.5, 0.0, 180)) as (simulation, driver, _):
        driver["Base"].set_config("twist_timeout_s", 20.0).get()
        drive = driver["Base"].set_value([0.3, 0.0], timeout_s=30)
        simulation.advance(3.0)
        assert driver["Base"].get_status().get() == 2
        if make == "evbot3":
            assert driver["Bump"].get_value().get().value
        driver["Base"].halt().get()
        assert drive.exception() is not None
        simulation.advance(0.2)
        assert driver["Base"].get_status().get() == 0


def test_the_turret_of_the_world_turns_on_its_own_and_stops() -> None:
    with driven_and_twin("evbot3") as (simulation, driver, twin):
        assert driver["Turret"].send_cmd("l90").get() == 1
        assert twin["Turret"].send_cmd("l90").get() == 1
        body = simulation["body"]["Turret"]
        seen = [turret.get_value().get().value for turret in (driver["Turret"], twin["Turret"], body)]
        assert seen == pytest.approx([math.pi / 2] * 3, abs=1e-5)
        swing = driver["Turret"].send_cmd("r180")
        simulation.advance(0.5)
        driver["Turret"].send_cmd("s").get()
        assert swing.exception() is not None
        stopped = body.get_value().get().value
        simulation.advance(1.0)
        assert body.get_value().get().value == stopped
        assert simulation.pose("body")[:2] == pytest.approx((-1.0, 1.0), abs=1e-6)


@pytest.mark.parametrize("make", MAKE_NAMES)
def test_in_the_world_too_it_stands_when_its_driver_is_gone(make: str) -> None:
    with driven_and_twin(make) as (simulation, driver, _):
        driver["Base"].send_cmd("f2", timeout_s=30)
        if make == "evbot3":
            driver["Turret"].send_cmd("l3600", timeout_s=60)
        simulation.advance(1.0)
        talk = driver["Base"].resource()._session  # type: ignore[attr-defined]
        talk._port.close()  # nothing of the driver comes through any more
        simulation.advance(0.7)
        stands = simulation.pose("body")
        turret = simulation["body"]["Turret"].get_value().get().value if make == "evbot3" else 0.0
        simulation.advance(3.0)
        assert simulation.pose("body") == stands
        assert stands.x_m < -1.0 + 1.0
        if make == "evbot3":
            assert simulation["body"]["Turret"].get_value().get().value == turret


@pytest.mark.parametrize("make", MAKE_NAMES)
def test_a_dead_robot_is_silent_and_one_that_lives_again_is_greeted(make: str) -> None:
    with driven_and_twin(make) as (simulation, driver, _):
        drive = driver["Base"].send_cmd("f2", timeout_s=30)
        simulation.advance(0.5)
        simulation.inject("body", dead=True)
        with pytest.raises(UnavailableError, match="does not answer"):
            drive.get()
        simulation.clear_faults("body")
        simulation.advance(1.0)
        stands = simulation.pose("body")
        simulation.advance(1.0)
        assert simulation.pose("body") == stands
        assert driver["Base"].send_cmd("b0.1").get() == 1


@pytest.mark.parametrize("make", MAKE_NAMES)
def test_a_driver_alone_comes_up_in_lock_step(make: str) -> None:
    key = "port" if make == "evbot2" else "address"
    with Simulation({"driver": {"plugins": {make: {key: "sim://world"}}}}) as simulation:
        assert simulation.now_s < 1.0
        assert simulation["driver"]["Base"].send_cmd("f0.1").get() == 1
