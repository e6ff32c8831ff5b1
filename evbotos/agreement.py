"""Both ways to an image agree: what the OpenEmbedded layers install follows from the same definitions.

`openembedded/agreement.yaml` says how packages, services and boards are called there; the package groups, images and
project files are made out of it and of the definitions: `python -m evbotos.agreement --write`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.strict_model import NAMES_ONLY, StrictModel, Version1, problems_from
from eal_actors.kernel.yaml_source import load_yaml
from evbotos.definitions import Definitions, load_definitions
from evbotos.model import Image
from evbotos.plan import ROOTFS

FOLDER: Final = Path(__file__).parent / "openembedded"
PLUGINS: Final = Path(__file__).parent.parent / "plugins"
_DISTRO: Final = "meta-evbotos-distro"
_MADE: Final = "# Made by `python -m evbotos.agreement --write` out of the definitions; edit those.\n\n"
_ROOTFS: Final = "evbotos-rootfs"
_PROJECT: Final = "python3-eal-actors"
_HEAVY: Final = {"cv2", "mcap"}

Names = Annotated[tuple[str, ...], Field(strict=False)]


class Machine(StrictModel):
    """How a platform is called there."""

    machine: str
    tune: str
    """Of the compiler."""
    layers: Names
    """That only this one needs."""


class Agreement(StrictModel):
    """Names here, and names there."""

    version: Version1
    series: Literal["scarthgap", "wrynose"]
    packages: dict[str, Names] = Field(json_schema_extra=NAMES_ONLY)
    """By Debian's name."""
    wheels: dict[str, str] = Field(json_schema_extra=NAMES_ONLY)
    """By the name in the package index."""
    modules: dict[str, str] = Field(json_schema_extra=NAMES_ONLY)
    """By the name that plugins import; empty where there is no recipe."""
    provided: Names
    """Files of the root that other packages bring there."""
    in_sbin: Names
    """Programs that are elsewhere there."""
    machines: dict[str, Machine] = Field(json_schema_extra=NAMES_ONLY)
    """By platform."""


_LAYERS: Final = {"meta-raspberrypi": ("https://git.yoctoproject.org/meta-raspberrypi", "master")}
"""Where further layers are, and their branch; meta-raspberrypi has none for the series yet."""


def load_agreement(folder: Path = FOLDER) -> Agreement:
    """Read agreement.yaml.

    Raises:
        ConfigError: with every problem of it.
    """
    tree = load_yaml(folder / "agreement.yaml")
    try:
        return Agreement.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, Agreement)) from None


def disagreements(definitions: Definitions, agreement: Agreement) -> list[Problem]:
    """Return what the definitions name and agreement.yaml does not, and the other way round."""
    images = definitions.images.values()
    pairs = (
        ("packages", {name for image in images for name in image.packages}, set(agreement.packages)),
        ("wheels", {name for image in images for name in image.wheels}, set(agreement.wheels)),
        ("machines", set(definitions.platforms), set(agreement.machines)),
    )
    problems = []
    for key, here, there in pairs:
        for name in sorted(here ^ there):
            words = "has no counterpart" if name in here else "is in no definition any more"
            problems.append(Problem("agreement.yaml", 0, 0, f"{key}.{name}", words))
    return problems


def generated(definitions: Definitions, agreement: Agreement) -> dict[str, str]:
    """Return the generated files, by their path below `openembedded/`.

    Raises:
        ConfigError: the definitions name what agreement.yaml does not know.
    """
    problems = disagreements(definitions, agreement)
    if problems:
        raise ConfigError(problems)
    groups = f"{_DISTRO}/recipes-core/packagegroups/packagegroup-evbotos.bb"
    files = {
        groups: _package_groups(definitions, agreement),
        f"{_DISTRO}/recipes-evbotos/evbotos-rootfs/evbotos-services.inc": _services(definitions, agreement),
        f"{_DISTRO}/recipes-evbotos/eal-actors/eal-actors-plugins.inc": _plugins(agreement),
    }
    for image in definitions.images.values():
        files[f"{_DISTRO}/recipes-core/images/evbotos-image-{image.name}.bb"] = _image(image)
    for platform, machine in agreement.machines.items():
        files[f"kas/{platform}.yml"] = _project(machine)
    return files


def installed_by(image: Image, agreement: Agreement) -> list[str]:
    """Return the packages of an image, as they are called there."""
    names = {name for package in image.packages for name in agreement.packages[package]}
    names |= {agreement.wheels[wheel] for wheel in image.wheels}
    names |= {_ROOTFS, *(f"{_ROOTFS}-{service}" for service in image.services)}
    if image.project:
        names |= {_PROJECT, f"{_PROJECT}-plugins"}
    return sorted(names)


