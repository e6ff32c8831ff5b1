"""The types of ROS 2 messages, services and actions: their hashes, and CDR, by rosbags.

A service is described by three messages and an action by two services and a message, as rosidl generates them; rosbags
knows messages only. In ROS 2 `char` is an unsigned 8-bit integer, also in hashes.

Source: REP-2011 (type hashes), rosidl (service and action types).
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from eal_actors.plugin import ArgumentError, DataError, PluginError

from .definitions import ACTIONS, SERVICES
from .field_values import DTYPES, numbers, plain, scalar

NO_HASH: Final = "TypeHashNotSupported"
"""The hash of every type in ROS 2 Humble, which has none."""

_Definition = TypeVar("_Definition")

STORES: Final = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
}
"""The distributions, and their definitions in rosbags."""

_EVENT_INFO: Final = "service_msgs/msg/ServiceEventInfo"
_UUID: Final = "unique_identifier_msgs/msg/UUID"
_BROKEN: Final = (
    SerdeError, AssertionError, struct.error, ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError
)  # fmt: skip
"""The errors of rosbags' generated code for bytes or fields that do not fit."""

Field = tuple[str, tuple[Any, Any]]


class MessageType:
    """One message type.

    Attributes:
        name: such as `std_msgs/msg/String`.
        type_hash: its hash, `RIHS01_...`.
        dds_name: its name in keys, `std_msgs::msg::dds_::String_`.
    """

    def __init__(self, types: MessageTypes, name: str) -> None:
        self._types = types
        self._store = types.store
        self.name: Final = name
        self.type_hash: Final = types.hash_of(name)
        self.dds_name: Final = dds_name(name)
        self.decode(self.encode({}))  # rosbags generates its code on first use, which takes milliseconds

    def encode(self, fields: Mapping[str, Any]) -> bytes:
        """Return the CDR of a message; missing fields are zero or empty.

        Raises:
            ArgumentError: a field is unknown, or a value does not fit it.
        """
        try:
            return bytes(self._store.serialize_cdr(self._build(self.name, fields), self.name))
        except _BROKEN as error:
            raise ArgumentError(f"{self.name}: a value does not fit its field: {error}") from error

    def decode(self, data: bytes) -> Any:
        """Return the message in CDR bytes, with its fields as attributes.

        Raises:
            DataError: the bytes are no such message.
        """
        try:
            return self._store.deserialize_cdr(data, self.name)
        except (*_BROKEN, MemoryError) as error:
            raise DataError(f"{len(data)} bytes are no {self.name}: {str(error) or type(error).__name__}") from error

    def to_dict(self, message: Any) -> dict[str, Any]:
        """Return a message as a dictionary of plain values; NaN and infinity become None."""
        return {name: plain(getattr(message, name)) for name, _ in self._types.fields(self.name)}

    def _build(self, name: str, given: Any) -> Any:
        """Return a message of a type, from its fields by name."""
        if not isinstance(given, Mapping):
            raise ArgumentError(f"{name} needs fields by name, not {type(given).__name__}")
        fields = self._types.fields(name)
        if unknown := set(given) - {field for field, _ in fields}:
            known = ", ".join(field for field, _ in fields)
            raise ArgumentError(f"{name} has no field {min(unknown)!r}; it has {known}")
        return self._store.types[name](**{field: self._value(kind, given.get(field)) for field, kind in fields})

    def _value(self, kind: tuple[Any, Any], given: Any) -> Any:
        node, rest = kind
        if node is Nodetype.NAME:
            return self._build(rest, {} if given is None else given)
        if node is Nodetype.BASE:
            return scalar(rest[0], given)
        inner, length = rest
        if given is None:
            items: Any = [None] * (length if node is Nodetype.ARRAY else 0)
        else:
            items = given
        if inner[0] is Nodetype.BASE and (dtype := DTYPES.get(inner[1][0])) is not None:
            return numbers(items, dtype)
        return [self._value(inner, item) for item in items]


class ServiceType:
    """One service type: its request and response.

    Attributes:
        name: such as `std_srvs/srv/SetBool`.
    """

    def __init__(self, types: MessageTypes, name: str) -> None:
        self.name: Final = name
        self.type_hash: Final = types.hash_of(name)
        self.dds_name: Final = dds_name(name)
        self.request: Final = MessageType(types, f"{name}_Request")
        self.response: Final = MessageType(types, f"{name}_Response")


