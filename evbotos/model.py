"""Models of the definitions: platforms, images and a user's `local.yaml`."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import PurePath
from typing import Annotated, Any, Final, Literal

from pydantic import (
    Discriminator,
    Field,
    NonNegativeInt,
    PositiveFloat,
    Tag,
    ValidationInfo,
    field_validator,
)

from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1
from evbotos.fields import (
    KERNEL_MB,
    LARGEST_MIB,
    MACHINES,
    SMALLEST_BOOT_MIB,
    File,
    FileName,
    Folder,
    Fragments,
    LayerName,
    Mebibytes,
    Mirror,
    Overlays,
    PackageName,
    PackagePattern,
    ServiceName,
    SshKey,
    Text,
    Texts,
    WheelName,
)
from evbotos.wireless import Wifi

GRUB_PACKAGE: Final = "grub-pc-bin"
GRUB_EFI_PACKAGE: Final = "grub-efi-amd64-bin"
"""The Debian packages that boot a PC: by its BIOS, and a 64-bit one by its UEFI."""

Architecture = Literal["amd64", "arm64", "armhf", "i386"]
"""As Debian names it."""


class Kernel(StrictModel):
    """A kernel compiled from Debian's source, with all drivers built in and no modules."""

    source: PackageName
    """The source package, such as `linux-source-6.1`."""
    architecture: Literal["x86_64", "i386", "arm", "arm64"]
    """As the kernel names it."""
    cross: Text | None = None
    """The prefix of a cross compiler, such as `arm-linux-gnueabihf-`."""
    base: Literal["tinyconfig", "allnoconfig"] = "tinyconfig"
    fragments: Fragments
    """Files of `evbotos/kernel/`; later ones override earlier ones."""
    image: Text
    """The build target, relative to the source."""
    device_trees: Texts = ()
    """Device trees to build, relative to the source's `arch/<architecture>/boot/dts`."""

    @property
    def origin(self) -> str:
        """The Debian package of the kernel."""
        return self.source

    @property
    def file(self) -> str:
        """The file name of the kernel image."""
        return PurePath(self.image).name


class PackagedKernel(StrictModel):
    """Debian's kernel: no compilation, but several times the size.

    An initial RAM disk loads the modules that find the root. QEMU loads this kernel directly.
    """

    package: PackageName
    """The package, such as `linux-image-cloud-amd64`."""
    modules: Texts
    """Modules to load before mounting the root, in addition to their dependencies; parameters may follow a name."""
    device_trees: Texts = ()
    """The device trees to keep, such as `sun4i-a10-cubieboard.dtb`."""

    @property
    def origin(self) -> str:
        """The Debian package of the kernel."""
        return self.package

    @property
    def file(self) -> str:
        """The file name of the kernel image."""
        return "vmlinuz"


def _kind_of_kernel(value: object) -> str:
    return "packaged" if isinstance(value, PackagedKernel | dict) and "package" in dict(value) else "compiled"


AnyKernel = Annotated[
    Annotated[Kernel, Tag("compiled")] | Annotated[PackagedKernel, Tag("packaged")], Discriminator(_kind_of_kernel)
]


class EmulatorLoader(StrictModel):
    """The boot loader in the form that QEMU starts; QEMU does not run a board's ROM."""

    package: PackageName
    """The Debian package of the loader."""
    file: Text
    skip: NonNegativeInt = 0
    """The number of bytes to skip, such as a stage that initializes memory."""
    blank: Texts = ()
    """Words that QEMU's machine does not support; they are overwritten with spaces."""
    arguments: Texts
    """QEMU's arguments; `{loader}` is the loader's file, `{device_tree}` the emulator's device tree."""


class Emulator(StrictModel):
    """QEMU's emulation of the board."""

    program: Literal["qemu-system-x86_64", "qemu-system-i386", "qemu-system-arm", "qemu-system-aarch64"]
    machine: Text
    cpu: Text | None = None
    cpus: Annotated[int, Field(gt=0, le=16)] = 1
    memory_mb: Annotated[int, Field(ge=16, le=65536)] = 128
    network: Text = "virtio-net-pci"
    """The network card by its `-device` name; a built-in card by its `-net nic,model=` name."""
    network_on_board: bool = False
    """Whether the network card is built in."""
    disk: Literal["virtio-blk-pci", "ide-hd", "nvme", "sd"] = "virtio-blk-pci"
    """The disk by its `-device` name, or `sd` for a card in the board's slot."""
    device_tree: Text | None = None
    """The kernel's device tree of this machine; None if QEMU generates one or none is needed."""
    lacks: Texts = ()
    """Device tree nodes that QEMU's machine lacks or implements differently."""
    serial: NonNegativeInt = 0
    """The number of QEMU's serial port with the console."""
    loader: EmulatorLoader | None = None
    """The boot loader if it does not start from the disk; None if QEMU has a BIOS."""
    watchdog: Text | None = None
    """The watchdog by its `-device` name."""
    has_pci: bool = True
    """Whether the machine has a bus for a random number generator and a USB controller."""


