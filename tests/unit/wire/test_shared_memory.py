"""Memory shared by two ends: what the kernel refuses, and that no value changes before it is read."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from eal_actors.kernel.errors import ProtocolError, UnavailableError
from eal_actors.wire.shared_memory import (
    LEAST_BYTES,
    MOST_BYTES,
    ControllerMemories,
    MemoryOffer,
    OwnedMemory,
    PeerMemory,
    SharedValue,
)

SIZE = 3 * LEAST_BYTES
NOBODY = 65534
OPEN = """
import os, sys
from eal_actors.wire.shared_memory import MemoryOffer, PeerMemory
user, *fields = sys.argv[1:]
offer = MemoryOffer.parse(tuple(text if number == 3 else int(text) for number, text in enumerate(fields)))
os.setgroups([])
os.setgid(int(user))
os.setuid(int(user))
try:
    PeerMemory(offer)
except PermissionError:
    print("refused")
except FileNotFoundError:
    print("not found")
else:
    print("opened")
"""


@pytest.fixture
def owned() -> Iterator[OwnedMemory]:
    memory = OwnedMemory(SIZE)
    memory.allocate()
    yield memory
    memory.close()


@pytest.fixture
def peer(owned: OwnedMemory) -> Iterator[PeerMemory]:
    memory = PeerMemory(owned.offer)
    yield memory
    memory.close()


def test_a_value_is_copied_out_and_its_slot_is_free_again(owned: OwnedMemory, peer: PeerMemory) -> None:
    places = [peer.put(bytes([number]) * SIZE) for number in range(1, 5)]
    assert peer.put(b"fifth") is None
    for number, place in enumerate(places, 1):
        assert place is not None
        assert owned.take(place) == bytes([number]) * SIZE
    assert peer.put(b"fifth") is not None


def test_a_value_keeps_its_slot_while_it_is_in_use(owned: OwnedMemory, peer: PeerMemory) -> None:
    def put(letter: bytes) -> SharedValue | None:
        return peer.put(letter * SIZE)

    first, second = put(b"1"), put(b"2")
    assert first is not None
    assert second is not None
    view, other = memoryview(owned.take(first))[8:], owned.take(second)
    with pytest.raises(UnavailableError):
        owned.take(first)  # it was taken
    third, fourth = put(b"3"), put(b"4")
    assert third is not None
    assert fourth is not None
    assert put(b"5") is None
    copies = [owned.take(third), owned.take(fourth)]  # few slots are free
    assert [put(b"5"), put(b"6"), put(b"7")].count(None) == 1
    assert bytes(view) == b"1" * (SIZE - 8)
    assert other == b"2" * SIZE
    assert copies == [b"3" * SIZE, b"4" * SIZE]
    del view
    assert put(b"8") is not None
    owned.close()
    assert other == b"2" * SIZE


def test_no_value_changes_before_it_is_taken(owned: OwnedMemory, peer: PeerMemory) -> None:
    chance = np.random.default_rng(21)
    waiting: list[tuple[SharedValue, bytes]] = []
    for _ in range(2000):
        value = chance.bytes(64) * int(chance.integers(1, SIZE // 64))
        if chance.random() < 0.5 and (place := peer.put(memoryview(value))) is not None:
            waiting.append((place, value))
        elif waiting:
            place, value = waiting.pop(int(chance.integers(len(waiting))))
            assert owned.take(place) == value
    assert len(waiting) <= owned.offer.slots


def test_nothing_is_put_before_the_memory_is_allocated() -> None:
    memory = OwnedMemory(SIZE)
    peer = PeerMemory(memory.offer)
    assert peer.put(bytes(SIZE)) is None
    memory.allocate()
    assert peer.put(bytes(SIZE)) is not None
    assert peer.put(bytes(SIZE + 4096)) is None  # longer than a slot
    peer.close()
    assert peer.put(bytes(SIZE)) is None
    memory.close()


def test_a_place_that_is_not_there_is_an_error(owned: OwnedMemory, peer: PeerMemory) -> None:
    place = peer.put(bytes(SIZE))
    assert place is not None
    for wrong in (place._replace(slot=4), place._replace(length=owned.offer.slot_bytes + 1)):
        with pytest.raises(ProtocolError, match="is no place"):
            owned.take(wrong)
    with pytest.raises(UnavailableError, match="read it again"):
        owned.take(place._replace(number=2))
    owned.take(place)
    with pytest.raises(UnavailableError):
        owned.take(place)
    owned.close()
    with pytest.raises(UnavailableError):
        owned.take(place)


@pytest.mark.parametrize(
    "wrong",
    [
        {"pid": 0},
        {"fd": -1},
        {"slots": 0},
        {"slots": 65},
        {"slot_bytes": LEAST_BYTES + 1},
        {"slot_bytes": 2 * MOST_BYTES},
        {"token": ""},
        {"token": 1},
        {"inode": "1"},
    ],
)
def test_a_malformed_offer_is_refused(owned: OwnedMemory, wrong: dict[str, object]) -> None:
    with pytest.raises(ProtocolError, match="memory"):
        MemoryOffer.parse(tuple(owned.offer._replace(**wrong)))  # type: ignore[arg-type]  # that is the test


def test_another_file_is_never_opened_as_memory(owned: OwnedMemory, tmp_path: Path) -> None:
    """Neither a pipe, at which opening would wait, nor memory that could shrink, nor that of somebody else."""
    os.mkfifo(tmp_path / "pipe")
    plain = os.memfd_create("plain", os.MFD_ALLOW_SEALING)
    os.ftruncate(plain, owned.offer.size)
    os.write(plain, bytes.fromhex(owned.offer.token))
    pipe = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    for fd in (plain, pipe, 0, 10**6):
        try:
            inode = os.fstat(fd).st_ino
        except OSError:
            inode = 1
        with pytest.raises(OSError, match=r"memory|sealed"):
            PeerMemory(owned.offer._replace(fd=fd, inode=inode))
    with pytest.raises(OSError, match="token"):
        PeerMemory(owned.offer._replace(token="00" * 16))
    with pytest.raises(OSError, match="sealed"):
        PeerMemory(owned.offer._replace(slots=5))
    for fd in (plain, pipe):
        os.close(fd)


def test_nobody_can_shrink_it(owned: OwnedMemory) -> None:
    for size in (0, owned.offer.size + 4096):
        with pytest.raises(PermissionError):
            os.ftruncate(owned.offer.fd, size)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize(("user", "outcome"), [(0, "opened"), (NOBODY, "not found")])
def test_only_the_same_user_may_open_it(owned: OwnedMemory, user: int, outcome: str) -> None:
    arguments = [sys.executable, "-c", OPEN, str(user), *map(str, owned.offer)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == f"{outcome}\n"


def test_it_has_no_name_that_others_could_open(owned: OwnedMemory) -> None:
    assert str(Path(f"/proc/self/fd/{owned.offer.fd}").readlink()) == "/memfd:eal-values (deleted)"
    assert not list(Path("/dev/shm").glob("*eal*"))  # noqa: S108  # where named memory shows


def test_a_limit_of_the_kernel_is_an_error_and_not_a_signal() -> None:
    code = f"""
import resource
from eal_actors.wire.shared_memory import OwnedMemory
resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))
try:
    OwnedMemory({SIZE}).allocate()
except OSError as error:
    print(type(error).__name__)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "OSError\n", done
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[1] != 65536


def test_a_robot_opens_the_memory_of_few_controllers_and_forgets_those_that_closed_it() -> None:
    memories = ControllerMemories("r1", is_enabled=True)
    owned = [OwnedMemory(SIZE) for _ in range(17)]
    opened = [memories.open(f"c{number}", tuple(memory.offer)) for number, memory in enumerate(owned)]
    assert opened == [True] * 16 + [False]
    assert memories.open("c3", tuple(owned[16].offer))  # in place of its former one
    owned[0].close()
    memories.check()
    assert memories.open("c16", tuple(owned[16].offer))
    memories.close()
    assert not memories.open("c1", tuple(owned[1].offer))
    for memory in owned:
        memory.close()


def test_a_fleet_may_forbid_it(owned: OwnedMemory) -> None:
    assert not ControllerMemories("r1", is_enabled=False).open("c1", tuple(owned.offer))