def _package_groups(definitions: Definitions, agreement: Agreement) -> str:
    names = [f"${{PN}}-{name}" for name in sorted(definitions.images)]
    text = _MADE + 'SUMMARY = "What each image installs"\n'
    text += 'DESCRIPTION = "One package group for each image of the definitions."\nSECTION = "base"\n\n'
    text += 'PACKAGE_ARCH = "${MACHINE_ARCH}"\n\ninherit packagegroup\n\n'
    text += _assigned("PACKAGES", names)
    for name, image in sorted(definitions.images.items()):
        text += "\n" + _assigned(f"RDEPENDS:${{PN}}-{name}", installed_by(image, agreement))
    return text


def _image(image: Image) -> str:
    layout = image.layout
    return (
        f'{_MADE}SUMMARY = "EvBotOS: {image.name}"\n'
        f'DESCRIPTION = "{image.description.replace("`", "")}."\n\n'
        "require evbotos-image.inc\n\n"
        f'IMAGE_INSTALL = "packagegroup-evbotos-{image.name}"\n\n'
        "# MiB, of the disk's parts.\n"
        f'EVBOTOS_BOOT_MIB = "{layout.boot}"\n'
        f'EVBOTOS_SLOT_MIB = "{layout.slot}"\n'
        f'EVBOTOS_DATA_MIB = "{layout.data}"\n'
    )


def _services(definitions: Definitions, agreement: Agreement) -> str:
    services = sorted({name for image in definitions.images.values() for name in image.services})
    text = _MADE + _assigned("EVBOTOS_SERVICES", services) + _assigned("EVBOTOS_PROVIDED", agreement.provided)
    text += _assigned("EVBOTOS_IN_SBIN", agreement.in_sbin) + "\n"
    text += _assigned("PACKAGES", [*(f"${{PN}}-{name}" for name in services), "${PN}"])
    for name in services:
        folder = ROOTFS / "services" / name
        paths = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())
        files = [f"/{path}" for path in sorted(paths) if path != "inittab" and "__pycache__" not in path]
        text += "\n" + _assigned(f"FILES:${{PN}}-{name} +=", [*files, f"/etc/evbotos/inittab.d/{name}"])
    return text + "\n" + "".join(f'RDEPENDS:${{PN}}-{name} += "${{PN}}"\n' for name in services)


def _plugins(agreement: Agreement, folder: Path = PLUGINS) -> str:
    """Return a package for each plugin, with those of the modules and plugins that its manifest names."""
    manifests: dict[str, Any] = {
        path.parent.name: load_yaml(path).root for path in sorted(folder.glob("*/plugin.yaml"))
    }
    names = [f"${{PN}}-plugin-{name.replace('_', '-')}" for name in manifests]
    text = _MADE + _assigned("PACKAGES =+", ["${PN}-plugins", *names])
    text += '\nALLOW_EMPTY:${PN}-plugins = "1"\n'
    for package, name in zip(names, manifests, strict=True):
        text += f'FILES:{package} += "${{PYTHON_SITEPACKAGES_DIR}}/eal_actors/_bundled/plugins/{name}"\n'
    text += "\n" + _assigned("RDEPENDS:${PN}-plugins +=", _light(names, manifests))
    for package, manifest in zip(names, manifests.values(), strict=True):
        wanted = [agreement.modules[module] for module in manifest.get("requires", ())]
        uses = [f"${{PN}}-plugin-{other.replace('_', '-')}" for other in manifest.get("uses", ())]
        text += _assigned(f"RDEPENDS:{package} +=", sorted(["${PN}", *filter(None, wanted), *uses]))
    return text


def _light(names: list[str], manifests: dict[str, Any]) -> list[str]:
    """Return the packages of plugins that every robot gets: those with heavy libraries are asked for by name."""
    return [
        name
        for name, manifest in zip(names, manifests.values(), strict=True)
        if not _HEAVY & {*manifest.get("requires", ())}
    ]


def _project(machine: Machine) -> str:
    text = f"{_MADE}header:\n  version: 14\n  includes:\n    - evbotos/openembedded/kas/common.yml\n"
    text += f"machine: {machine.machine}\n"
    if machine.layers:
        text += "repos:\n"
    for layer in machine.layers:
        url, branch = _LAYERS[layer]
        text += f"  {layer}:\n    url: {url}\n    branch: {branch}\n"
    return text


def _assigned(name: str, values: Iterable[str]) -> str:
    operator = "" if name.endswith(("=", "=+")) else " ="
    return "".join([f'{name}{operator} "\\\n', *(f"    {value} \\\n" for value in values), '"\n'])


def main(arguments: list[str]) -> int:
    """Compare the generated files with what is there, or write them with `--write`; returns the exit code."""
    files = generated(load_definitions(), load_agreement())
    stale = {name: text for name, text in files.items() if _text_of(FOLDER / name) != text}
    if "--write" in arguments:
        for name, text in stale.items():
            (FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
            (FOLDER / name).write_text(text)
    for name in stale:
        sys.stdout.write(f"{'written' if '--write' in arguments else 'differs'}: {name}\n")
    return 0 if "--write" in arguments or not stale else 1


def _text_of(path: Path) -> str:
    return path.read_text() if path.is_file() else ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