class ActionType:
    """One action type: the services that start it and return its result, and its feedback.

    Attributes:
        send_goal: the service of `_action/send_goal`.
        get_result: the service of `_action/get_result`.
        feedback: the message of `_action/feedback`.
    """

    def __init__(self, types: MessageTypes, name: str) -> None:
        self.send_goal: Final = ServiceType(types, f"{name}_SendGoal")
        self.get_result: Final = ServiceType(types, f"{name}_GetResult")
        self.feedback: Final = MessageType(types, f"{name}_FeedbackMessage")


class MessageTypes:
    """The types of one distribution, and those of a folder.

    Args:
        distribution: a key of STORES.
        folder: with `<package>/msg/<Name>.msg`, `<package>/srv/<Name>.srv` and `<package>/action/<Name>.action`.

    Raises:
        PluginError: a file of the folder is no definition.

    Thread: any.
    """

    def __init__(self, distribution: str = "jazzy", folder: Path | None = None) -> None:
        self.lock: Final = threading.RLock()
        self.store: Final = get_typestore(STORES[distribution])
        self._has_hashes = distribution != "humble"
        self._hashes: dict[str, str] = {}
        self._messages: dict[str, MessageType] = {}
        self._services = dict(SERVICES)
        self._actions = dict(ACTIONS)
        if folder is not None:
            self._read_folder(folder)
        if _EVENT_INFO not in self.store.fielddefs:  # Humble has none
            text = "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number"
            self._register(text, _EVENT_INFO)

    def message(self, name: str) -> MessageType:
        """Return a message type by its name; `std_msgs/String` is short for `std_msgs/msg/String`.

        Raises:
            PluginError: there is no such type.
        """
        name = _full_name(name, "msg")
        with self.lock:
            _known(name, self.store.fielddefs)
            if name not in self._messages:
                self._messages[name] = MessageType(self, name)
            return self._messages[name]

    def service(self, name: str) -> ServiceType:
        """Return a service type by its name.

        Raises:
            PluginError: there is no such type.
        """
        name = _full_name(name, "srv")
        with self.lock:
            request, response = (_parsed(text, name)[1] for text in _parts(_known(name, self._services), 2, name))
            self._define_service(name, request, response)
            return ServiceType(self, name)

    def action(self, name: str) -> ActionType:
        """Return an action type by its name.

        Raises:
            PluginError: there is no such type.
        """
        name = _full_name(name, "action")
        with self.lock:
            parts = _parts(_known(name, self._actions), 3, name)
            for part, text in zip(("Goal", "Result", "Feedback"), parts, strict=True):
                self._register(text, f"{name}_{part}")
            goal_id = "goal_id", (Nodetype.NAME, _UUID)
            stamp = "stamp", (Nodetype.NAME, "builtin_interfaces/msg/Time")
            nested = {
                part: (part.lower(), (Nodetype.NAME, f"{name}_{part}")) for part in ("Goal", "Result", "Feedback")
            }
            self._define_service(
                f"{name}_SendGoal", [goal_id, nested["Goal"]], [("accepted", (Nodetype.BASE, ("bool", 0))), stamp]
            )
            self._define_service(
                f"{name}_GetResult", [goal_id], [("status", (Nodetype.BASE, ("int8", 0))), nested["Result"]]
            )
            self._add({f"{name}_FeedbackMessage": ([], [goal_id, nested["Feedback"]])})
            return ActionType(self, name)

    def fields(self, name: str) -> list[Field]:
        """Return the fields of a message type, without the filler of an empty one."""
        found: list[Field] = self.store.fielddefs[name][1]
        return found

    def hash_of(self, name: str) -> str:
        """Return the hash of a registered type."""
        with self.lock:
            if not self._has_hashes:
                return NO_HASH
            if name not in self._hashes:
                self._hashes[name] = self.store.hash_rihs01(name)
            return self._hashes[name]

    def _define_service(self, name: str, request: list[Field], response: list[Field]) -> None:
        """Register a service as rosidl describes it: by its request, its response and its event."""
        parts = {part: (Nodetype.NAME, f"{name}_{part}") for part in ("Request", "Response", "Event")}
        event: list[Field] = [("info", (Nodetype.NAME, _EVENT_INFO))]
        event += [(part.lower(), (Nodetype.SEQUENCE, (parts[part], 1))) for part in ("Request", "Response")]
        whole: list[Field] = [(f"{part.lower()}_message", kind) for part, kind in parts.items()]
        names = f"{name}_Request", f"{name}_Response", f"{name}_Event", name
        self._add({key: ([], fields) for key, fields in zip(names, (request, response, event, whole), strict=True)})

    def _register(self, text: str, name: str) -> None:
        """Register a message by its definition; raises PluginError if the text is none."""
        self._add({name: _parsed(text, name)})

    def _add(self, types: dict[str, Any]) -> None:
        new = {name: definition for name, definition in types.items() if name not in self.store.fielddefs}
        if new:
            self.store.register(new)
        for name, (constants, fields) in list(self.store.fielddefs.items()):
            if name in types or name == _EVENT_INFO:
                self.store.fielddefs[name] = constants, [(field, _with_octets(node)) for field, node in fields]

    def _read_folder(self, folder: Path) -> None:
        if not folder.is_dir():
            raise PluginError(f"messages: there is no folder {folder}")
        for name, file in _definition_files(folder):
            try:
                text = file.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                raise PluginError(f"messages: {file} cannot be read: {error}") from error
            if file.suffix == ".msg":
                self._register(text, name)
            elif file.suffix == ".srv":
                self._services[name] = text
            else:
                self._actions[name] = text


