from __future__ import annotations

import json
from typing import Any

import pytest

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import METHODS, ResourceInfo, ResourceType, ValueInfo
from eal_actors.device.resource import Activity, Resource, command, config, config_setter, request, setting
from eal_actors.kernel.errors import ArgumentError, UnsupportedError
from eal_actors.plugin import EALPlugin, PluginError


class Arm(Resource):
    """An arm with a gripper.

    The rest of this text is not for lists.
    """

    types = ResourceType.ACTUATOR | ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, unit="rad", minimum=-1, maximum=1)

    def __init__(self) -> None:
        self.log: list[Any] = []

    def get_value(self) -> float:
        return 0.5

    @command("turn<degrees>", ValueInfo(DataType.DOUBLE, unit="deg", minimum=-90, maximum=90))
    def turn(self, degrees: float) -> Activity:
        """Turn the arm."""
        self.log.append(degrees)
        yield 1.0

    @command("grip")
    def grip(self) -> None:
        self.log.append("grip")

    @command("say<text>", ValueInfo(DataType.CHAR))
    def say(self, text: str) -> None:
        self.log.append(text)

    @command("mode", ValueInfo(DataType.CHAR, choices=("fast", "slow")))
    def mode(self, mode: str) -> int:
        self.log.append(mode)
        return 2

    @command("stop", urgent=True)
    def stop(self) -> None:
        """Stop."""

    @request("joint<number>", ValueInfo(DataType.DOUBLE, unit="rad"), ValueInfo(DataType.INT, minimum=0, maximum=3))
    def joint(self, number: int) -> float:
        return number / 10

    @config("speed", ValueInfo(DataType.DOUBLE, unit="rad/s", minimum=0, maximum=2))
    def speed(self) -> float:
        return 1.0

    @config("serial", ValueInfo(DataType.CHAR))
    def serial(self) -> str:
        return "A1"

    @config_setter("speed")
    def set_speed(self, value: float) -> None:
        self.log.append(("speed", value))


class FastArm(Arm):
    """An arm that overrides one command and adds another."""

    @command("stop", urgent=True)
    def stop(self) -> None:
        self.log.append("fast stop")

    @command("wave")
    def wave(self) -> None:
        self.log.append("wave")


def test_info_is_made_of_what_the_class_says() -> None:
    info = Arm().info()
    assert info.name == "Arm"
    assert info.description == "An arm with a gripper."
    assert info.types.names == ("SENSOR", "ACTUATOR")
    assert [m for m in METHODS if m in info.methods] == [
        "get_value",
        "send_req",
        "send_cmd",
        "get_config",
        "set_config",
    ]
    turn = info.commands[0]
    assert (turn.name, turn.prefix, turn.description) == ("turn<degrees>", "turn", "Turn the arm.")
    assert turn.describe() == "turn<degrees> (double -90..90 deg)"
    assert info.urgent_commands == {"stop"}
    assert [(c.name, c.writable) for c in info.configs] == [("speed", True), ("serial", False)]


@pytest.mark.parametrize(("req", "reads"), [("joint3", True), ("joint9", False), ("joint", False), ("fetch", False)])
def test_a_request_reads_if_it_is_declared(req: str, reads: bool) -> None:
    """With its argument too: `joint3` was taken for free text, which an observer may not send."""
    assert Arm().info().is_reading(req) is reads


def test_info_survives_json() -> None:
    info = Arm().info()
    assert ResourceInfo.from_dict(json.loads(json.dumps(info.to_dict()))) == info


def test_commands_reach_their_methods_with_python_values() -> None:
    arm = Arm()
    list(arm.send_cmd("turn-12.5"))
    list(arm.send_cmd("turn45"))
    arm.send_cmd("sayhello")
    assert arm.send_cmd("mode", EALData.of("slow")) == 2
    assert arm.log == [-12.5, 45.0, "hello", "slow"]
    assert arm.send_req("joint3") == 0.3
    arm.set_config("speed", EALData.of(2))
    assert arm.log[-1] == ("speed", 2)
    assert arm.get_config("serial") == "A1"


