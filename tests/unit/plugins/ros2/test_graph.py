"""Keys, tokens and attachments: those of rmw_zenoh's design document, and as zenoh-ros2-sdk reads them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk.attachment import Attachment as SdkAttachment
from zenoh_ros2_sdk.discovery import _parse_liveliness_keyexpr
from zenoh_ros2_sdk.qos import QosProfile

from eal_actors.kernel.errors import DataError
from plugins.ros2 import graph
from plugins.ros2.graph import Attachment, Entity
from tests.unit.plugins.ros2 import hashes

STRING = "std_msgs::msg::dds_::String_"
HASH = f"RIHS01_{hashes.MESSAGES['std_msgs/msg/String']}"


def test_the_keys_of_the_design_document() -> None:
    assert graph.topic_key(0, "/chatter", STRING, HASH) == f"0/chatter/{STRING}/{HASH}"
    assert graph.topic_key(0, "/robot1/chatter", STRING, HASH) == f"0/robot1/chatter/{STRING}/{HASH}"


def test_the_tokens_of_the_design_document() -> None:
    session = "8b20917502ee955ac4476e0266340d5c"
    node = Entity(graph.NODE, session, 0, 0, "/", "talker")
    talker = Entity(graph.PUBLISHER, session, 0, 10, "/", "talker", "/chatter", STRING, HASH, graph.quality(depth=7))
    assert node.token(2) == f"@ros2_lv/2/{session}/0/0/NN/%/%/talker"
    assert talker.token(2) == f"@ros2_lv/2/{session}/0/10/MP/%/%/talker/%chatter/{STRING}/{HASH}/::,7:,:,:,,"


names = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)


@given(names, names, names, st.integers(0, 99))
def test_a_token_is_read_back_here_and_there(namespace: str, node: str, topic: str, number: int) -> None:
    entity = Entity(
        graph.SUBSCRIPTION, "abc", 1, number, f"/{namespace}", node, f"/{namespace}/{topic}", STRING, HASH,
        graph.quality(best_effort=True, transient_local=True, depth=5),
    )  # fmt: skip
    token = entity.token(3)
    assert graph.parse_token(token) == entity
    found = _parse_liveliness_keyexpr(token)
    assert found is not None
    assert (found["qualified_name"], found["node_name"], found["dds_type"]) == (entity.topic, node, STRING)
    quality = QosProfile.decode(entity.qos)
    assert (quality.reliability.name, quality.durability.name, quality.history_depth) == (
        "BEST_EFFORT", "TRANSIENT_LOCAL", 5
    )  # fmt: skip


@pytest.mark.parametrize(
    "token", ["", "@ros2_lv", "@ros2_lv/0/a/x/y/NN/%/%/n", "@ros2_lv/0/a/0/1/MP/%/%/n/%t", "a/" * 12]
)
def test_what_is_no_token_is_none(token: str) -> None:
    assert graph.parse_token(token) is None


def test_an_attachment_is_that_of_the_sdk() -> None:
    gid = bytes(range(16))
    assert Attachment(7, 123_456_789, gid).pack() == SdkAttachment(7, 123_456_789, gid).to_bytes()
    assert Attachment.unpack(SdkAttachment(7, 9, gid).to_bytes()) == Attachment(7, 9, gid)


@pytest.mark.parametrize("data", [b"", bytes(16), bytes(33), bytes(16) + b"\x0f" + bytes(16)])
def test_a_broken_attachment_is_a_data_error(data: bytes) -> None:
    with pytest.raises(DataError):
        Attachment.unpack(data)


def test_names() -> None:
    assert graph.full_name("/lab", "scan") == "/lab/scan"
    assert graph.full_name("/", "scan") == "/scan"
    assert graph.full_name("/lab", "/tf") == "/tf"
    for bad in ("", "a b", "1a", "a//b", "a/*", "a/**", "é"):
        with pytest.raises(ValueError, match="no ROS 2 name"):
            graph.check_name(bad)
