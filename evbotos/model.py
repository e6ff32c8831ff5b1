"""What the definitions say: platforms, images, and a user's own `local.yaml`."""

from __future__ import annotations

from pathlib import PurePath
from typing import Annotated, Any, Final, Literal

from pydantic import Discriminator, Field, NonNegativeInt, PositiveFloat, PositiveInt, Tag

from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1

GRUB_PACKAGE: Final = "grub-pc-bin"
"""Debian's, with what starts a PC."""

Architecture = Literal["amd64", "arm64", "armhf", "i386"]
"""As Debian names it."""

Text = Annotated[str, Field(min_length=1)]
Texts = Annotated[tuple[Text, ...], Field(strict=False)]
PackageName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9+.-]+$")]
WheelName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*(\[[a-z,]+\])?([=<>!~].*)?$")]


class Kernel(StrictModel):
    """A kernel of our own, built from Debian's source with everything in it that robots need, and no modules."""

    source: PackageName
    """The package with the source, such as `linux-source-6.1`."""
    architecture: Literal["x86_64", "i386", "arm", "arm64"]
    """As the kernel names it."""
    cross: Text | None = None
    """Prefix of the compiler where it is not the build machine's own, such as `arm-linux-gnueabihf-`."""
    base: Literal["tinyconfig", "allnoconfig"] = "tinyconfig"
    fragments: Texts
    """Files of `evbotos/kernel/`, later ones over earlier ones."""
    image: Text
    """What is built, relative to the source."""
    device_trees: Texts = ()
    """What else is built, relative to the source's `arch/<architecture>/boot/dts`."""

    @property
    def origin(self) -> str:
        """The package that it comes from."""
        return self.source

    @property
    def file(self) -> str:
        """The name of the image's file."""
        return PurePath(self.image).name


class PackagedKernel(StrictModel):
    """Debian's own kernel: nothing is compiled, but it is several times larger.

    What it needs to find the root are modules, which an initial RAM disk loads. The emulator starts it itself.
    """

    package: PackageName
    """Such as `linux-image-cloud-amd64`."""
    modules: Texts
    """What is loaded before the root is mounted; what they need comes along."""
    device_trees: Texts = ()
    """Which of the package's device trees are kept, such as `sun4i-a10-cubieboard.dtb`."""

    @property
    def origin(self) -> str:
        """The package that it comes from."""
        return self.package

    @property
    def file(self) -> str:
        """The name of the image's file."""
        return "vmlinuz"


def _kind_of_kernel(value: object) -> str:
    return "packaged" if isinstance(value, PackagedKernel | dict) and "package" in dict(value) else "compiled"


AnyKernel = Annotated[
    Annotated[Kernel, Tag("compiled")] | Annotated[PackagedKernel, Tag("packaged")], Discriminator(_kind_of_kernel)
]


class EmulatorLoader(StrictModel):
    """The boot loader as QEMU starts it: what a board's ROM does before that, QEMU does not."""

    package: PackageName
    """The Debian package that has it."""
    file: Text
    skip: NonNegativeInt = 0
    """How many bytes of the file come before it, such as a stage that sets up a memory which QEMU has anyway."""
    blank: Texts = ()
    """Words of it that QEMU's machine does not bear, to be overwritten with spaces."""
    arguments: Texts
    """QEMU's; `{loader}` is the loader's file, `{device_tree}` the emulator's device tree."""


class Emulator(StrictModel):
    """How QEMU stands in for the board."""

    program: Text
    machine: Text
    cpu: Text | None = None
    cpus: PositiveInt = 1
    memory_mb: PositiveInt = 128
    network: Text = "virtio-net-pci"
    """The network card, as `-device` names it; of a board that has it soldered on, as `-net nic,model=` does."""
    network_on_board: bool = False
    """Whether the network card is part of the machine."""
    disk: Literal["virtio-blk-pci", "ide-hd", "sd"] = "virtio-blk-pci"
    """The disk, as `-device` names it, or `sd` for a card in the board's own slot."""
    device_tree: Text | None = None
    """Of the kernel's, that which describes this machine; None where QEMU makes one, or none is needed."""
    lacks: Texts = ()
    """Nodes of the device tree that QEMU's machine does not have, or not as the board does."""
    serial: NonNegativeInt = 0
    """Which of QEMU's serial ports the console is."""
    loader: EmulatorLoader | None = None
    """The boot loader, where it does not start from the disk; None where QEMU has a BIOS."""
    watchdog: Text | None = None
    """The watchdog, as `-device` names it."""
    has_pci: bool = True
    """Whether there is a bus for a source of randomness and for a USB controller, into which sticks can be plugged."""


