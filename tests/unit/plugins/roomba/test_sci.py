"""plugins/roomba: the bytes of the Serial Command Interface, as its document gives them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.kernel.errors import ArgumentError, DataError
from plugins.roomba import groups, sci
from plugins.roomba.groups import Contacts, Controls, PowerGroup, Sensors
from plugins.roomba.sci import Op, SciLights, StatusLed

DOCUMENTED_OPS = {
    "START": 128,
    "CONTROL": 130,
    "SAFE": 131,
    "FULL": 132,
    "POWER": 133,
    "SPOT": 134,
    "CLEAN": 135,
    "MAX": 136,
    "SEEK_DOCK": 143,
}

# One reply to Sensors 0, put together by hand from the document's table.
REPLY = bytes(
    [
        *(0b00010010, 1, 0, 1, 0, 1, 0, 0b00011001, 7, 9),  # caster drop, bump left; wall; cliffs; overcurrents; dirt
        *(255, 0b0101, 0xFF, 0x38, 0x00, 0x0A),  # no remote; max and spot; -200 mm; 10 mm
        *(2, 0x3E, 0xE4, 0xFE, 0xD4, 0xE7, 0x05, 0x46, 0x0A, 0x8C),  # charging, 16100 mV, -300 mA, -25 degC, mAh
    ]
)


@pytest.mark.parametrize(("name", "code"), DOCUMENTED_OPS.items())
def test_op_codes_are_those_of_the_document(name: str, code: int) -> None:
    assert Op[name] == code


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((-200, 500), [137, 255, 56, 1, 244]),  # the document's own example
        ((200, -500), [137, 0, 200, 254, 12]),
        ((500, sci.STRAIGHT), [137, 1, 244, 128, 0]),
        ((100, sci.CLOCKWISE), [137, 0, 100, 255, 255]),
        ((100, sci.COUNTER_CLOCKWISE), [137, 0, 100, 0, 1]),
        ((0,), [137, 0, 0, 128, 0]),
    ],
)
def test_drive(arguments: tuple[int, ...], expected: list[int]) -> None:
    assert list(sci.drive(*arguments)) == expected


@pytest.mark.parametrize(("velocity", "radius"), [(501, 100), (-501, 100), (100, 2001), (100, -2001), (100, 0)])
def test_drive_refuses_what_the_wire_cannot_mean(velocity: int, radius: int) -> None:
    with pytest.raises(ArgumentError, match="SCI"):
        sci.drive(velocity, radius)


@pytest.mark.parametrize(("rate", "code"), [(300, 0), (9600, 5), (19200, 7), (57600, 10), (115200, 11)])
def test_codes_of_baud_rates(rate: int, code: int) -> None:
    assert sci.BAUD_RATES[code] == rate


@pytest.mark.parametrize(
    ("lights", "expected"),
    [
        (SciLights(), [139, 0, 0, 0]),
        (SciLights(dirt=True), [139, 1, 0, 0]),
        (SciLights(max=True), [139, 2, 0, 0]),
        (SciLights(clean=True), [139, 4, 0, 0]),
        (SciLights(spot=True), [139, 8, 0, 0]),
        (SciLights(status=StatusLed.RED), [139, 16, 0, 0]),
        (SciLights(status=StatusLed.GREEN), [139, 32, 0, 0]),
        (SciLights(status=StatusLed.AMBER), [139, 48, 0, 0]),
        (SciLights(clean=True, power_colour=128, power_intensity=255), [139, 4, 128, 255]),
    ],
)
def test_leds(lights: SciLights, expected: list[int]) -> None:
    assert list(lights.encode()) == expected


@pytest.mark.parametrize("lights", [SciLights(power_colour=256), SciLights(power_intensity=-1)])
def test_leds_refuse_what_no_byte_holds(lights: SciLights) -> None:
    with pytest.raises(ArgumentError, match=r"0\.\.255"):
        lights.encode()


def test_song_and_play() -> None:
    assert list(sci.song(3, [(72, 16), (0, 8), (127, 255)])) == [140, 3, 3, 72, 16, 0, 8, 127, 255]
    assert list(sci.play(15)) == [141, 15]


@pytest.mark.parametrize(
    ("number", "notes", "words"),
    [
        (16, [(72, 16)], "song number"),
        (0, [], "count of notes"),
        (0, [(72, 16)] * 17, "count of notes"),
        (0, [(30, 16)], "note must be 31..127"),
        (0, [(128, 16)], "note must be 31..127"),
        (0, [(72, 256)], "duration"),
    ],
)
def test_song_refuses(number: int, notes: list[tuple[int, int]], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        sci.song(number, notes)


def test_play_and_sensors_refuse_numbers_there_are_not() -> None:
    with pytest.raises(ArgumentError, match="song number"):
        sci.play(16)
    with pytest.raises(ArgumentError, match="sensor group"):
        sci.ask_sensors(4)
    assert list(sci.ask_sensors(3)) == [142, 3]


def test_a_documented_reply_is_read() -> None:
    contacts = Contacts(
        bump_left=True,
        drop_caster=True,
        wall=True,
        cliff_front_left=True,
        cliff_right=True,
        overcurrent_side_brush=True,
        overcurrent_drive_right=True,
        overcurrent_drive_left=True,
        dirt_left=7,
        dirt_right=9,
    )
    controls = Controls(255, button_max=True, button_spot=True, distance_mm=-200, angle_mm=10)
    power = PowerGroup(2, 16100, -300, -25, 1350, 2700)
    assert Sensors.decode(REPLY) == Sensors(contacts, controls, power)
    assert Contacts.decode(REPLY[:10]) == contacts
    assert Controls.decode(REPLY[10:16]) == controls
    assert PowerGroup.decode(REPLY[16:]) == power
    assert power.fraction == 0.5


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (0, 0b100000, "byte 0 of a sensor group holds 5 flags, but is 32"),
        (1, 2, "byte 1"),
        (6, 255, "byte 6"),
        (7, 32, "byte 7"),
        (11, 16, "byte 1 of a sensor group holds 4 flags"),
        (16, 6, "charging state"),
    ],
)
def test_bytes_out_of_step_are_refused(place: int, value: int, words: str) -> None:
    reply = bytearray(REPLY)
    reply[place] = value
    with pytest.raises(DataError, match=words):
        Sensors.decode(bytes(reply))


@pytest.mark.parametrize("group", range(4))
@pytest.mark.parametrize("more", [-1, 1])
def test_a_group_of_the_wrong_size_is_refused(group: int, more: int) -> None:
    with pytest.raises(DataError, match=f"sensor group {group} has"):
        (Sensors, Contacts, Controls, PowerGroup)[group].decode(bytes(groups.GROUP_BYTES[group] + more))


def test_an_empty_battery_report_is_no_division_by_zero() -> None:
    assert PowerGroup().fraction == 0.0


FLAGS = st.booleans()
BYTES, SHORTS, UNSIGNED = st.integers(0, 255), st.integers(-(2**15), 2**15 - 1), st.integers(0, 2**16 - 1)
CONTACTS = st.builds(
    Contacts, **dict.fromkeys(groups.CONTACT_FLAGS, FLAGS), **dict.fromkeys(("dirt_left", "dirt_right"), BYTES)
)
CONTROLS = st.builds(Controls, BYTES, FLAGS, FLAGS, FLAGS, FLAGS, SHORTS, SHORTS)
POWER = st.builds(PowerGroup, st.integers(0, 5), UNSIGNED, SHORTS, st.integers(-128, 127), UNSIGNED, UNSIGNED)


@given(st.builds(Sensors, CONTACTS, CONTROLS, POWER))
def test_every_reading_survives_the_wire(sensors: Sensors) -> None:
    data = sensors.encode()
    assert len(data) == 26
    assert Sensors.decode(data) == sensors


@given(st.binary(min_size=26, max_size=26))
def test_bytes_are_refused_or_mean_themselves(data: bytes) -> None:
    try:
        sensors = Sensors.decode(data)
    except DataError:
        return
    assert sensors.encode() == data
