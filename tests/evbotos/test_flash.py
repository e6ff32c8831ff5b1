"""`evbotos flash`: what it refuses, what it shows, and that what it wrote is there."""

from __future__ import annotations

import errno
import hashlib
import os
import random
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from evbotos.block_devices import System, Target
from evbotos.disk_image import DiskImage, check_image
from evbotos.errors import FlashError
from evbotos.flash import BLOCK, Lost, Phase, opened, refusals, what_is_on, write_image
from evbotos.flash_command import flash
from evbotos.hosttools import find_tool

SFDISK, MKE2FS = find_tool("sfdisk"), find_tool("mke2fs")
SECTOR = 512
MIB = 1 << 20


def make_image(path: Path, size: int = 3 * BLOCK + 5 * SECTOR, seed: int = 7) -> DiskImage:
    """Make a disk image of random bytes with one partition from 1 MiB to its end."""
    data = bytearray(random.Random(seed).randbytes(size))  # noqa: S311  # the same bytes each time
    data[:SECTOR] = bytes(SECTOR)
    struct.pack_into("<B3xB3xII", data, 446, 0x80, 0x83, 2048, size // SECTOR - 2048)
    data[510:512] = b"\x55\xaa"
    path.write_bytes(data)
    return check_image(path)


def a_file(path: Path, size: int) -> Target:
    with path.open("wb") as file:
        file.truncate(size)
    return System().target(path)


def unheard(phase: Phase, done: int) -> None:
    """Take no notice of the progress."""


# --- the image ---


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
        (bytes(450) + b"\xee" + bytes(59) + b"\x55\xaa" + bytes(MIB), "GPT that is not there"),
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
    with pytest.raises(FlashError, match="is cut off"):
        check_image(path)


@pytest.mark.skipif(SFDISK is None, reason="sfdisk is not installed (package fdisk)")
def test_an_image_with_a_gpt_is_one(tmp_path: Path) -> None:
    path = tmp_path / "disk.img"
    path.write_bytes(bytes(4 * MIB))
    subprocess.run([str(SFDISK), "-q", path], input=b"label: gpt\nsize=1MiB\n", check=True)
    assert check_image(path).size == 4 * MIB
    os.truncate(path, 2 * MIB)
    with pytest.raises(FlashError, match="is cut off"):
        check_image(path)


def test_images_that_are_not_there_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FlashError, match="No such file"):
        check_image(tmp_path / "none.img")
    with pytest.raises(FlashError, match="directory"):
        check_image(tmp_path)


# --- the disk ---