class OwnWifi(StrictModel):
    """Drivers and firmware of the Wi-Fi of a board, for images with the service `wifi`."""

    packages: Annotated[tuple[PackageName, ...], Field(strict=False)]
    """Its firmware."""
    kernel_fragments: Fragments
    """Files of `evbotos/kernel/` with its drivers."""


class Platform(StrictModel):
    """A kind of board."""

    version: Version1
    name: Name
    description: Text
    architecture: Architecture
    suite: Literal["bookworm", "trixie"] = "bookworm"
    """Of Debian: of the root, the kernel, the boot files and the firmware."""
    backports: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    """Source packages whose versions are those of the suite's backports, for a board that needs newer ones."""
    wheel_tags: Texts
    """The tags of compatible Python wheels, best first."""
    floor: Text
    """The minimum hardware, for people."""
    kernel: AnyKernel
    boot: Literal["grub", "u-boot"]
    """The loader of the kernel."""
    console: Text | None = None
    """The kernel's name of the serial console; None if the device tree defines it."""
    kernel_arguments: Texts = ()
    """Further words of the kernel's command line."""
    compiled_wheels: dict[PackageName, Texts] = Field(default={})
    """Python packages without a wheel for this platform, with their build tools."""
    boot_files: dict[PackageName, dict[Text, FileName]] = Field(default={})
    """The files that the board's ROM loads, by Debian package, with their names on the boot partition."""
    boot_texts: dict[FileName, Text] = Field(default={})
    """Text files on the boot partition by name, for these loaders."""
    components: Texts = ()
    """Archive components besides `main`, such as `non-free-firmware`."""
    packages: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    """The packages of every image of this platform."""
    wifi: OwnWifi | None = None
    """The Wi-Fi of the board itself; None if it has none."""
    camera_fragments: Fragments = ()
    """Files of `evbotos/kernel/` with the drivers of the board's cameras on a cable, for images with libcamera."""
    overlays: Overlays = ()
    """Device tree overlays: files of `evbotos/overlays/` or others; later ones override earlier ones."""
    firmware_overlays: Overlays = ()
    """Overlays that the board's firmware applies where it finds fit: `overlays/NAME.dtbo` on the boot partition."""
    emulator: Emulator | None = None

    @field_validator("wheel_tags", "kernel", "boot", "emulator")
    @classmethod
    def _fits_the_architecture(cls, value: Any, info: ValidationInfo) -> Any:
        machine = MACHINES.get(info.data.get("architecture", ""))
        if machine is None:  # reported already
            return value
        if info.field_name == "wheel_tags" and (wrong := [tag for tag in value if not tag.endswith(machine.wheels)]):
            raise ValueError(f"wheels of {info.data['architecture']} end in {machine.wheels}, not {wrong[0]!r}")
        if isinstance(value, Kernel) and value.architecture != machine.kernel:
            raise ValueError(f"is for {value.architecture}, but the platform's kernel is for {machine.kernel}")
        if info.field_name == "boot" and (value == "grub") != machine.is_pc:
            raise ValueError(f"{info.data['architecture']} is started by {'grub' if machine.is_pc else 'u-boot'}")
        if isinstance(value, Emulator) and value.program != machine.emulator:
            raise ValueError(f"{info.data['architecture']} is emulated by {machine.emulator}, not {value.program}")
        return value

    @property
    def python(self) -> str:
        """The version of the suite's Python."""
        return {"bookworm": "3.11", "trixie": "3.13"}[self.suite]

    @property
    def loader(self) -> Literal["grub", "u-boot", "none"]:
        """The kernel's loader: `boot`, except that QEMU loads a packaged kernel directly."""
        return self.boot if isinstance(self.kernel, Kernel) else "none"

    @property
    def emulator_loader(self) -> EmulatorLoader | None:
        """The loader that QEMU starts instead of a board's ROM, unless it loads the kernel directly."""
        return self.emulator.loader if self.emulator is not None and self.loader != "none" else None

    @property
    def needs_stand_ins(self) -> bool:
        """Whether QEMU needs a substitute for the board's boot loader or device tree."""
        return self.emulator_loader is not None or (self.emulator is not None and self.emulator.device_tree is not None)

    @property
    def disk_packages(self) -> tuple[str, ...]:
        """Debian packages with boot files on the disk: GRUB, or U-Boot and its loaders."""
        pc = (GRUB_PACKAGE, GRUB_EFI_PACKAGE) if self.architecture == "amd64" else (GRUB_PACKAGE,)
        return {"grub": pc, "u-boot": tuple(self.boot_files), "none": ()}[self.loader]

    @property
    def firmware(self) -> tuple[str, ...]:
        """Debian packages with firmware of the board, for images that need it."""
        return self.wifi.packages if self.wifi is not None else ()

    @property
    def boot_packages(self) -> tuple[str, ...]:
        """Debian packages whose files boot the board or its emulator."""
        stand_in = self.emulator_loader
        return tuple(sorted({*self.disk_packages, *([stand_in.package] if stand_in else [])}))


