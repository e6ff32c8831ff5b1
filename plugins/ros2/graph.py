"""Names of the ROS 2 graph as rmw_zenoh maps them to zenoh: keys, liveliness tokens, attachments.

Pure functions. A topic or service has the key `<domain>/<name>/<type>/<hash>`. Each node and endpoint declares a token
`@ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/<namespace>/<node name>`, which an endpoint continues by
`/<name>/<type>/<hash>/<QoS>`; slashes in names become `%`.

Source: ros2/rmw_zenoh, docs/design.md; attachments as rmw_zenoh_cpp of Jazzy and later writes them.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Final

from eal_actors.plugin import DataError

from .message_types import ros_name

NODE, PUBLISHER, SUBSCRIPTION, SERVICE, CLIENT = "NN", "MP", "MS", "SS", "SC"
"""The kinds of entities."""

_ADMIN: Final = "@ros2_lv"
_HEAD: Final = struct.Struct("<qqB")
GID_BYTES: Final = 16
"""Length of the id of a publisher or client in attachments."""
_NAME: Final = re.compile(r"^~?/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$")


def check_name(name: str) -> str:
    """Return a topic, service or node name, or raise ValueError (Source: design.ros2.org, topic and service names)."""
    if not _NAME.match(name):
        raise ValueError(f"{name!r} is no ROS 2 name: use letters, digits, _ and /, such as scan or /tf")
    return name


def full_name(namespace: str, name: str) -> str:
    """Return the fully qualified name: a relative one is in the namespace."""
    if name.startswith("/"):
        return name
    return "/".join(["", *(part for part in (*namespace.split("/"), name) if part)])


def topic_key(domain: int, name: str, type_name: str, type_hash: str) -> str:
    """Return the key of a topic or service: its full name, and its type such as `std_msgs::msg::dds_::String_`."""
    return f"{domain}/{name.strip('/')}/{type_name}/{type_hash}"


def mangle(name: str) -> str:
    """Return a name with `%` for each slash; an empty one becomes `%`."""
    return name.replace("/", "%") or "%"


def quality(*, best_effort: bool = False, transient_local: bool = False, depth: int = 10) -> str:
    """Return the QoS as tokens carry it: fields that have their default are empty."""
    return f"{2 if best_effort else ''}:{1 if transient_local else ''}:,{depth}:,:,:,,"


@dataclass(frozen=True, slots=True)
class Entity:
    """A node, or an endpoint of one.

    Attributes:
        kind: NODE, PUBLISHER, SUBSCRIPTION, SERVICE or CLIENT.
        session: id of the zenoh session.
        node_id: number of the node in the session.
        entity_id: number of the entity in the session.
        namespace: of the node, such as `/lab`; `/` for none.
        topic: fully qualified name of the topic or service; empty for a node, like the rest.
        type_name: as in keys.
        qos: see `quality`.
    """

    kind: str
    session: str
    node_id: int
    entity_id: int
    namespace: str
    node: str
    topic: str = ""
    type_name: str = ""
    type_hash: str = ""
    qos: str = ""

    def token(self, domain: int) -> str:
        """Return its liveliness token."""
        namespace = "" if self.namespace == "/" else self.namespace
        head = (
            f"{_ADMIN}/{domain}/{self.session}/{self.node_id}/{self.entity_id}/{self.kind}/"
            f"%/{mangle(namespace)}/{mangle(self.node)}"
        )
        if self.kind == NODE:
            return head
        return f"{head}/{mangle(self.topic)}/{self.type_name}/{self.type_hash}/{self.qos}"

    def describe_type(self) -> str:
        """Return its type for people, with the beginning of its hash."""
        return f"{ros_name(self.type_name)} ({self.type_hash[:15]})"


def all_tokens(domain: int) -> str:
    """Return the key expression of all tokens of a domain."""
    return f"{_ADMIN}/{domain}/**"


def parse_token(key: str) -> Entity | None:
    """Return the entity of a token; None for what is no token."""
    parts = key.split("/")
    if len(parts) not in (9, 13) or parts[0] != _ADMIN or (len(parts) == 9) != (parts[5] == NODE):
        return None
    try:
        node_id, entity_id = int(parts[3]), int(parts[4])
    except ValueError:
        return None
    namespace, node, *rest = (part.replace("%", "/") for part in parts[7:])
    return Entity(parts[5], parts[2], node_id, entity_id, namespace or "/", node, *rest)


@dataclass(frozen=True, slots=True)
class Attachment:
    """The attachment of each message, request and response.

    Attributes:
        sequence: counts the messages of a publisher, or the requests of a client.
        stamp_ns: when it was sent, in nanoseconds since 1970.
        gid: id of the publisher or client, 16 bytes.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def pack(self) -> bytes:
        """Return its bytes."""
        return _HEAD.pack(self.sequence, self.stamp_ns, len(self.gid)) + self.gid

    @classmethod
    def unpack(cls, data: bytes) -> Attachment:
        """Return the attachment in bytes.

        Raises:
            DataError: they are none.
        """
        if len(data) != _HEAD.size + GID_BYTES or data[_HEAD.size - 1] != GID_BYTES:
            raise DataError(f"{len(data)} bytes are no attachment of rmw_zenoh")
        sequence, stamp_ns, _ = _HEAD.unpack_from(data)
        return cls(sequence, stamp_ns, data[_HEAD.size :])
