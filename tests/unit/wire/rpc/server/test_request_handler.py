"""A robot that no controller could know is not served."""

from __future__ import annotations

import pytest

from eal_actors.device.info import ResourceInfo, ResourceType
from eal_actors.kernel.errors import DataError
from eal_actors.wire.format.packing import MAX_ENVELOPE_BYTES, MAX_ITEMS
from eal_actors.wire.rpc.server.request_handler import require_handshake


def info(number: int, description: str = "") -> ResourceInfo:
    return ResourceInfo(f"Lamp{number}", ResourceType.OTHER, frozenset(), None, (), (), (), description)


def test_a_handshake_holds_so_many_resources_and_no_more() -> None:
    infos = [info(number) for number in range(MAX_ITEMS + 1)]
    require_handshake(infos[:-1])
    with pytest.raises(DataError, match="it has 4097 resources, more than the 4096 of a handshake"):
        require_handshake(infos)


def test_a_handshake_holds_so_much_text_and_no_more() -> None:
    with pytest.raises(DataError, match=r"the information of its resources takes \d+ bytes .*, more than 1048576"):
        require_handshake([info(1), info(2, "x" * MAX_ENVELOPE_BYTES)])
