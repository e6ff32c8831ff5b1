"""The push of an update: the plugin of the robot's process, the program of root behind it, and the controller."""

from __future__ import annotations

import grp
import json
import os
import random
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from eal_actors import Fleet, ResourceHandle
from eal_actors.kernel.errors import ArgumentError, NotReadyError, UnsupportedError
from eal_actors.managers.config import EALConfigManager
from evbotos.delta import BLOCK
from evbotos.errors import UpdateError
from evbotos.fleet_robots import FleetRobots, read_update
from evbotos.fleet_update import Outcome, Stage, Standing, stage_of, update_fleet
from tests.evbotos.machine_rig import OWN, VERITY, bundle, choice, hash_of, prepare_machine, program
from tests.net.links import eventually

ROOT = random.Random(7).randbytes(3_000_000)  # noqa: S311  # a file system that does not compress


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """A machine whose program of root starts when it is woken, as the service does it."""
    prepare_machine(tmp_path, monkeypatch, room=4_000_000)
    serve = program("serve", monkeypatch)
    monkeypatch.setattr(serve, "STATE", tmp_path)
    monkeypatch.setattr(serve, "_GROUP", grp.getgrgid(os.getgid()).gr_name)
    os.mkfifo(tmp_path / "update.wake")

    def guard() -> None:
        with (tmp_path / "update.wake").open("rb") as pipe:
            pipe.readline()
        serve.serve()

    def end(_connection: socket.socket) -> None:
        raise TimeoutError

    thread = threading.Thread(target=guard)
    thread.start()
    yield serve
    monkeypatch.setattr(serve, "serve_connection", end)
    if not (tmp_path / "update.sock").exists():
        (tmp_path / "update.wake").write_text("\n")
    assert eventually((tmp_path / "update.sock").exists)
    with socket.socket(socket.AF_UNIX) as last:
        last.connect(str(tmp_path / "update.sock"))
    thread.join()


@pytest.fixture
def robots(machine: ModuleType, tmp_path: Path) -> Iterator[FleetRobots]:
    del machine
    plugins = {"evbotos": {"state": str(tmp_path), "about": str(tmp_path)}}
    content = {"version": 1, "name": "f", "robots": {"ada": {"plugins": plugins, "timeout_s": 60}}}
    with Fleet(EALConfigManager.of(content, name="test").fleet).connect() as fleet:
        yield FleetRobots(fleet, tmp_path / "fleet.yaml", None, lambda _robot, _words: None)


def update_in(folder: Path, **changes: Any) -> Any:
    (folder / "update.tar").write_bytes(bundle(root=ROOT, **changes))
    return read_update(folder / "update.tar")


def sent_bytes(robots: FleetRobots, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    told: list[str] = []
    monkeypatch.setattr(FleetRobots, "tell", lambda _self, _robot, words: told.append(words))
    return told


def test_a_push_writes_the_other_slot_and_the_next_start_tries_it(robots: FleetRobots, tmp_path: Path) -> None:
    update = update_in(tmp_path)
    standing = robots.standing("ada")
    assert standing is not None
    assert (standing.slot, standing.good, standing.release) == ("a", True, OWN)
    robots.push("ada", update)
    assert (tmp_path / "device-b").read_bytes()[: len(ROOT)] == ROOT
    assert choice(tmp_path)["try"] == "b"
    assert hash_of(tmp_path) == VERITY.hash_file()
    after = robots.standing("ada")
    assert after is not None
    assert stage_of(after, update) is Stage.INSTALLED


def test_a_copy_may_not_be_longer_than_a_message(
    machine: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "_MOST_BYTES", 100)
    (tmp_path / "device-a").write_bytes(ROOT)
    update, session = update_in(tmp_path), machine.Session()
    session.answer({"do": "begin", "signed": len(update.signed)}, update.signed + update.signature)
    for length, words in ((100, None), (101, "a piece has up to 100 bytes")):
        copy = machine._PIECE.pack(b"c", 1, 0, length) + machine._SOURCE.pack(1, 0)
        if words is None:
            session.answer({"do": "write"}, copy)
        else:
            with pytest.raises(machine.RefusedError, match=words):
                session.answer({"do": "write"}, copy)
    session.close()
    assert (tmp_path / "device-b").read_bytes()[:100] == ROOT[:100]


def test_what_the_robot_has_is_not_sent(robots: FleetRobots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = sent_bytes(robots, monkeypatch)
    shifted = ROOT[:1_000_000] + b"an older file" + ROOT[1_010_000:]
    (tmp_path / "device-a").write_bytes(shifted)
    robots.push("ada", update_in(tmp_path))
    assert (tmp_path / "device-b").read_bytes()[: len(ROOT)] == ROOT
    assert told[-1] == f"has received {OWN}: 0.0 of 3.0 MB were sent"


def test_a_push_that_was_cut_off_goes_on(robots: FleetRobots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = sent_bytes(robots, monkeypatch)
    with (tmp_path / "device-b").open("r+b") as device:
        device.write(ROOT[:2_900_000])  # what an interrupted push has left
    robots.push("ada", update_in(tmp_path))
    assert (tmp_path / "device-b").read_bytes()[: len(ROOT)] == ROOT
    assert told[-1] == f"has received {OWN}: 0.1 of 3.0 MB were sent"


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"platform": "other"}, "it is for other, this is board"), ({"release": "6.0.0.1"}, "is older than")],
)
def test_a_robot_refuses_what_is_not_for_it(
    robots: FleetRobots, tmp_path: Path, changes: dict[str, str], words: str
) -> None:
    with pytest.raises(ArgumentError, match=words):
        robots.push("ada", update_in(tmp_path, **changes))
    assert (tmp_path / "device-b").read_bytes() == b"o" * 4_000_000


