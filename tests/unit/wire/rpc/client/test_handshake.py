from __future__ import annotations

from typing import Any

import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from eal_actors.device.data import DataType
from eal_actors.device.info import METHODS, CommandInfo, ConfigInfo, ResourceInfo, ResourceType, ValueInfo
from eal_actors.kernel.errors import ProtocolError
from eal_actors.wire.format import messages as wire
from eal_actors.wire.rpc.client.handshake import info_from

ANGLE = ValueInfo(DataType.DOUBLE, "deg", 0, 359.5, description="to the left")
WHEELS = ResourceInfo(
    name="arm.Wheels",
    types=ResourceType.ACTUATOR | ResourceType.SENSOR,
    methods=frozenset({"send_cmd", "get_value", "get_config"}),
    value=ValueInfo(DataType.INT, choices=(1, 2), shape=(None, 3)),
    commands=(CommandInfo("r<degrees>", ANGLE), CommandInfo("s", urgent=True, description="stop")),
    requests=(CommandInfo("pose", returns=ValueInfo(DataType.CHAR, choices=("a", "b"))),),
    configs=(ConfigInfo("gain", ANGLE, writable=False),),
    description="two wheels",
)

TEXTS = st.text(max_size=8)
NUMBERS = st.integers(-1000, 1000) | st.floats(-1e3, 1e3)
VALUES = st.builds(
    ValueInfo,
    st.sampled_from(DataType),
    st.none() | TEXTS,
    st.none() | NUMBERS,
    st.none() | NUMBERS,
    st.lists(TEXTS | NUMBERS, max_size=3).map(tuple),
    st.lists(st.none() | st.integers(0, 9), max_size=3).map(tuple),
    TEXTS,
)
COMMANDS = st.lists(
    st.builds(CommandInfo, TEXTS, st.none() | VALUES, st.none() | VALUES, st.booleans(), TEXTS), max_size=3
)
INFOS = st.builds(
    ResourceInfo,
    TEXTS.filter(bool),
    st.integers(1, 15).map(ResourceType),
    st.frozensets(st.sampled_from(METHODS)),
    st.none() | VALUES,
    COMMANDS.map(tuple),
    COMMANDS.map(tuple),
    st.lists(st.builds(ConfigInfo, TEXTS, VALUES, st.booleans(), TEXTS), max_size=3).map(tuple),
    TEXTS,
)


def carried(info: ResourceInfo) -> dict[str, Any]:
    answer = wire.decode_reply(*wire.encode_reply(wire.CallReply(1, info.to_dict()))).answer
    assert isinstance(answer, dict)
    return answer


def test_a_full_information_arrives_as_it_left() -> None:
    back = info_from(carried(WHEELS))
    assert back == WHEELS
    assert [c.describe() for c in back.commands] == ["r<degrees> (double 0..359.5 deg)", "s"]
    assert back.urgent_commands == {"s"}


@given(INFOS)
def test_every_information_arrives_as_it_left(info: ResourceInfo) -> None:
    assert info_from(carried(info)) == info


def test_what_later_versions_add_is_passed_over() -> None:
    fields = carried(WHEELS)
    fields["methods"].append("fly")
    fields["new"] = fields["value"]["new"] = fields["commands"][0]["new"] = 1
    assert info_from(fields) == WHEELS


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": 5}, "name: Input should be a valid string"),
        ({"name": ""}, "name: String should have at least 1 character"),
        ({"types": ["WEAPON"]}, "there is no type 'WEAPON'"),
        ({"value": {"type": "INT"}}, "value.unit: Field required"),
        ({"commands": [{"name": "s"}]}, "commands.0.argument: Field required"),
        ({"configs": None}, "configs: Input should be a valid list"),
    ],
)
def test_a_wrong_information_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ProtocolError, match=message):
        info_from(WHEELS.to_dict() | change)


@given(st.recursive(st.none() | st.integers() | st.text() | st.binary(), lambda inner: st.lists(inner)))
def test_what_is_no_information_is_refused(fields: object) -> None:
    with pytest.raises(ProtocolError, match="information of a resource"):
        info_from(fields)


@example("methods", [""])
@given(st.sampled_from(list(WHEELS.to_dict())), st.none() | st.integers() | st.lists(st.text() | st.integers()))
def test_a_changed_field_is_refused_or_understood(name: str, field: object) -> None:
    fields = msgpack.unpackb(msgpack.packb(WHEELS.to_dict())) | {name: field}
    try:
        info = info_from(fields)
    except ProtocolError:
        return
    assert info_from(info.to_dict()) == info