class FakeKernel:
    """A folder that looks like /sys and /proc of a machine with a few disks."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "proc/self").mkdir(parents=True)
        (root / "sys/block").mkdir(parents=True)
        (root / "sys/dev/block").mkdir(parents=True)
        (root / "proc/swaps").write_text("Filename Type Size Used Priority\n")
        (root / "proc/self/mountinfo").write_text("")
        self._count = 0

    def node(self, where: str, **attributes: object) -> tuple[Path, str]:
        """Add a disk (`sda`) or a partition (`sda/sda1`); returns its folder and number."""
        folder = self.root / "sys/devices" / where
        (folder / "holders").mkdir(parents=True)
        self._count += 1
        number = f"8:{self._count}"
        for name, value in {"dev": number, "ro": 0, "size": 1 << 16, "removable": 1, **attributes}.items():
            file = folder / name.replace("__", "/")
            file.parent.mkdir(exist_ok=True)
            file.write_text(f"{value}\n")
        (self.root / "sys/dev/block" / number).symlink_to(folder)
        return folder, number

    def mount(self, number: str, point: str, source: str = "none") -> None:
        with (self.root / "proc/self/mountinfo").open("a") as file:
            file.write(f"20 1 {number} / {point} rw,relatime shared:1 - ext4 {source} rw\n")

    def target(self, number: str) -> Target:
        return System(self.root).disk(Path("/dev/sda"), number)


@pytest.fixture
def kernel(tmp_path: Path) -> FakeKernel:
    return FakeKernel(tmp_path / "machine")


def test_a_stick_is_free_and_removable(kernel: FakeKernel) -> None:
    _, number = kernel.node("usb1/sda", device__vendor="SanDisk", device__model="Ultra ")
    target = kernel.target(number)
    assert (target.model, target.size, target.is_removable, target.obstacles) == (
        "SanDisk Ultra",
        (1 << 16) * SECTOR,
        True,
        (),
    )


@pytest.mark.parametrize(("kind", "is_removable"), [("SD", True), ("MMC", False)])
def test_a_card_is_removable_and_soldered_flash_is_not(kernel: FakeKernel, kind: str, is_removable: bool) -> None:
    _, number = kernel.node("mmc0/mmcblk0", removable=0, device__type=kind)
    assert kernel.target(number).is_removable is is_removable


def test_a_disk_is_in_use_by_each_of_its_partitions(kernel: FakeKernel) -> None:
    _, disk = kernel.node("sda")
    _, one = kernel.node("sda/sda1", partition=1)
    kernel.node("sda/sda2", partition=2)
    kernel.mount(one, r"/media/my\040stick")
    assert kernel.target(disk).obstacles == ("sda1 on it is mounted on /media/my stick: umount /media/my stick",)


@pytest.mark.parametrize("point", ["/", "/boot", "/home"])
def test_the_systems_disk_is_named_so_through_every_layer(kernel: FakeKernel, point: str) -> None:
    _, disk = kernel.node("sda", removable=0)
    part, _ = kernel.node("sda/sda3", partition=3)
    crypt, _ = kernel.node("virtual/dm-0")
    volume, volume_number = kernel.node("virtual/dm-1")
    (part / "holders/dm-0").symlink_to(crypt)
    (crypt / "holders/dm-1").symlink_to(volume)
    kernel.mount(volume_number, point)
    obstacles = kernel.target(disk).obstacles
    assert f"it is the system's disk: dm-1 on it is mounted on {point}" in obstacles
    assert "sda3 on it is held by dm-0 (a volume, an encrypted disk or a RAID)" in obstacles


def test_write_protection_an_empty_reader_and_a_partition_are_told(kernel: FakeKernel) -> None:
    _, locked = kernel.node("sda", ro=1)
    _, empty = kernel.node("sdb", size=0)
    _, part = kernel.node("sdc/sdc1", partition=1)
    assert "write-protected" in kernel.target(locked).obstacles[0]
    assert "no medium" in kernel.target(empty).obstacles[0]
    with pytest.raises(FlashError, match=r"name /dev/sdc$"):
        kernel.target(part)
    with pytest.raises(FlashError, match="knows nothing"):
        kernel.target("9:99")


def test_every_reason_is_told_at_once(tmp_path: Path, kernel: FakeKernel) -> None:
    _, disk = kernel.node("sda", removable=0, size=8)
    kernel.mount(disk, "/mnt")
    reasons = refusals(make_image(tmp_path / "disk.img"), kernel.target(disk), may_be_fixed=False)
    assert [reason.split(":")[0] for reason in reasons] == [
        "it is mounted on /mnt",
        "it is a fixed disk and not a removable medium",
        "it is too small",
    ]


def test_a_file_is_taken_for_a_disk_only_if_told(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img")
    target = a_file(tmp_path / "card", image.size)
    assert "--not-removable" in refusals(image, target, may_be_fixed=False)[0]
    assert refusals(image, target, may_be_fixed=True) == []
    itself = System().target(image.path)
    assert refusals(image, itself, may_be_fixed=True) == ["it is the image itself"]


@pytest.mark.parametrize(("path", "words"), [("/dev/null", "is not a disk"), ("/dev/sdzz", "there is no /dev/sdzz")])
def test_what_is_no_disk_is_refused(path: str, words: str) -> None:
    with pytest.raises(FlashError, match=words):
        System().target(Path(path))


# --- writing ---


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
        """What happens when the byte at an offset is written, as an errno."""
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
    with pytest.raises(FlashError, match="takes no more"):
        write_image(make_image(tmp_path / "disk.img"), card, unheard)


@pytest.mark.parametrize("at", [0, 511, BLOCK - 1, BLOCK, 2 * BLOCK + 77, 3 * BLOCK + 5 * SECTOR - 1])
def test_a_flipped_bit_is_found_at_its_byte(tmp_path: Path, at: int) -> None:
    image = make_image(tmp_path / "disk.img")
    card = Card(image.size)

    def wear(cells: bytearray) -> None:
        cells[at] ^= 4

    card.on_read = wear
    with pytest.raises(FlashError, match=rf"byte {at} is .* and 1 bytes are wrong .* from byte {at - at % BLOCK} on"):
        write_image(image, card, unheard)


def test_a_card_that_is_smaller_than_it_says_is_found_out(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img", size=4 * BLOCK)

    class Counterfeit(Card):
        def write_at(self, data: memoryview, offset: int) -> int:
            return super().write_at(data, offset % (2 * BLOCK))

        def read_at(self, size: int, offset: int) -> bytes:
            return super().read_at(size, offset % (2 * BLOCK))

    with pytest.raises(FlashError, match=rf"did not keep what was written: byte {BLOCK} "):
        write_image(image, Counterfeit(2 * BLOCK), unheard)
    with pytest.raises(FlashError, match=rf"ends at byte {2 * BLOCK}"):
        write_image(image, ShortReader(2 * BLOCK), unheard)


class ShortReader(Card):
    """Takes everything, keeps what it has room for."""

    def write_at(self, data: memoryview, offset: int) -> int:
        keep = max(0, min(len(data), len(self.cells) - offset))
        self.cells[offset : offset + keep] = data[:keep]
        return len(data)


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


# --- the command ---


def test_the_command_writes_what_it_was_told_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = make_image(tmp_path / "disk.img")
    card = a_file(tmp_path / "card", image.size)
    flash(image.path, card.path, yes=True, not_removable=True)
    said = capsys.readouterr()
    assert card.path.read_bytes() == image.path.read_bytes()
    assert f"{image.size} bytes written" in said.out
    assert "Nothing is found on it" in said.err
    assert "checking 100 %" in said.err


def test_the_command_asks_before_it_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = make_image(tmp_path / "disk.img")
    card = a_file(tmp_path / "card", image.size)
    with Path(os.devnull).open() as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        with pytest.raises(FlashError, match="--yes"):
            flash(image.path, card.path, not_removable=True)
    with pytest.raises(FlashError, match="not a removable medium"):
        flash(image.path, card.path, yes=True)
    assert card.path.read_bytes() == bytes(image.size)


# --- real disks: loop devices ---


@pytest.fixture
def loop(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Return what makes a loop device of a size."""
    losetup = shutil.which("losetup", path="/usr/sbin:/sbin")
    if os.geteuid() != 0 or losetup is None:
        pytest.skip("loop devices need root and losetup")
    made: list[str] = []

    def attach(size: int) -> Path:
        backing = tmp_path / f"backing{len(made)}"
        with backing.open("wb") as file:
            file.truncate(size)
        done = subprocess.run([losetup, "-P", "-f", "--show", backing], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"losetup does not work here: {done.stderr.strip()}")
        made.append(done.stdout.strip())
        return Path(made[-1])

    yield attach
    for name in made:
        subprocess.run([losetup, "-d", name], check=True)


