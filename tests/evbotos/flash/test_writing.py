"""Written data is verified; an error names the position of wrong data."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from evbotos.block_devices import Target
from evbotos.errors import FlashError
from evbotos.flash import BLOCK, Phase, opened, write_image
from tests.evbotos.flash.rig import MIB, SECTOR, a_file, make_image, unheard


def test_an_image_is_written_and_the_rest_of_the_medium_is_left(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img")
    target = a_file(tmp_path / "card", image.size + MIB)
    heard: list[tuple[Phase, int]] = []
    with opened(target) as medium:
        flashed = write_image(image, medium, lambda phase, done: heard.append((phase, done)))
    card = target.path.read_bytes()
    assert card == image.path.read_bytes() + bytes(MIB)
    assert flashed.sha256 == hashlib.sha256(image.path.read_bytes()).hexdigest()
    assert heard[-1] == ("checking", image.size)
    assert ("writing", image.size) in heard


class Card:
    """A card in memory, with faults."""

    def __init__(self, size: int) -> None:
        self.cells = bytearray(size)
        self.most = size
        """Bytes that it takes at once."""
        self.fail_at: dict[int, int] = {}
        """The effect of writing the byte at an offset is written, as an errno."""
        self.on_read: Callable[[bytearray], None] = lambda cells: None

    def write_at(self, data: memoryview, offset: int) -> int:
        size = min(len(data), self.most)
        for at, error in self.fail_at.items():
            if offset <= at < offset + size:
                raise OSError(error, os.strerror(error))
        self.cells[offset : offset + size] = data[:size]
        return size

    def read_at(self, size: int, offset: int) -> bytes:
        return bytes(self.cells[offset : offset + min(size, self.most)])

    def sync(self) -> None:
        pass

    def forget(self) -> None:
        self.on_read(self.cells)


class ShortReader(Card):
    """Takes everything, keeps what it has room for."""

    def write_at(self, data: memoryview, offset: int) -> int:
        keep = max(0, min(len(data), len(self.cells) - offset))
        self.cells[offset : offset + keep] = data[:keep]
        return len(data)


def test_a_medium_that_takes_and_gives_little_at_a_time_gets_everything(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img", size=2 * BLOCK)
    card = Card(image.size)
    card.most = 100_003
    write_image(image, card, unheard)
    assert card.cells == image.path.read_bytes()


@pytest.mark.parametrize(
    ("error", "words"),
    [(errno.ENOSPC, "it is full"), (errno.ENODEV, "has vanished"), (errno.EIO, os.strerror(errno.EIO))],
)
def test_a_failure_says_where_and_leaves_no_partition_table(tmp_path: Path, error: int, words: str) -> None:
    image = make_image(tmp_path / "disk.img")
    card = Card(image.size)
    card.cells[:] = b"\x55\xaa" * (image.size // 2)
    card.fail_at[2 * BLOCK + 10] = error
    with pytest.raises(FlashError, match=rf"writing failed at byte {2 * BLOCK}: .*{words}"):
        write_image(image, card, unheard)
    assert card.cells[:SECTOR] == bytes(SECTOR)
    assert card.cells[BLOCK : 2 * BLOCK] == image.path.read_bytes()[BLOCK : 2 * BLOCK]


def test_a_medium_that_takes_nothing_more_is_told(tmp_path: Path) -> None:
    card = Card(MIB)
    card.most = 0
    with pytest.raises(FlashError, match="the medium is full"):
        write_image(make_image(tmp_path / "disk.img"), card, unheard)


@pytest.mark.parametrize("at", [0, 511, BLOCK - 1, BLOCK, 2 * BLOCK + 77, 3 * BLOCK + 5 * SECTOR - 1])
def test_a_flipped_bit_is_found_at_its_byte(tmp_path: Path, at: int) -> None:
    image = make_image(tmp_path / "disk.img")
    card = Card(image.size)

    def wear(cells: bytearray) -> None:
        cells[at] ^= 4

    card.on_read = wear
    with pytest.raises(FlashError, match=rf"byte {at} is .* and 1 of .* bytes from byte {at - at % BLOCK} are wrong"):
        write_image(image, card, unheard)


def test_a_card_that_is_smaller_than_it_says_is_found_out(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img", size=4 * BLOCK)

    class Counterfeit(Card):
        def write_at(self, data: memoryview, offset: int) -> int:
            return super().write_at(data, offset % (2 * BLOCK))

        def read_at(self, size: int, offset: int) -> bytes:
            return super().read_at(size, offset % (2 * BLOCK))

    with pytest.raises(FlashError, match=rf"did not keep the written data: byte {BLOCK} "):
        write_image(image, Counterfeit(2 * BLOCK), unheard)
    with pytest.raises(FlashError, match=rf"ends at byte {2 * BLOCK}"):
        write_image(image, ShortReader(2 * BLOCK), unheard)


def test_an_image_that_changes_meanwhile_is_told(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img")
    card = Card(image.size)

    def change(cells: bytearray) -> None:
        make_image(image.path, seed=8)
        cells[:] = image.path.read_bytes()

    card.on_read = change
    with pytest.raises(FlashError, match="the image changed between"):
        write_image(image, card, unheard)


def test_an_image_that_shrinks_meanwhile_is_told(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img")
    os.truncate(image.path, BLOCK + 5)
    with pytest.raises(FlashError, match=f"ends at byte {BLOCK + 5}"):
        write_image(image, Card(image.size), unheard)


def test_a_full_disk_below_a_file_is_told(tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    descriptor_target = Target(full, 1 << 30, "a file", False, False, ())
    with opened(descriptor_target) as medium, pytest.raises(FlashError, match="it is full"):
        write_image(make_image(tmp_path / "disk.img"), medium, unheard)


def test_two_at_once_are_one_too_many(tmp_path: Path) -> None:
    target = a_file(tmp_path / "card", MIB)
    with opened(target), pytest.raises(FlashError, match="another program"), opened(target):
        pass
