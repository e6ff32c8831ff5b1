"""Holds one call's arguments against what the resource says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from eal_actors.device.data import EALData, ValueInfo
from eal_actors.device.info import METHODS, ResourceInfo
from eal_actors.kernel.errors import ArgumentError


def method_problem(method: str, info: ResourceInfo) -> str | None:
    """Return why a resource cannot be called so, or None."""
    if method == "halt" or method in info.methods:
        return None
    supported = ", ".join(name for name in METHODS if name in info.methods) or "nothing"
    return f"{info.name} does not support {method}; it supports {supported}"


def check_arguments(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> None:
    """Check what a method is given, as far as the resource says what it takes.

    Raises:
        ArgumentError: an unknown command, request or key, or an argument that does not fit.
        DataError: a value that no EALData can hold.
    """
    if method == "send_cmd" and info.commands:
        info.parse_command(str(given["cmd"]), EALData.of(given["data"]) if "data" in given else None)
    elif method == "send_req" and info.requests:
        info.parse_request(str(given["req"]))
    elif method == "get_config" and info.configs:
        info.config(str(given["key"]))
    elif method == "set_config" and info.configs:
        _check_config(info, str(given["key"]), EALData.of(given["value"]) if "value" in given else None)
    elif method == "set_value":
        data = EALData.of(given["value"])
        if info.value is not None:
            info.value.check(data, "its value")
    elif method == "write_comm":
        EALData.of(given["data"])


def answer_info(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> ValueInfo | None:
    """Return what a resource says of its answer to a call that it takes, or None if it says nothing."""
    if method == "get_value":
        return info.value
    if method == "send_req" and info.requests:
        return info.parse_request(str(given["req"]))[0].returns
    if method == "get_config" and info.configs:
        return info.config(str(given["key"])).value
    return None


def _check_config(info: ResourceInfo, key: str, data: EALData | None) -> None:
    config = info.config(key)
    if not config.writable:
        raise ArgumentError(f"configuration key {key!r} is read-only")
    if data is None:
        raise ArgumentError(f"configuration key {key!r} needs a value: {config.value.describe()}")
    config.value.check(data, f"configuration key {key!r}")
