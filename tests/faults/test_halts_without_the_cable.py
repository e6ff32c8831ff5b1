"""A halt while a robot's cable is out is accepted, and stops the robot when the cable is back in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import NotReadyError
from eal_actors.managers.config import EALConfigManager
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.sci import WHEELBASE_M
from plugins.roomba.sci_emulator import SciEmulator
from tests.emulated import PATIENT, WAIT_S, Emulated, Emulator, an_evbot2, plugged_in


def a_roomba_at_a_cable() -> Emulated[FreeRoombaBody]:
    """Return a Roomba that drives on in silence, because it has no watchdog."""

    def make(now_s: Callable[[], float]) -> tuple[Emulator, FreeRoombaBody]:
        body = FreeRoombaBody(now_s, WHEELBASE_M)
        return SciEmulator(body, mode_pause_s=0.0), body

    return Emulated("pty", make)


ROBOTS: dict[str, tuple[Callable[[], Emulated[Any]], dict[str, Any]]] = {
    "evbot2": (an_evbot2, dict(PATIENT)),
    "roomba": (a_roomba_at_a_cable, {"protocol": "sci", "poll_hz": 5}),
}


@pytest.mark.parametrize("make", ROBOTS)
@pytest.mark.parametrize("method", ["halt", "s"])
def test_it_is_accepted_and_stops_the_robot_when_the_cable_is_back(make: str, method: str) -> None:
    new, settings = ROBOTS[make]
    with plugged_in(new()) as robot:
        plugins = {make: {"port": robot.address, **settings}}
        with Fleet(EALConfigManager.of({"version": 1, "robots": {"hero": {"plugins": plugins}}}).fleet) as fleet:
            base = fleet["hero"]["Base"]
            robot.strike_after(0.05, lambda: None)
            moving = base.send_cmd("f5", timeout_s=WAIT_S)
            assert robot.struck.wait(WAIT_S)
            robot.unplug()
            assert isinstance(moving.exception(), NotReadyError)
            stop = base.halt() if method == "halt" else base.send_cmd("s")
            assert stop.get() == 1
            assert isinstance(base.get_status().exception(), NotReadyError)
            robot.plug_in()
            while base.get_status().exception() is not None:  # bounded by pytest's time-out
                fleet.clock.sleep(0.05)
            assert robot.stands()
            assert fleet["hero"].restarts == {}


@pytest.mark.parametrize("make", ROBOTS)
def test_an_emergency_stop_is_confirmed_when_the_cable_is_back(make: str) -> None:
    new, settings = ROBOTS[make]
    with plugged_in(new()) as robot:
        plugins = {make: {"port": robot.address, **settings}}
        with Fleet(EALConfigManager.of({"version": 1, "robots": {"hero": {"plugins": plugins}}}).fleet) as fleet:
            robot.strike_after(0.05, lambda: None)
            moving = fleet["hero"]["Base"].send_cmd("f5", timeout_s=WAIT_S)
            assert robot.struck.wait(WAIT_S)
            robot.unplug()
            assert isinstance(moving.exception(), NotReadyError)
            with pytest.raises(NotReadyError, match="Base cannot be halted before the device is back"):
                fleet["hero"].stop("smoke").get()
            assert not fleet["hero"].is_stop_confirmed
            robot.plug_in()
            while not fleet["hero"].is_stop_confirmed:  # bounded by pytest's time-out
                fleet.clock.sleep(0.05)
            assert robot.stands()
