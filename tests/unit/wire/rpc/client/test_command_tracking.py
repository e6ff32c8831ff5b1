"""The state of running commands, for any order of reports."""

from __future__ import annotations

from typing import Any

import pytest

from eal_actors.device.resource import Progress
from eal_actors.kernel.errors import AccessDeniedError, ProtocolError
from eal_actors.wire.format.keys import HALT, HELLO, ROBOT, STOP, STREAM
from eal_actors.wire.format.messages import CallId
from eal_actors.wire.rpc.client.command_tracking import CommandBoard
from eal_actors.wire.security.access import Rights

ONE, TWO = CallId("ab" * 8, 1, 7), CallId("ab" * 8, 1, 8)
FIELDS: dict[str, Any] = {"resource": "Base", "command": "f1", "by": "anna", "since_s": 100.0}


def commands(board: CommandBoard) -> list[str]:
    return [running.command for running in board.running(lambda s: s - 90.0)]


def row(call_id: CallId, command: str, progress: object = None) -> list[Any]:
    return [*call_id, {**FIELDS, "command": command, "progress": progress}]


def test_what_runs_is_listed_until_it_ends() -> None:
    board = CommandBoard()
    moved = Progress(0.25, "on its way", 101.0)
    assert board.replace([row(ONE, "f1")], 100.5) == []
    assert board.replace([row(ONE, "f1", [0.25, "on its way", 101.0])], 101.5) == [(ONE, moved)]
    assert board.replace([row(ONE, "f1", [0.25, "on its way", 101.0]), row(TWO, "f2")], 102.0) == []
    running, _ = board.running(lambda s: s - 90.0)
    assert (running.resource, running.command, running.by, running.since_s) == ("Base", "f1", "anna", 10.0)
    assert running.progress == Progress(0.25, "on its way", 11.0)
    board.end(ONE, 103.0)
    assert commands(board) == ["f2"]


def test_what_is_late_on_its_way_replaces_nothing() -> None:
    board = CommandBoard()
    board.replace([row(ONE, "f1"), row(TWO, "f2")], 105.0)
    board.replace([], 103.0)
    assert commands(board) == ["f1", "f2"]
    board.end(ONE, 106.0)
    board.replace([row(ONE, "f1"), row(TWO, "f2")], 105.5)
    assert commands(board) == ["f2"]
    board.replace([], 107.0)
    assert commands(board) == []
    board.clear()
    board.replace([row(TWO, "of another process, with another clock")], 1.0)
    assert len(commands(board)) == 1


@pytest.mark.parametrize("told", [None, 3, [[1, 2]], [["ab", 1, 2, {}]], [["ab", 1, 2, {**FIELDS, "since_s": "x"}]]])
def test_lists_that_make_no_sense_are_refused(told: object) -> None:
    board = CommandBoard()
    board.replace([row(ONE, "f1")], 100.0)
    with pytest.raises(ProtocolError, match="running command"):
        board.replace(told, 101.0)
    assert commands(board) == ["f1"]


@pytest.mark.parametrize("told", [3, [0.5], ["x", "", 1.0], [0.5, "", None]])
def test_progress_that_makes_no_sense_is_refused(told: object) -> None:
    with pytest.raises(ProtocolError, match="progress"):
        CommandBoard().replace([row(ONE, "f1", told)], 100.0)


RIGHTS = [["boss", "controller", None], ["driver", "controller", ["Base"]], ["display", "observer", None]]


@pytest.mark.parametrize(
    ("name", "granted", "denied"),
    [
        ("boss", [("Base", "send_cmd"), (ROBOT, "resume"), ("Camera", "set_config")], []),
        (
            "driver",
            [("Base", "send_cmd"), ("Base", HALT), (ROBOT, STOP)],
            [("Camera", "get_value"), (ROBOT, "resume")],
        ),
        ("display", [("Base", "get_value"), ("Camera", STREAM), (ROBOT, HELLO)], [("Base", HALT), (ROBOT, STOP)]),
        ("stranger", [], [("Base", "get_value"), (ROBOT, HELLO)]),
    ],
)
def test_rights_say_what_is_granted(name: str, granted: list[tuple[str, str]], denied: list[tuple[str, str]]) -> None:
    rights = Rights.decode(RIGHTS, name)
    assert rights is not None
    for resource, method in granted:
        rights.check(resource, method)
    for resource, method in denied:
        with pytest.raises(AccessDeniedError, match=f"{method}.* to '{name}'"):
            rights.check(resource, method)


def test_no_rights_are_every_right_and_nonsense_is_refused() -> None:
    assert Rights.decode(None, "anybody") is None
    with pytest.raises(ProtocolError, match="rights"):
        Rights.decode([["boss"]], "boss")