def test_a_file_that_was_changed_after_its_signature_is_not_tried(robots: FleetRobots, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="is not what was signed; it will not be tried"):
        robots.push("ada", update_in(tmp_path, flip_at=1234))
    assert choice(tmp_path)["try"] == ""
    assert hash_of(tmp_path) == {}


def test_the_robots_process_can_do_no_more_than_a_signed_update(robots: FleetRobots, tmp_path: Path) -> None:
    resource = robots.fleet["ada"]["Update"]
    with pytest.raises(ArgumentError, match="no update has begun"):
        resource.write_comm(b"d" + bytes(13)).get()
    for command, data, words in (
        ("finish", None, "no update has begun"),
        ("begin", b"s" * 64 + b"{}", "its signature is not that"),
        ("restart", None, "there is no update to try"),
        ("fall_back", None, "was good before this start"),
    ):
        with pytest.raises(ArgumentError, match=words):
            resource.send_cmd(command, data).get()
    update = update_in(tmp_path)
    resource.send_cmd("begin", update.signature + update.signed).get()
    for piece in (
        b"d\1" + (len(ROOT) - 3).to_bytes(8, "big") + (4).to_bytes(4, "big") + b"long",
        b"d\2" + bytes(12),
        b"d\1" + bytes(8) + (9).to_bytes(4, "big") + b"short",
        b"c\1" + bytes(8) + (9).to_bytes(4, "big") + b"\1" + (3_999_999).to_bytes(8, "big"),
        b"d",
    ):
        with pytest.raises(ArgumentError):
            resource.write_comm(piece).get()
    assert (tmp_path / "device-b").read_bytes() == b"o" * 4_000_000
    with pytest.raises(ArgumentError, match="is not what was signed"):
        resource.send_cmd("finish").get()


def test_a_new_system_may_be_left_again_in_its_first_start_only(
    robots: FleetRobots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robots.push("ada", update_in(tmp_path))
    (tmp_path / "root-a.env").write_bytes((tmp_path / "root-b.env").read_bytes())
    (tmp_path / "slot").write_text("b\n")
    assert program("installation", monkeypatch).mark_good()
    robots.fall_back("ada")
    assert choice(tmp_path)["try"] == "a"
    (tmp_path / "new-slot").unlink()  # the state is gone after a start
    with pytest.raises(ArgumentError, match="was good before this start"):
        robots.fall_back("ada")


def test_a_computer_without_slots_takes_no_update(tmp_path: Path) -> None:
    plugins = {"evbotos": {"state": str(tmp_path)}}
    content = {"version": 1, "name": "f", "robots": {"ada": {"plugins": plugins}, "bob": {"plugins": {"sample": {}}}}}
    with Fleet(EALConfigManager.of(content, name="test").fleet).connect() as fleet:
        with pytest.raises(UnsupportedError, match="does not run EvBotOS with two slots"):
            fleet["ada"]["Update"].send_cmd("finish").get()
        robots = FleetRobots(fleet, tmp_path / "fleet.yaml", None, lambda _robot, _words: None)
        update = update_in(tmp_path)
        assert set(update_fleet(robots, ["ada", "bob"], [update]).values()) == {Outcome.UNSUITED}
        (tmp_path / "slot").write_text("a\n")  # it has slots, and its robot has just begun to serve
        with pytest.raises(NotReadyError, match="the running slot is not good yet"):
            fleet["ada"]["Update"].send_req("status").get()
        assert update_fleet(robots, ["ada"], [update]) == {"ada": Outcome.ABSENT}


def test_a_connection_that_the_program_of_root_ended_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "slot").write_text("a\n")
    os.mkfifo(tmp_path / "update.wake")
    plugins = {"evbotos": {"state": str(tmp_path)}}
    content = {"version": 1, "name": "f", "robots": {"ada": {"plugins": plugins, "timeout_s": 30}}}
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "update.sock"))
        listener.listen()

        def answer_once_each() -> None:
            for number in range(2):
                connection, _ = listener.accept()
                with connection, connection.makefile("rwb") as stream:
                    stream.readline()
                    stream.write(b'{"bytes": 1}\n%d' % number)

        thread = threading.Thread(target=answer_once_each)
        thread.start()
        with Fleet(EALConfigManager.of(content, name="test").fleet).connect() as fleet:
            update = fleet["ada"]["Update"]
            assert update.send_req("status").get().value == "0"
            assert eventually(lambda: ends(update))
            assert update.send_req("status").get().value == "1"
        thread.join()


def ends(update: ResourceHandle) -> bool:
    """Return whether the connection behind a resource has ended."""
    side: Any = update.resource()
    return bool(side._root_side._has_ended(side._root_side._socket))


def test_what_is_not_an_update_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"no tar")
    with pytest.raises(UpdateError, match="is not an update"):
        read_update(tmp_path / "file")


def test_a_machine_says_its_standing(robots: FleetRobots, tmp_path: Path) -> None:
    fields = json.loads(robots.fleet["ada"]["Update"].send_req("status").get().value)
    assert Standing(**fields) == robots.standing("ada")
    assert len(robots.fleet["ada"]["Update"].send_req("other_root").get().payload) == 4_000_000 // BLOCK * 12