def _parsed(text: str, name: str) -> tuple[list[Any], list[Field]]:
    """Return constants and fields of a definition.

    Raises:
        PluginError: the text is no definition.
    """
    package, last = name.split("/")[0], name.rpartition("/")[2]
    try:
        ((_, definition),) = get_types_from_msg(text + "\n", f"{package}/msg/{last}").items()
    except (TypesysError, ValueError, IndexError) as error:
        raise PluginError(f"{name}: its definition is invalid: {error}") from error
    found: tuple[list[Any], list[Field]] = definition
    return found


def dds_name(name: str) -> str:
    """Return the name of a type in keys: `std_msgs::msg::dds_::String_` for `std_msgs/msg/String`."""
    package, kind, last = name.split("/")
    return f"{package}::{kind}::dds_::{last}_"


def ros_name(name: str) -> str:
    """Return the name of a type from that in keys; the inverse of `dds_name`."""
    return name.replace("::dds_::", "::").replace("::", "/").removesuffix("_")


def _definition_files(folder: Path) -> Iterator[tuple[str, Path]]:
    for kind in ("msg", "srv", "action"):
        for file in sorted(folder.glob(f"*/{kind}/*.{kind}")):
            yield f"{file.parent.parent.name}/{kind}/{file.stem}", file


def _full_name(name: str, kind: str) -> str:
    package, _, rest = name.partition("/")
    return name if rest.count("/") else f"{package}/{kind}/{rest}"


def _parts(text: str, count: int, name: str) -> list[str]:
    parts: list[list[str]] = [[]]
    for line in text.splitlines():
        if line.strip() == "---":
            parts.append([])
        else:
            parts[-1].append(line)
    if len(parts) != count:
        raise PluginError(f"{name}: its definition needs {count} parts with --- between them, not {len(parts)}")
    return ["\n".join(part) for part in parts]


def _known(name: str, known: Mapping[str, _Definition]) -> _Definition:
    """Return the definition of a type; raise PluginError, with types of similar names, if there is none."""
    if name in known:
        return known[name]
    last = name.rpartition("/")[2].lower()
    near = [other for other in sorted(known) if other.rpartition("/")[2].lower() == last][:3]
    hint = f"; did you mean {', '.join(near)}?" if near else "; give its definition in the folder `messages`"
    raise PluginError(f"unknown ROS 2 type {name!r}{hint}")


def _with_octets(node: Any) -> Any:
    """Return a field's type with `uint8` in place of `char`."""
    kind, rest = node
    if kind is Nodetype.BASE:
        return (kind, ("uint8", rest[1])) if rest[0] == "char" else node
    return node if kind is Nodetype.NAME else (kind, (_with_octets(rest[0]), rest[1]))
