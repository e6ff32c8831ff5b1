"""The pieces of a new system that are sent, and those that a robot copies from the one that it runs."""

from __future__ import annotations

import importlib
import random
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evbotos.delta import BLOCK, Piece, matching_offsets, messages, missing_pieces
from evbotos.fields import ROOTFS


@pytest.fixture(scope="module")
def digests_of() -> Any:
    """The program of the image that names a robot's blocks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOTFS / "services/update/usr/lib/evbotos")
        return importlib.import_module("evbotos_update.blocks").digests


def random_bytes(seed: int, size: int) -> bytes:
    return random.Random(seed).randbytes(size)  # noqa: S311  # contents of files


def written(new: bytes, present: bytes, running: bytes, pieces: list[Piece]) -> bytes:
    """Return what a robot has after it carried the pieces out."""
    slot = bytearray(present.ljust(len(new), b"\0"))
    for piece in pieces:
        source = new if piece.source is None else running
        start = piece.start if piece.source is None else piece.source
        slot[piece.start : piece.start + piece.length] = source[start : start + piece.length]
    return bytes(slot[: len(new)])


def pieces_for(new: bytes, present: bytes, running: bytes, digests_of: Any, folder: Path) -> list[Piece]:
    for name, content in (("present", present), ("running", running)):
        (folder / name).write_bytes(content)
    named = [digests_of(folder / name, 1 << 40) for name in ("present", "running")]
    return missing_pieces(new, *named)


def sent(pieces: list[Piece]) -> int:
    return sum(piece.length for piece in pieces if piece.source is None)


def test_the_sums_are_adler_32_at_every_offset() -> None:
    new = random_bytes(1, (1 << 20) + 3 * BLOCK)  # more than one window
    for offset in (0, 1, 4095, (1 << 20) - 1, 1 << 20, (1 << 20) + 1, len(new) - BLOCK):
        weak = np.array([zlib.adler32(new[offset : offset + BLOCK])], np.uint32)
        assert offset in matching_offsets(new, weak)
    white = b"\xff" * (1 << 20)
    assert len(matching_offsets(white, np.array([zlib.adler32(white[:BLOCK])], np.uint32))) == (1 << 20) - BLOCK + 1


def test_a_changed_file_in_the_middle_costs_itself_and_not_all_that_it_shifts(digests_of: Any, tmp_path: Path) -> None:
    running = random_bytes(2, 100 * BLOCK)
    new = running[: 40 * BLOCK + 17] + random_bytes(3, 5001) + running[41 * BLOCK :]
    pieces = pieces_for(new, b"", running, digests_of, tmp_path)
    assert written(new, b"", running, pieces) == new
    assert sent(pieces) < 5001 + 2 * BLOCK
    assert len(pieces) == 3  # what stays, what is new, what is shifted


def test_an_interrupted_push_goes_on_where_it_ended(digests_of: Any, tmp_path: Path) -> None:
    new = random_bytes(4, 50 * BLOCK + 100)
    present = new[: 30 * BLOCK + 5] + bytes(60 * BLOCK)
    pieces = pieces_for(new, present, b"", digests_of, tmp_path)
    assert pieces == [Piece(30 * BLOCK, 20 * BLOCK + 100)]
    assert pieces_for(new, new, b"", digests_of, tmp_path) == [Piece(50 * BLOCK, 100)]  # not a whole block


@given(seed=st.integers(0, 1 << 30))
def test_the_robot_ends_with_the_new_file_whatever_it_had(seed: int) -> None:
    generator = random.Random(seed)  # noqa: S311  # contents of files
    blocks = [generator.randbytes(BLOCK) for _ in range(3)] + [bytes(BLOCK), b"\xff" * BLOCK]

    def some_file() -> bytes:
        parts = (
            generator.choice(blocks) if generator.random() < 0.8 else generator.randbytes(generator.randrange(3000))
            for _ in range(generator.randrange(12))
        )
        return b"".join(parts)

    new, present, running = some_file(), some_file(), some_file()
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOTFS / "services/update/usr/lib/evbotos")
        program = importlib.import_module("evbotos_update.blocks")
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as name:
        pieces = pieces_for(new, present, running, program.digests, Path(name))
    assert written(new, present, running, pieces) == new


def test_messages_are_bounded_and_complete() -> None:
    new = random_bytes(5, 10_000)
    pieces = [Piece(0, 5000), Piece(5000, 4096, 777), Piece(9096, 904)]
    made = list(messages("root", new, pieces, 2000))
    assert sum(done for _, done in made) == 10_000
    assert all(done <= 2000 and len(message) < 2200 for message, done in made)