class Platform(StrictModel):
    """A kind of board."""

    version: Version1
    name: Name
    description: Text
    architecture: Architecture
    suite: Text = "bookworm"
    """Of Debian."""
    wheel_tags: Texts
    """Of Python wheels that run on it, the best first."""
    floor: Text
    """The least that a board must have, plainly."""
    kernel: AnyKernel
    boot: Literal["grub", "u-boot"]
    """What loads the kernel from the disk."""
    console: Text | None = None
    """Serial console, as the kernel names it; None where the board's device tree says which it is."""
    kernel_arguments: Texts = ()
    """What else the kernel is told when it starts."""
    compression: Literal["zstd", "xz"] = "zstd"
    """Of the root file system: xz is smaller, zstd starts several times faster."""
    compiled_wheels: dict[PackageName, Texts] = Field(default={})
    """Python packages of which there is no wheel for it, so that they are compiled, and by what."""
    boot_files: dict[PackageName, dict[Text, Text]] = Field(default={})
    """What the board's ROM loads first: by Debian package, its files and their names on the boot partition."""
    boot_texts: dict[Text, Text] = Field(default={})
    """What that reads: text files on the boot partition, by name."""
    components: Texts = ()
    """Of the archive, besides `main`: firmware that is not free lies in `non-free-firmware`."""
    packages: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    """What every image of this platform has."""
    emulator: Emulator | None = None

    @property
    def loader(self) -> Literal["grub", "u-boot", "none"]:
        """What loads the kernel: `boot`, but that QEMU itself loads a packaged one."""
        return self.boot if isinstance(self.kernel, Kernel) else "none"

    @property
    def emulator_loader(self) -> EmulatorLoader | None:
        """What QEMU starts in place of a board's ROM, if it does not load the kernel itself."""
        return self.emulator.loader if self.emulator is not None and self.loader != "none" else None

    @property
    def needs_stand_ins(self) -> bool:
        """Whether QEMU must be given a boot loader or a device tree in place of the board's."""
        return self.emulator_loader is not None or (self.emulator is not None and self.emulator.device_tree is not None)

    @property
    def disk_packages(self) -> tuple[str, ...]:
        """Debian packages whose files lie on the disk before any system does: GRUB, or U-Boot and what starts it."""
        return {"grub": (GRUB_PACKAGE,), "u-boot": tuple(self.boot_files), "none": ()}[self.loader]

    @property
    def boot_packages(self) -> tuple[str, ...]:
        """Debian packages whose files start the board or its emulator."""
        stand_in = self.emulator_loader
        return tuple(sorted({*self.disk_packages, *([stand_in.package] if stand_in else [])}))


class PlatformOverride(StrictModel):
    """What a user changes of a platform."""

    kernel: AnyKernel


class Budget(StrictModel):
    """What an image may take, in MB of 10^6 bytes."""

    root_with_kernel: PositiveFloat
    memory: PositiveFloat | None = None


class Layout(StrictModel):
    """Sizes of the disk's parts, in MiB."""

    boot: PositiveInt = 16
    slot: PositiveInt = 48
    data: PositiveInt = 15


class Image(StrictModel):
    """What a root file system holds. A later file of `include` overrides earlier ones, and the image overrides all."""

    version: Version1
    name: Name
    description: Text
    include: Texts = ()
    """Other images, by name, to build on: lists are joined, the rest is overridden."""
    packages: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    """Debian packages; what they depend on comes along, what they recommend does not."""
    drop_packages: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    """Dependencies that nothing in the image needs, such as dpkg."""
    wheels: Annotated[tuple[WheelName, ...], Field(strict=False)] = ()
    """Python packages, with what they depend on."""
    project: bool = False
    """Whether this project itself is installed, with its plugins and fleets."""
    services: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """What runs from the start: names of folders under `evbotos/rootfs/services`."""
    files: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Further folders of `evbotos/rootfs` that are laid over the root."""
    prune: Texts = ()
    """Patterns of paths to leave out."""
    keep: Texts = ()
    """Patterns of paths to keep although a pattern of `prune` fits."""
    sourceless: bool = True
    """Keep compiled Python alone: half the size, a fast start, and tracebacks without their source lines."""
    check: Texts = ()
    """Commands that must succeed in the booted image: what a pruner may have broken."""
    budget_mb: Budget
    layout: Layout = Layout()


class ImageOverride(StrictModel):
    """What a user changes of an image."""

    packages: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    wheels: Annotated[tuple[WheelName, ...], Field(strict=False)] = ()
    services: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    budget_mb: Budget | None = None
    layout: Layout | None = None


class Local(StrictModel):
    """A user's `local.yaml`, which wins over everything (as OpenEmbedded's local overlay does)."""

    version: Version1
    mirror: Text | None = None
    """Where packages come from, in place of the build machine's own apt configuration."""
    cache: Text | None = None
    """Folder of the cache, in place of the user's cache folder."""
    ssh_keys: Texts = ()
    """Public keys that may log in, as in authorized_keys."""
    robot: Text | None = None
    """Folder of what makes a robot of an image: `fleet.yaml`, its keys, `name`. It is laid on the boot partition."""
    update_key: Text | None = None
    """File with the public key (ed25519, PEM) whose updates the robot takes; without one it takes none."""
    images: dict[Name, ImageOverride] = Field(default={}, json_schema_extra=NAMES_ONLY)
    platforms: dict[Name, PlatformOverride] = Field(default={}, json_schema_extra=NAMES_ONLY)


LISTS: Final = ("packages", "drop_packages", "wheels", "services", "files", "prune", "keep", "check")
"""Keys of an image that are joined with those of the images that it includes."""


def schema_of(model: type[StrictModel]) -> dict[str, Any]:
    """Return the JSON Schema of a file."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()}
