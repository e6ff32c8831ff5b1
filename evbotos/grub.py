"""GRUB on a disk image, without a device and root privileges.

For a BIOS it is installed before the first partition, as grub-bios-setup does. For UEFI it is a program on the boot
partition, at the path that every firmware searches on a disk without an entry in its own list.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from evbotos import slots
from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.model import GRUB_EFI_PACKAGE, GRUB_PACKAGE
from evbotos.shell import run
from evbotos.verity import kernel_words

SECTOR: Final = 512
EFI: Final = "BOOTX64.EFI"
EFI_FOLDER: Final = "EFI/BOOT"
"""The program for UEFI and its folder on the boot partition."""
_MODULES: Final = "part_msdos fat normal configfile linux loadenv test echo serial terminal reboot sleep minicmd"
_BOOT: Final = "boot.img"
_CORE: Final = "core.img"
_KERNEL_SECTOR: Final = 0x5C
"""The offset in boot.img of the core image's first sector."""
_BLOCK_LIST: Final = 0x1F4
"""The offset in the core image's first sector of the rest's location."""
_CORE_SEGMENT: Final = 0x820
_CODE_SIZE: Final = 440
"""The size of the code in the first sector; the disk signature and the partitions follow."""


def menu(kernel_line: str, disk_id: str) -> str:
    """Return grub.cfg.

    A slot in `try` starts once: unless its system marks it as good, the next start uses the other slot.
    After three failed starts in a row, a good slot yields to the other one: GRUB counts the starts in `starts`,
    and the system clears it. A slot whose kernel cannot be loaded yields immediately. A slot without a root hash does
    not start.

    Args:
        kernel_line: the kernel's command line without root and slot.
        disk_id: the disk's signature, eight hex digits.
    """
    root = kernel_words(disk_id, "$part", "$sectors", "$verity")
    return f"""serial --unit=0 --speed=115200
terminal_input serial console
terminal_output serial console
set slot=a
load_env --file ($root)/{slots.FILE} good try starts
if [ -n "$good" ]; then set slot=$good; fi
if [ -n "$try" ]; then
  set slot=$try
  set try=
elif [ "$starts" = xxx ]; then
  echo "evbotos: slot $slot did not come up three times"
  set starts=x
  if [ "$slot" = a ]; then set slot=b; else set slot=a; fi
else
  set starts="${{starts}}x"
fi
save_env --file ($root)/{slots.FILE} try starts
for turn in 1 2; do
  if [ "$slot" = b ]; then set part=03; else set part=02; fi
  set verity=
  load_env --file ($root)/root-$slot.env sectors verity
  if [ -n "$verity" ]; then
    echo "evbotos: slot $slot"
    if linux ($root)/vmlinuz-$slot {root} {kernel_line} evbotos.slot=$slot; then boot; fi
  else
    echo "evbotos: no verified system in the other slot, $slot"
  fi
  if [ "$slot" = a ]; then set slot=b; else set slot=a; fi
done
reboot
"""


def write_images(packages: Mapping[str, Path], out: Path) -> None:
    """Write GRUB's images; they load the menu from the first partition of their disk.

    Args:
        packages: the files of the Debian packages by name; the one for UEFI may be absent.
        out: the output folder, created here.

    Raises:
        BuildError: a package or grub-mkimage is unsuitable.
    """
    out.mkdir(parents=True)
    with _modules(packages, GRUB_PACKAGE, "i386-pc") as parts:
        if not (parts / _BOOT).is_file():
            raise BuildError(f"{GRUB_PACKAGE} has no file {_BOOT}")
        early = parts / "early.cfg"
        early.write_text("set root=(hd0,msdos1)\nset prefix=($root)/grub\nconfigfile $prefix/grub.cfg\n")
        shutil.copyfile(parts / _BOOT, out / _BOOT)
        _make_image("i386-pc", parts, out / _CORE, "-p", "(hd0,msdos1)/grub", "-c", early, "biosdisk")
    if GRUB_EFI_PACKAGE in packages:
        with _modules(packages, GRUB_EFI_PACKAGE, "x86_64-efi") as parts:
            _make_image("x86_64-efi", parts, out / EFI, "-p", "/grub")  # of the disk that it was started from


@contextmanager
def _modules(packages: Mapping[str, Path], name: str, kind: str) -> Iterator[Path]:
    """Unpack a package during a `with` block, and return the folder of its modules."""
    with TemporaryDirectory() as folder:
        run([tool("dpkg-deb"), "-x", packages[name], folder])
        yield Path(folder) / "usr/lib/grub" / kind


def _make_image(kind: str, parts: Path, out: Path, *more: str | Path) -> None:
    run([tool("grub-mkimage"), "-O", kind, "-d", parts, "-o", out, *more, *_MODULES.split()])


def install(image: Path, images: Path, first_partition: int) -> None:
    """Write GRUB before the first partition of a disk image.

    Args:
        image: the partitioned disk image.
        images: the output folder of `write_images`.
        first_partition: its offset in sectors.

    Raises:
        BuildError: the gap is too small.
    """
    core = (images / _CORE).read_bytes()
    sectors = -(-len(core) // SECTOR)
    if 1 + sectors > first_partition:
        raise BuildError(f"GRUB needs {sectors} sectors, but only {first_partition - 1} precede the first partition")
    boot = bytearray((images / _BOOT).read_bytes())
    struct.pack_into("<Q", boot, _KERNEL_SECTOR, 1)
    first = bytearray(core.ljust(sectors * SECTOR, b"\0"))
    struct.pack_into("<QHH", first, _BLOCK_LIST, 2, sectors - 1, _CORE_SEGMENT)
    with image.open("r+b") as file:
        file.write(boot[:_CODE_SIZE])
        file.seek(SECTOR)
        file.write(first)