class PlatformOverride(StrictModel):
    """A user's changes to a platform."""

    kernel: AnyKernel | None = None
    overlays: Overlays = ()
    """Further overlays."""


class Budget(StrictModel):
    """The size limits of an image in MB (10^6 bytes)."""

    root_with_kernel: PositiveFloat
    memory: PositiveFloat | None = None


class Layout(StrictModel):
    """Sizes of the disk's parts, in MiB."""

    boot: Annotated[int, Field(ge=SMALLEST_BOOT_MIB, le=LARGEST_MIB)] = 16
    slot: Mebibytes = 48
    data: Annotated[int, Field(ge=2, le=LARGEST_MIB)] = 15


class Image(StrictModel):
    """The contents of a root file system. Later files of `include` override earlier ones; the image overrides all."""

    version: Version1
    name: Name
    description: Text
    include: Texts = ()
    """Names of base images: lists are joined, other values overridden."""
    architectures: Annotated[tuple[Architecture, ...], Field(strict=False)] = ()
    """The architectures of its platforms, by default those of the included images; empty for all."""
    packages: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    """Debian packages, installed with their dependencies but without recommendations."""
    drop_packages: Annotated[tuple[PackagePattern, ...], Field(strict=False)] = ()
    """Patterns of unneeded dependencies to leave out, such as dpkg; `packages`, also a user's, override them."""
    wheels: Annotated[tuple[WheelName, ...], Field(strict=False)] = ()
    """Python packages, installed with their dependencies."""
    project: bool = False
    """Whether the image, like what builds on it, contains this project with its plugins and fleets."""
    services: Annotated[tuple[ServiceName, ...], Field(strict=False)] = ()
    """Services started at boot: folders of `evbotos/rootfs/services`."""
    files: Annotated[tuple[LayerName, ...], Field(strict=False)] = ()
    """Further folders of `evbotos/rootfs` to copy onto the root."""
    kernel_fragments: Fragments = ()
    """Files of `evbotos/kernel/` in addition to the platform's, for a kernel compiled from source."""
    prune: Texts = ()
    """Patterns of paths to leave out."""
    keep: Texts = ()
    """Patterns of paths to keep; they override `prune`."""
    sourceless: bool = True
    """Keep only compiled Python: half the size, a fast start, but no source lines in tracebacks."""
    compression: Literal["zstd", "xz"] = "zstd"
    """The compression of the root: xz is a sixth smaller, and slower to read."""
    check: Texts = ()
    """Commands that must succeed in the booted image; they detect excessive pruning."""
    budget_mb: Budget
    layout: Layout = Layout()

    def leaves_out(self, package: str) -> bool:
        """Return whether a package is left out. Debian 13 appends `t64` to names of libraries with 64-bit times."""
        name = package.removesuffix("t64")
        return name not in self.packages and any(fnmatchcase(name, pattern) for pattern in self.drop_packages)

    @field_validator("layout")
    @classmethod
    def _holds_the_root(cls, value: Layout, info: ValidationInfo) -> Layout:
        budget = info.data.get("budget_mb")
        if budget is not None and value.slot * (1 << 20) < (budget.root_with_kernel - KERNEL_MB) * 1e6:
            raise ValueError(f"a slot of {value.slot} MiB is smaller than a root of {budget.root_with_kernel:g} MB")
        return value


class ImageOverride(StrictModel):
    """A user's changes to an image."""

    packages: Annotated[tuple[PackageName, ...], Field(strict=False)] = ()
    wheels: Annotated[tuple[WheelName, ...], Field(strict=False)] = ()
    services: Annotated[tuple[ServiceName, ...], Field(strict=False)] = ()
    budget_mb: Budget | None = None
    layout: Layout | None = None


class Local(StrictModel):
    """A user's `local.yaml`, which overrides everything (like OpenEmbedded's local overlay)."""

    version: Version1
    mirror: Mirror | None = None
    """A package mirror that replaces the build machine's apt configuration."""
    cache: Text | None = None
    """The cache folder; defaults to the user's cache folder."""
    ssh_keys: Annotated[tuple[SshKey, ...], Field(strict=False)] = ()
    """Public keys with login permission, in the format of authorized_keys."""
    robot: Folder | None = None
    """A folder with a robot's own files (`fleet.yaml`, keys, `name`), copied to the boot partition."""
    update_key: File | None = None
    """The public key (ed25519, PEM) that verifies updates; without a key the robot accepts no updates."""
    wifi: Wifi | None = None
    """The robot's wireless networks, for images with the service `wifi`."""
    images: dict[Name, ImageOverride] = Field(default={}, json_schema_extra=NAMES_ONLY)
    platforms: dict[Name, PlatformOverride] = Field(default={}, json_schema_extra=NAMES_ONLY)


LISTS: Final = (
    "packages",
    "drop_packages",
    "wheels",
    "services",
    "files",
    "kernel_fragments",
    "prune",
    "keep",
    "check",
)
"""Keys of an image that are joined with those of its included images."""
