"""dm-verity: a hash tree behind the root file system, with which the kernel verifies every block that it reads.

The boot loader passes the root hash from the slot's hash file. A slot without a hash does not start, so an update
clears the hash before its first byte and writes it after its last check.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.hashing import file_sha256
from evbotos.hosttools import tool
from evbotos.shell import run

DEVICE: Final = "/dev/dm-0"
"""The verified root in the booted system."""
ROOT: Final = "root.squashfs"
BLOCK: Final = 4096
_IDENTITY: Final = "verity.json"
_SECTORS_OF_BLOCK: Final = BLOCK // 512
_UUID: Final = "45564f53-da7a-4000-8000-000000000005"
_ROOT_HASH: Final = re.compile(r"^Root hash:\s+([0-9a-f]{64})$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Verity:
    """The identity of a root file system.

    Attributes:
        blocks: the number of blocks of 4096 bytes before the hash tree.
        root_hash: the hash of the tree's root, which covers every block.
        salt: the salt of each hash.
    """

    blocks: int
    root_hash: str
    salt: str

    @property
    def sectors(self) -> int:
        """The size of the verified device in sectors."""
        return self.blocks * _SECTORS_OF_BLOCK

    @property
    def table(self) -> str:
        """The end of the device-mapper table. A changed block stops the kernel, which starts anew."""
        start = self.blocks + 1  # a block of veritysetup's own precedes the tree
        sizes = f"{BLOCK} {BLOCK} {self.blocks} {start}"
        return f"{sizes} sha256 {self.root_hash} {self.salt} 1 panic_on_corruption"

    def hash_file(self) -> dict[str, str]:
        """Return the variables of the slot's hash file for the boot loader."""
        return {"sectors": str(self.sectors), "verity": self.table}


def append_hashes(squashed: Path, out: Path) -> None:
    """Write a root file system with its hash tree behind it, and its identity, reproducibly.

    Args:
        squashed: the compressed root file system.
        out: the folder for both files, created here.

    Raises:
        BuildError: veritysetup failed.
    """
    out.mkdir(parents=True)
    root = Path(shutil.copyfile(squashed, out / ROOT))
    salt = file_sha256(root)[:32]
    blocks = -(-root.stat().st_size // BLOCK)
    os.truncate(root, blocks * BLOCK)
    options = (f"--hash-offset={blocks * BLOCK}", f"--salt={salt}", f"--uuid={_UUID}")
    match = _ROOT_HASH.search(run([tool("veritysetup"), "format", *options, root, root]))
    if match is None:
        raise BuildError("veritysetup reports no root hash")
    (out / _IDENTITY).write_text(json.dumps(asdict(Verity(blocks, match[1], salt))))


def read_verity(folder: Path) -> Verity:
    """Return the identity of the root file system in a folder of `append_hashes`."""
    return Verity(**json.loads((folder / _IDENTITY).read_text()))


def kernel_words(disk_id: str, number: str, sectors: str, table: str, quote: str = '"') -> str:
    """Return the words of the kernel's command line that verify and mount a slot; arguments may be loader variables.

    Args:
        disk_id: the disk's signature, eight hex digits.
        number: the partition's number, two digits.
        sectors: the size of the device.
        table: the end of the device-mapper table.
        quote: a quotation mark in the loader's language.
    """
    slot = f"PARTUUID={disk_id}-{number}"
    created = f"root,,,ro,0 {sectors} verity 1 {slot} {slot} {table}"
    return f"root={DEVICE} rootfstype=squashfs dm-mod.waitfor={slot} dm-mod.create={quote}{created}{quote}"
