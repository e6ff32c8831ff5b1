"""Types: hashes as published ones, CDR, definitions of one's own, and what is refused."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from eal_actors.kernel.errors import ArgumentError, DataError, PluginError
from plugins.ros2.message_types import MessageType, MessageTypes
from tests.unit.plugins.ros2 import hashes

TYPES = MessageTypes("jazzy")


@pytest.mark.parametrize(("name", "published"), hashes.MESSAGES.items())
def test_a_message_has_the_published_hash(name: str, published: str) -> None:
    assert TYPES.message(name).type_hash == f"RIHS01_{published}"


@pytest.mark.parametrize(("name", "published"), hashes.SERVICES.items())
def test_a_service_has_the_published_hash(name: str, published: str) -> None:
    assert TYPES.service(name).type_hash == f"RIHS01_{published}"


def test_humble_has_no_hashes() -> None:
    humble = MessageTypes("humble")
    assert {humble.message("std_msgs/String").type_hash, humble.service("std_srvs/SetBool").type_hash} == {
        "TypeHashNotSupported"
    }


def test_bytes_are_those_of_cdr() -> None:
    """The bytes of `ros2 topic pub /chatter std_msgs/String`: little-endian CDR, length with the zero, text, zero."""
    data = TYPES.message("std_msgs/msg/String").encode({"data": "hello"})
    assert data.hex() == "00010000" + "06000000" + b"hello\0".hex()


def test_a_definition_of_ones_own(tmp_path: Path) -> None:
    for name, text in {
        "msg/Level.msg": "# a comment\nuint8 FULL=1\nstd_msgs/Header header\nfloat32[3] parts\nstring<=5[] names\n",
        "srv/Fill.srv": "my_msgs/Level level\n---\nbool done\n",
        "action/Pour.action": "float64 amount\n---\nfloat64 poured\n---\nfloat64 left\n",
    }.items():
        (tmp_path / "my_msgs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "my_msgs" / name).write_text(text)
    types = MessageTypes("jazzy", tmp_path)
    level = types.message("my_msgs/Level")
    message = level.decode(level.encode({"parts": [1, 2, 3], "names": ["a", "bc"]}))
    assert level.to_dict(message)["parts"] == [1.0, 2.0, 3.0]
    assert level.to_dict(message)["names"] == ["a", "bc"]
    assert types.service("my_msgs/Fill").request.encode({"level": {"header": {"frame_id": "x"}}})
    assert types.action("my_msgs/Pour").feedback.encode({"feedback": {"left": 1.5}})


def test_a_wrong_definition_names_its_file(tmp_path: Path) -> None:
    (tmp_path / "p" / "srv").mkdir(parents=True)
    (tmp_path / "p" / "srv" / "Bad.srv").write_text("int32 a\n")
    with pytest.raises(PluginError, match=r"p/srv/Bad: .* needs 2 parts"):
        MessageTypes("jazzy", tmp_path).service("p/srv/Bad")
    with pytest.raises(PluginError, match="no folder"):
        MessageTypes("jazzy", tmp_path / "none")


def test_an_unknown_type_is_named_with_near_ones() -> None:
    with pytest.raises(
        PluginError, match=r"unknown ROS 2 type 'geo_msgs/msg/Twist'; did you mean geometry_msgs/msg/Twist\?"
    ):
        TYPES.message("geo_msgs/Twist")


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"linear": {"q": 1}}, "no field 'q'"),
        ({"linear": {"x": "fast"}}, "does not fit"),
        ({"linear": 5}, "needs fields by name"),
    ],
)
def test_fields_that_do_not_fit_are_refused(fields: dict[str, object], problem: str) -> None:
    with pytest.raises(ArgumentError, match=problem):
        TYPES.message("geometry_msgs/msg/Twist").encode(fields)


@pytest.mark.parametrize("name", ["nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/LaserScan"])
def test_broken_bytes_are_a_data_error(name: str) -> None:
    """Bits flipped, bytes dropped and doubled: a message or a DataError, nothing else, and quickly."""
    kind, chance = TYPES.message(name), random.Random(24)  # noqa: S311
    nested = (
        {"transforms": [{"child_frame_id": "base"}]} if name.endswith("TFMessage") else {"header": {"frame_id": "odom"}}
    )
    whole = kind.encode(nested)
    for number in range(100):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            place = chance.randrange(len(data))
            match chance.randrange(3):
                case 0:
                    data[place] ^= 1 << chance.randrange(8)
                case 1 if len(data) > 1:
                    del data[place]
                case _:
                    data[place:place] = data[place : place + 4]
        try:
            json.dumps(kind.to_dict(kind.decode(bytes(data))), allow_nan=False)
        except DataError:
            pass
        except Exception as error:
            raise AssertionError(f"case {number}: {data.hex()}") from error


def test_a_bag_of_our_messages_is_read_back(tmp_path: Path) -> None:
    """The bag is written and read by rosbags, with the definitions and hashes that `ros2 bag` looks at."""
    twist, scan = TYPES.message("geometry_msgs/msg/Twist"), TYPES.message("sensor_msgs/msg/LaserScan")
    sent: dict[str, tuple[MessageType, dict[str, Any]]] = {
        "/cmd_vel": (twist, {"linear": {"x": 0.25}, "angular": {"z": -1.5}}),
        "/scan": (scan, {"header": {"frame_id": "laser"}, "range_max": 8.0, "ranges": [1.0, 2.5, 8.0]}),
    }
    with Writer(tmp_path / "bag", version=9) as writer:
        for number, (topic, (kind, fields)) in enumerate(sent.items()):
            connection = writer.add_connection(topic, kind.name, typestore=TYPES.store)
            writer.write(connection, number, kind.encode(fields))
    with Reader(tmp_path / "bag") as reader:
        found = {connection.topic: (connection, data) for connection, _, data in reader.messages()}
    for topic, (kind, fields) in sent.items():
        connection, data = found[topic]
        assert (connection.msgtype, connection.digest) == (kind.name, kind.type_hash)
        plain = kind.to_dict(get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, kind.name))
        assert plain.items() >= {name: value for name, value in fields.items() if not isinstance(value, dict)}.items()
