"""plugins/roomba: a stop that noise damages must not set a robot going, and none is sent without need."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from eal_actors.plugin import EALData
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.emulated_roomba import EmulatedRoomba
from plugins.roomba.oi_driver import OiDriver
from plugins.roomba.oi_emulator import OiEmulator
from plugins.roomba.sci import STRAIGHT, WHEELBASE_M, Op, ask_sensors
from plugins.roomba.sci_driver import SciDriver
from plugins.roomba.sci_emulator import SciEmulator
from tests.unit.plugins.roomba.oi_rig import OiRig
from tests.unit.plugins.roomba.rig import MoteRig, Rig, without_polls

STOP = SciDriver.stop_data


def one_byte_lost_or_doubled(data: bytes) -> Iterator[bytes]:
    for place in range(len(data)):
        yield data[:place] + data[place + 1 :]
        yield data[:place] + data[place : place + 1] + data[place:]


def one_byte_inserted(data: bytes) -> Iterator[bytes]:
    for place in range(len(data) + 1):
        for byte in range(256):
            yield data[:place] + bytes([byte]) + data[place:]


def is_driven_by(kind: type[EmulatedRoomba], damaged_stop: bytes) -> bool:
    """Return whether a damaged stop, which two polls follow, sets the wheels of a robot in safe mode going."""
    body = FreeRoombaBody(lambda: 0.0, WHEELBASE_M)
    emulator = kind(body, mode_pause_s=0.0)
    emulator.feed(bytes([Op.START, Op.CONTROL]) + damaged_stop + 2 * ask_sensors(0), 0.0)
    return body.is_driven


@pytest.mark.parametrize(("kind", "stop"), [(SciEmulator, STOP), (OiEmulator, OiDriver.stop_data)])
def test_a_stop_with_a_byte_lost_or_doubled_is_no_drive(kind: type[EmulatedRoomba], stop: bytes) -> None:
    assert not [data.hex(" ") for data in one_byte_lost_or_doubled(stop) if is_driven_by(kind, data)]


def test_a_stop_with_a_byte_inserted_is_no_drive() -> None:
    assert not [data.hex(" ") for data in one_byte_inserted(STOP) if is_driven_by(SciEmulator, data)]


def test_a_motion_ends_with_one_stop() -> None:
    rig = Rig()
    rig.take_sent()
    rig.do("f0.1")
    rig.wait(1.0)
    assert rig.take_sent().count(STOP) == 1


def test_a_single_false_count_of_a_robot_that_stands_is_no_reason_to_stop_it() -> None:
    rig = Rig()
    rig.do("f0.1")
    rig.wait(1.0)
    rig.take_sent()
    rig.emulator._distance._taken -= 1
    rig.wait(1.0)
    assert without_polls(rig.take_sent()) == b""


@pytest.mark.parametrize("poll_hz", [5, 20])
@pytest.mark.parametrize(("speed_mm_s", "most_m"), [(500, 0.25), (20, 0.01), (1, 0.004)])
def test_a_robot_that_a_damaged_byte_sets_going_is_stopped(speed_mm_s: int, most_m: float, poll_hz: float) -> None:
    rig = Rig(poll_hz=poll_hz)
    rig.do("f0.1")
    rig.wait(1.0)
    before_m = rig.body.travel_m()[0]
    rig.emulator._drive(speed_mm_s, STRAIGHT)
    rig.wait(4.0)
    assert rig.body.left.target_m_s == 0.0
    assert rig.body.travel_m()[0] - before_m < most_m


@pytest.mark.parametrize("make", [Rig, OiRig, MoteRig])
@pytest.mark.parametrize("drops", [False, True])
def test_a_twist_without_a_caller_ends_where_the_port_is_lost_and_the_background_goes_on(
    make: type[Rig], drops: bool
) -> None:
    rig = make()
    twist = rig.base.set_value(EALData.of([0.2, 0.0]))
    rig.start(twist, 0.1)
    twist.close()  # as between two twists of a motion to a place
    rig.body.dropped = (drops,) * 3
    rig.port.is_broken = True
    rig.wait(2.0)
    assert rig.base.get_status() == 0
    rig.body.dropped = (False,) * 3
    rig.port.come_back()
    rig.wait(2.0)
    assert rig.body.left.target_m_s == rig.body.right.target_m_s == 0.0
    rig.do("f0.1")