@pytest.mark.parametrize(
    ("cmd", "data", "message"),
    [
        ("turn91", None, "command 'turn91': its argument must be double -90..90 deg, not 91"),
        ("turn", None, "unknown command 'turn'"),
        ("turn1e999", None, "unknown command"),
        ("turnnan", None, "unknown command"),
        ("turn45", 3, "carries its argument in the text, but was given"),
        ("stop", 1, "command 'stop' takes no argument, but was given"),
        ("mode", None, "command 'mode' needs an argument: char fast|slow"),
        ("mode", "medium", "must be one of fast, slow, not 'medium'"),
        ("mode", 3, "must be char fast|slow, not"),
        ("stpo", None, "did you mean 'stop'"),
    ],
)
def test_a_wrong_command_says_what_was_meant(cmd: str, data: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message.replace("|", r"\|")):
        Arm().send_cmd(cmd, None if data is None else EALData.of(data))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("speed", 3.0, "configuration key 'speed' must be double 0..2 rad/s, not 3"),
        ("speed", "fast", "must be double"),
        ("speed", None, "needs a value"),
        ("serial", "B2", "is read-only"),
        ("sped", 1.0, "did you mean 'speed'"),
    ],
)
def test_a_wrong_configuration_says_what_was_meant(key: str, value: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Arm().set_config(key, None if value is None else EALData.of(value))


def test_a_subclass_inherits_overrides_and_adds() -> None:
    arm = FastArm()
    arm.send_cmd("stop")
    arm.send_cmd("wave")
    arm.send_cmd("grip")
    assert arm.log[:2] == ["fast stop", "wave"]
    assert "wave" not in [c.name for c in Arm().info().commands]


class Waving:
    """A mixin with a command."""

    @command("wave")
    def wave(self) -> None:
        """Wave."""


class Mixed(Waving, Arm):
    """Overrides a command without saying so again."""

    def grip(self) -> None:
        self.log.append("mixed grip")


def test_mixins_and_plain_overrides_keep_their_commands() -> None:
    arm = Mixed()
    arm.send_cmd("wave")
    arm.send_cmd("grip")
    assert arm.log == ["mixed grip"]
    assert {"wave", "grip", "stop"} <= {c.name for c in arm.info().commands}


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda: command("stop<seconds>", ValueInfo(DataType.DOUBLE), urgent=True), "known by its whole text"),
        (lambda: command("to<metres", ValueInfo(DataType.DOUBLE)), "must be at its end"),
        (lambda: command("<metres>to", ValueInfo(DataType.DOUBLE)), "must be at its end"),
        (lambda: command("to<metres>"), "needs a ValueInfo"),
        (lambda: request("joint", argument=ValueInfo(DataType.INT)), "nothing but its text"),
    ],
)
def test_a_command_that_could_never_be_called_is_refused_where_it_is_declared(declare: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        declare()


def test_one_command_for_two_methods_is_refused() -> None:
    with pytest.raises(ArgumentError, match="Twice: first and second are both command 'go'"):

        class Twice(Resource):
            @command("go")
            def first(self) -> None: ...

            @command("go")
            def second(self) -> None: ...


def test_a_resource_takes_its_name_from_the_framework() -> None:
    arm = Arm()
    arm.name = "Left.Arm"
    assert arm.info().name == "Left.Arm"
    with pytest.raises(UnsupportedError, match=r"Left\.Arm does not support read_comm; it supports get_value,"):
        arm.read_comm(1)


@pytest.mark.parametrize(
    ("info", "value", "problem"),
    [
        (ValueInfo(DataType.INT), 5, None),
        (ValueInfo(DataType.DOUBLE), 5, None),
        (ValueInfo(DataType.FLOAT), 2.5, None),
        (ValueInfo(DataType.INT), 2.5, "must be int"),
        (ValueInfo(DataType.BOOL), 1, "must be bool"),
        (ValueInfo(DataType.INT), True, "must be int"),
        (ValueInfo(DataType.DOUBLE, minimum=0), float("nan"), "must be double"),
        (ValueInfo(DataType.DOUBLE, minimum=0), -0.1, r"must be double 0\.\."),
        (ValueInfo(DataType.DOUBLE), [1.0, 2.0], "must be double"),
        (ValueInfo(DataType.DOUBLE, shape=(2,)), [1.0, 2.0], None),
        (ValueInfo(DataType.DOUBLE, shape=(None,)), [1.0, 2.0, 3.0], None),
        (ValueInfo(DataType.DOUBLE, shape=(3,)), [1.0, 2.0], r"not of shape \(2,\)"),
        (ValueInfo(DataType.DOUBLE, shape=(3,)), 1.0, r"not of shape \(\)"),
        (ValueInfo(DataType.VOID), b"raw", None),
        (ValueInfo(DataType.CHAR), "text", None),
    ],
)
def test_values_are_held_against_what_is_said_of_them(info: ValueInfo, value: Any, problem: str | None) -> None:
    data = EALData.of(value)
    if problem is None:
        info.check(data, "it")
    else:
        with pytest.raises(ArgumentError, match=problem):
            info.check(data, "it")


def test_the_two_forms_of_eal_plugin() -> None:
    assert EALPlugin("A", "B").list_resources() == ("A", "B")
    assert EALPlugin(1, "A", "beyond the count").list_resources() == ("A",)


@pytest.mark.parametrize(("names", "message"), [((), "no resource"), (("A", "A"), "A twice"), ((3, "A"), "promised 3")])
def test_an_eal_plugin_that_cannot_be(names: tuple[Any, ...], message: str) -> None:
    with pytest.raises(PluginError, match=message):
        EALPlugin(*names)


class Lamp(Resource):
    """A lamp whose settings are attributes."""

    level: float = setting(ValueInfo(DataType.DOUBLE, maximum=1), "Brightness.")
    mode: str = setting(ValueInfo(DataType.CHAR, choices=("on", "off")), "Whether it shines.")

    def __init__(self) -> None:
        self.level = 0.5


class DimLamp(Lamp):
    level: float = setting(ValueInfo(DataType.DOUBLE, maximum=0.8), "Brightness.")


def test_a_setting_is_an_attribute_and_a_configuration_key() -> None:
    lamp = Lamp()
    assert [(key.name, key.writable, key.description) for key in lamp.info().configs] == [
        ("level", True, "Brightness."),
        ("mode", True, "Whether it shines."),
    ]
    assert lamp.get_config("level") == 0.5
    lamp.set_config("level", EALData.of(1))
    assert (lamp.level, type(lamp.level)) == (1.0, float)
    with pytest.raises(ArgumentError, match=r"must be double \.\.1, not 2"):
        lamp.set_config("level", EALData.of(2.0))
    assert Lamp().level == 0.5


def test_a_subclass_narrows_a_setting() -> None:
    with pytest.raises(ArgumentError, match=r"must be double \.\.0\.8, not 1"):
        DimLamp().set_config("level", EALData.of(1.0))


def test_a_setting_without_a_first_value_names_its_class() -> None:
    with pytest.raises(AttributeError, match="Lamp gives its setting 'mode' no first value"):
        Lamp().get_config("mode")


def test_a_refused_text_is_cut_short_in_the_message() -> None:
    """A value of megabytes went whole into the error, and with it to the log and to each page of the dashboard."""
    info = ValueInfo(DataType.DOUBLE, shape=(2,))
    assert len(str(info.problem(EALData.of("x" * 1_000_000)))) < 200
    modes = ValueInfo(DataType.CHAR, choices=("fast", "slow"))
    assert len(str(modes.problem(EALData.of("x" * 1_000_000)))) < 200


def test_a_shape_that_is_no_tuple_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"shape must be a tuple, such as \(3,\), not None"):
        ValueInfo(DataType.DOUBLE, shape=None)  # type: ignore[arg-type]
