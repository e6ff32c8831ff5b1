"""Invalid and truncated images are refused before anything is written."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from evbotos.disk_image import check_image
from evbotos.errors import FlashError
from evbotos.flash import BLOCK
from tests.evbotos.flash.rig import MIB, SECTOR, SFDISK, make_image


def test_an_image_is_told_by_its_partitions(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img")
    assert (image.size, image.partitions) == (3 * BLOCK + 5 * SECTOR, 1)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no partition table"),
        (bytes(MIB), "no partition table"),
        (b"hsqs" + bytes(4096), "squashfs"),
        (b"\x1f\x8b" + bytes(4096), "gunzip"),
        (b"\xfd7zXZ\0" + bytes(4096), "unxz"),
        (b"\x28\xb5\x2f\xfd" + bytes(4096), "unzstd"),
        (b"PK\x03\x04" + bytes(4096), "unzip"),
        (bytes(257) + b"ustar" + bytes(4096), "tar archive"),
        (bytes(0x438) + b"\x53\xef" + bytes(4096), "without a partition table"),
        (bytes(510) + b"\x55\xaa" + bytes(MIB), "is empty"),
        (bytes(450) + b"\xee" + bytes(59) + b"\x55\xaa" + bytes(MIB), "a missing GPT"),
    ],
)
def test_what_is_no_image_is_refused_by_its_kind(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "disk.img"
    path.write_bytes(content)
    with pytest.raises(FlashError, match=words):
        check_image(path)


@pytest.mark.parametrize("lost", [1, SECTOR, BLOCK])
def test_an_image_that_is_cut_off_is_refused(tmp_path: Path, lost: int) -> None:
    path = tmp_path / "disk.img"
    size = make_image(path).size
    os.truncate(path, size - lost)
    with pytest.raises(FlashError, match="is truncated"):
        check_image(path)


@pytest.mark.skipif(SFDISK is None, reason="sfdisk is not installed (package fdisk)")
def test_an_image_with_a_gpt_is_one(tmp_path: Path) -> None:
    path = tmp_path / "disk.img"
    path.write_bytes(bytes(4 * MIB))
    subprocess.run([str(SFDISK), "-q", path], input=b"label: gpt\nsize=1MiB\n", check=True)
    assert check_image(path).size == 4 * MIB
    os.truncate(path, 2 * MIB)
    with pytest.raises(FlashError, match="is truncated"):
        check_image(path)


def test_images_that_are_not_there_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FlashError, match="No such file"):
        check_image(tmp_path / "none.img")
    with pytest.raises(FlashError, match="directory"):
        check_image(tmp_path)
