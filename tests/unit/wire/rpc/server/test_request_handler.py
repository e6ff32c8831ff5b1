"""A robot's answers fit into a message, or it is not served."""

from __future__ import annotations

import pytest

from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.inbox import Inbox
from eal_actors.device.info import ResourceInfo, ResourceType
from eal_actors.device.resource import Progress
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import DataError
from eal_actors.wire.format.messages import CallId
from eal_actors.wire.format.packing import MAX_ENVELOPE_BYTES, MAX_ITEMS
from eal_actors.wire.rpc.server.request_handler import require_handshake
from eal_actors.wire.rpc.server.running_commands import RunningCommands, ServedCommand


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


def test_of_too_many_commands_those_under_way_are_listed() -> None:
    running = RunningCommands()
    cell = ResourceCell("r1", "Base", REAL_TIME, Inbox(REAL_TIME, 1), 1.0)
    for number in range(300):
        call: Call[int] = Call(cell, "send_cmd", ("f1", None), 1.0)
        running.add(ServedCommand(lambda _: None, CallId("ab" * 16, 1, number), None, call, 100.0))
    call.note_progress(Progress(0.5, "", 1.0))
    rows = [command.to_row() for command in running.listed()]
    assert [row[2] for row in rows] == [299, *range(255)]
    assert rows[0][3]["progress"][0] == 0.5