def partition(disk: Path) -> None:
    """Give a disk two partitions, the first with an ext4 named `old robot`."""
    if SFDISK is None or MKE2FS is None:
        pytest.skip("sfdisk or mke2fs is not installed (packages fdisk, e2fsprogs)")
    table = b"label: dos\nstart=2048,size=8192,type=83\nstart=10240,type=c\n"
    subprocess.run([SFDISK, "-q", disk], input=table, check=True)
    options = ["-q", "-F", "-t", "ext4", "-L", "old robot", "-E", f"offset={MIB}", str(disk), "4M"]
    subprocess.run([MKE2FS, *options], check=True, stderr=subprocess.DEVNULL)


def test_a_loop_device_is_shown_written_and_compared(
    tmp_path: Path, loop: Callable[[int], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    image, disk = make_image(tmp_path / "disk.img"), loop(32 * MIB)
    partition(disk)
    assert what_is_on(System().target(disk))[0] == Lost(f"{disk.name}p1", 4 * MIB, "ext4", "old robot")
    flash(image.path, disk, yes=True, not_removable=True, as_json=True)
    said = capsys.readouterr()
    assert "old robot" in said.err
    assert f'"size": {image.size}' in said.out
    assert disk.read_bytes()[: image.size] == image.path.read_bytes()


def test_a_loop_device_that_is_mounted_held_or_too_small_is_refused(
    tmp_path: Path, loop: Callable[[int], Path]
) -> None:
    image, disk, small = make_image(tmp_path / "disk.img"), loop(32 * MIB), loop(MIB)
    assert "it is too small" in refusals(image, System().target(small), may_be_fixed=True)[0]
    if MKE2FS is None:
        pytest.skip("mke2fs is not installed (package e2fsprogs)")
    subprocess.run([MKE2FS, "-q", "-F", disk], check=True, stderr=subprocess.DEVNULL)
    point = tmp_path / "mounted here"
    point.mkdir()
    if subprocess.run(["mount", disk, point], check=False, capture_output=True).returncode:
        pytest.skip("file systems cannot be mounted here")
    try:
        assert refusals(image, System().target(disk), may_be_fixed=True) == [
            f"it is mounted on {point}: umount {point}"
        ]
        free = Target(disk, 32 * MIB, "loop", False, True, ())  # had nothing been noticed, the kernel still refuses
        with pytest.raises(FlashError, match="something uses it"), opened(free):
            pass
    finally:
        subprocess.run(["umount", point], check=True)


def test_the_file_of_a_loop_device_is_refused(tmp_path: Path, loop: Callable[[int], Path]) -> None:
    disk = loop(MIB)
    obstacles = System().target(tmp_path / "backing0").obstacles
    assert obstacles == (f"{disk} is made of it: losetup -d {disk}",)


def test_a_disk_that_fails_below_is_told(tmp_path: Path, loop: Callable[[int], Path]) -> None:
    """A device of the kernel's mapper: good sectors, then bad ones."""
    dmsetup = shutil.which("dmsetup", path="/usr/sbin:/sbin")
    if dmsetup is None:
        pytest.skip("dmsetup is not installed")
    image, disk = make_image(tmp_path / "disk.img"), loop(32 * MIB)
    good = 2 * BLOCK // SECTOR
    table = f"0 {good} linear {disk} 0\n{good} {64 * 1024 - good} error\n"
    name = f"evbotos-test-{os.getpid()}"
    made = subprocess.run([dmsetup, "create", name], input=table, capture_output=True, text=True, check=False)
    if made.returncode:
        pytest.skip(f"the kernel's mapper does not work here: {made.stderr.strip()}")
    try:
        mapped = System().target((Path("/dev/mapper") / name).resolve())
        assert "is held by" in System().target(disk).obstacles[0]
        with opened(mapped) as medium, pytest.raises(FlashError, match=f"failed at byte {2 * BLOCK}"):
            write_image(image, medium, unheard)
    finally:
        subprocess.run([dmsetup, "remove", name], check=True)
