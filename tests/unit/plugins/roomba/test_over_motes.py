"""plugins/roomba: the driver through a pair of motes, also where the radio loses packets."""

from __future__ import annotations

import math
from contextlib import suppress

import pytest

from eal_actors.kernel.errors import EALError, UnavailableError
from plugins.roomba.sci import Mode
from plugins.roomba.tinyos import Header, TinyosFraming
from tests.unit.plugins.roomba.rig import MoteRig


@pytest.mark.parametrize("framing", [TinyosFraming(), TinyosFraming(Header.TINYOS_1), TinyosFraming(payload_bytes=8)])
def test_it_does_the_square_without_loss(framing: TinyosFraming) -> None:
    rig = MoteRig(framing=framing)
    rig.do(*["f0.5", "l90"] * 4)
    x_m, y_m, yaw_rad = rig.body.pose
    assert math.hypot(x_m, y_m) < 0.02
    assert yaw_rad == pytest.approx(0.0, abs=math.radians(2.5))
    assert (rig.emulator.violations, rig.motes.duplicates) == (0, 0)


@pytest.mark.parametrize("seed", range(4))
def test_with_30_percent_of_the_radio_packets_lost_and_sent_again_it_does_the_square(seed: int) -> None:
    rig = MoteRig(loss=0.3, radio_tries=5, seed=seed)
    rig.do(*["f0.5", "l90"] * 4)
    x_m, y_m, yaw_rad = rig.body.pose
    assert rig.motes.lost > 100
    assert math.hypot(x_m, y_m) < 0.04
    assert yaw_rad == pytest.approx(0.0, abs=math.radians(4))


@pytest.mark.parametrize("seed", range(6))
def test_with_30_percent_lost_for_good_it_does_the_square_or_fails_loudly_and_stands(seed: int) -> None:
    rig = MoteRig(loss=0.3, seed=seed)
    end_m = None
    with suppress(EALError):  # the loud failure
        rig.do(*["f0.5", "l90"] * 4)
        x_m, y_m, _ = rig.body.pose
        end_m = math.hypot(x_m, y_m)
    rig.wait(3.0)
    rig.body.travel_m()
    assert rig.motes.lost > 10
    assert (rig.body.left.speed_m_s, rig.body.right.speed_m_s) == (0.0, 0.0), seed
    assert end_m is None or end_m < 0.3, (seed, end_m)  # what a lost reply counted can only be guessed


def test_lost_acknowledgements_cost_time_and_nothing_else() -> None:
    rig = MoteRig(ack_loss=0.2, seed=3)
    rig.do("f0.3")
    assert rig.motes.duplicates > 0
    assert rig.body.pose[0] == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("mode", [Mode.SAFE, Mode.FULL])
def test_a_radio_that_falls_silent_ends_the_motion_and_the_robot_stands(mode: Mode) -> None:
    rig = MoteRig(mode)
    drive = rig.begin("f5", 1.0)
    rig.motes.lose(1.0)
    with pytest.raises(UnavailableError, match="does not answer"):
        rig.run(drive)
    rig.wait(2.0)
    rig.body.travel_m()
    assert rig.body.left.speed_m_s == 0.0  # the mote on the robot saw to that
    rig.motes.lose(0.0)
    rig.wait(2.0)
    rig.do("b0.1")
    assert rig.emulator.mode is mode


def test_a_mote_that_does_not_acknowledge_is_named() -> None:
    rig = MoteRig()
    rig.port.is_cut = True
    rig.wait(3.0)
    assert rig.roomba.not_ready() is not None
    assert "the mote on memory does not acknowledge: packet " in str(rig.roomba.not_ready())


def test_a_halt_goes_out_at_once_whatever_waits() -> None:
    rig = MoteRig()
    drive = rig.begin("f5", 1.0)
    rig.motes.forwarded.clear()
    drive.close()
    assert next(iter(rig.motes.forwarded)) == bytes([137, 0, 0, 0, 1])


def test_it_is_left_to_itself_at_the_end_in_spite_of_loss() -> None:
    rig = MoteRig(loss=0.3, seed=1)
    rig.base.close()
    rig.run(rig.roomba.farewell())
    rig.roomba.close()
    assert rig.emulator.mode is Mode.PASSIVE
