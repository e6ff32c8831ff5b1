"""plugins/roomba: lights and songs."""

from __future__ import annotations

import pytest

from eal_actors.kernel.errors import ArgumentError, UnavailableError
from eal_actors.plugin import EALData
from plugins.roomba import sci
from plugins.roomba.panel import RoombaSong, SciLeds
from plugins.roomba.sci import StatusLed
from plugins.roomba.sci_emulator import SciEmulator
from tests.unit.plugins.roomba.rig import Rig, without_polls


def test_lights_are_set_one_by_one_and_told() -> None:
    rig = Rig()
    leds = SciLeds(rig.roomba)
    rig.take_sent()
    for text, argument in (("dirt", True), ("spot", True), ("status", "amber"), ("dirt", False)):
        rig.run(leds.send_cmd(text, EALData.of(argument)))
    rig.run(leds.send_cmd("power_colour128"))
    rig.run(leds.send_cmd("power_intensity255"))
    assert list(without_polls(rig.take_sent())) == [
        *(139, 0b000001, 0, 0),
        *(139, 0b001001, 0, 0),
        *(139, 0b111001, 0, 0),
        *(139, 0b111000, 0, 0),
        *(139, 0b111000, 128, 0),
        *(139, 0b111000, 128, 255),
    ]
    told = {request.name: leds.send_req(request.name) for request in leds.info().requests}
    assert told == {
        "dirt": False,
        "max": False,
        "clean": False,
        "spot": True,
        "status": "amber",
        "power_colour": 128,
        "power_intensity": 255,
    }
    assert rig.emulator.lights == sci.SciLights(
        spot=True, status=StatusLed.AMBER, power_colour=128, power_intensity=255
    )
    rig.run(leds.send_cmd("off"))
    assert rig.emulator.lights == sci.SciLights()
    assert leds.send_req("status") == "off"


def test_lights_that_could_not_be_set_are_not_told() -> None:
    rig = Rig()
    leds = SciLeds(rig.roomba)
    rig.port.is_cut = True
    rig.wait(0.5)
    with pytest.raises(UnavailableError):
        rig.run(leds.send_cmd("clean", EALData.of(True)))
    assert leds.send_req("clean") is False


@pytest.mark.parametrize(("text", "argument"), [("status", "blue"), ("dirt", "on"), ("power_colour256", None)])
def test_lights_there_are_not_are_refused(text: str, argument: object) -> None:
    with pytest.raises(ArgumentError):
        SciLeds(Rig().roomba).send_cmd(text, None if argument is None else EALData.of(argument))


def test_a_song_is_stored_and_played() -> None:
    rig = Rig()
    song = RoombaSong(rig.roomba)
    song.set_config("number", EALData.of(3))
    rig.take_sent()
    rig.run(song.send_cmd("notes", EALData.of("72:16  76:112")))
    assert song.get_status() == 0
    rig.run(song.send_cmd("play"))
    assert list(without_polls(rig.take_sent())) == [140, 3, 2, 72, 16, 76, 112, 140, 3, 2, 72, 16, 76, 112, 141, 3]
    assert song.send_req("notes") == "72:16  76:112"
    rig.wait(1.9)
    assert (song.get_status(), rig.emulator.playing(rig.clock.now())) == (1, 3)
    with pytest.raises(UnavailableError, match=r"plays for another 0\.1\d s"):
        song.send_cmd("play")
    rig.wait(0.2)
    assert (song.get_status(), rig.emulator.playing(rig.clock.now())) == (0, None)
    assert rig.emulator.refused == 0


def test_a_roomba_that_was_switched_off_plays_the_song_again() -> None:
    rig = Rig()
    song = RoombaSong(rig.roomba)
    rig.run(song.send_cmd("notes", EALData.of("60:16")))
    rig.port.is_cut = True
    rig.wait(3.0)
    rig.port.emulator = rig.emulator = SciEmulator(rig.body)  # without a song
    rig.port.is_cut = False
    rig.wait(3.0)
    rig.run(song.send_cmd("play"))
    assert (song.get_status(), rig.emulator.playing(rig.clock.now())) == (1, 0)


def test_each_number_has_a_song_of_its_own() -> None:
    rig = Rig()
    song = RoombaSong(rig.roomba)
    rig.run(song.send_cmd("notes", EALData.of("60:8")))
    song.set_config("number", EALData.of(15))
    assert (song.get_config("number"), song.send_req("notes")) == (15, "")
    with pytest.raises(ArgumentError, match="song 15 has no notes yet"):
        song.send_cmd("play")
    song.set_config("number", EALData.of(0))
    assert song.send_req("notes") == "60:8"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"1\.\.16 notes, not 0"),
        (" ".join(["60:8"] * 17), r"1\.\.16 notes, not 17"),
        ("30:8", "'30:8' is no note"),
        ("128:8", "'128:8' is no note"),
        ("60:0", "'60:0' is no note"),
        ("60:256", "'60:256' is no note"),
        ("60", "'60' is no note"),
        ("60:8:8", "'60:8:8' is no note"),
        ("c4:8", "'c4:8' is no note"),
        ("²:8", "'²:8' is no note"),
    ],
)
def test_notes_that_are_none_are_refused(text: str, words: str) -> None:
    rig = Rig()
    rig.take_sent()
    with pytest.raises(ArgumentError, match=words):
        RoombaSong(rig.roomba).send_cmd("notes", EALData.of(text))
    assert rig.take_sent() == b""
