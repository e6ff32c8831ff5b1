"""plugins/roomba: after a failure nothing moves, and the error says what it was."""

from __future__ import annotations

import pytest

from eal_actors.kernel.errors import NotReadyError, ResourceFaultError, UnavailableError
from plugins.roomba.resources import RoombaBattery
from plugins.roomba.sci import Mode
from tests.unit.plugins.roomba.rig import MoteRig, Rig

BOTH = pytest.mark.parametrize("kind", [Rig, MoteRig])


def stands(rig: Rig) -> bool:
    rig.wait(3.0)
    rig.body.travel_m()
    return rig.body.left.speed_m_s == rig.body.right.speed_m_s == 0.0


@BOTH
@pytest.mark.parametrize("mode", [Mode.SAFE, Mode.FULL])
def test_a_wheel_drop_while_turning(kind: type[Rig], mode: Mode) -> None:
    rig = kind(mode)
    turn = rig.begin("l360", 1.0)
    rig.body.dropped = (True, False, False)
    with pytest.raises(ResourceFaultError, match=r"^halted: wheel drop \(left wheel\)$"):
        rig.run(turn)
    assert stands(rig)


@BOTH
def test_a_cliff_on_the_way_forward_after_a_turn_beside_it(kind: type[Rig]) -> None:
    rig = kind()
    rig.body.over_cliffs = (False, False, True, False)
    rig.wait(0.2)
    rig.do("l45")
    with pytest.raises(ResourceFaultError, match=r"^halted: cliff \(front right\)$"):
        rig.run(rig.base.send_cmd("f1"))
    assert stands(rig)


@BOTH
def test_a_port_closed_in_the_middle_of_a_reply(kind: type[Rig]) -> None:
    rig = kind()
    drive = rig.begin("f5", 1.0)
    rig.port.arrive(bytes(7))
    rig.port.is_broken = True
    with pytest.raises(NotReadyError, match="memory was lost"):
        rig.run(drive)
    rig.wait(0.3)
    rig.port.come_back()
    assert stands(rig)
    rig.do("b0.1")


@BOTH
def test_a_computer_that_was_held_up_does_not_call_the_roomba_silent(kind: type[Rig]) -> None:
    rig = kind()
    rig.wait(1.0)
    rig.clock.advance(5.0)
    assert rig.roomba.not_ready() is None
    rig.port.is_cut = True
    rig.wait(5.0)
    assert "does not answer" in str(rig.roomba.not_ready())


@BOTH
def test_an_emulator_that_freezes(kind: type[Rig]) -> None:
    rig = kind()
    drive = rig.begin("f5", 1.0)
    rig.port.is_cut = True
    with pytest.raises(UnavailableError, match="the Roomba on memory does not answer"):
        rig.run(drive)
    rig.wait(2.0)
    rig.port.is_cut = False
    assert stands(rig)
    rig.do("b0.1")


@BOTH
def test_a_battery_that_runs_low_and_out(kind: type[Rig]) -> None:
    rig = kind()
    drive = rig.begin("f5", 1.0)
    rig.body.charge.charge_ah = 0.027
    rig.wait(2.5)  # in motion the battery is read every two seconds
    assert RoombaBattery(rig.roomba).get_value().value == 0.01
    rig.emulator._has_device_detect = True  # so no byte wakes it
    rig.emulator.is_asleep = True  # it switches itself off, and its motors with it
    rig.body.drive(0.0, 0.0)
    with pytest.raises((UnavailableError, ResourceFaultError), match=r"does not answer|counted nothing"):
        rig.run(drive)
    assert stands(rig)
