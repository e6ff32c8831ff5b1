"""The OpenEmbedded layers: they say what the definitions say, and their linters find nothing."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from eal_actors.kernel.errors import ConfigError
from evbotos.agreement import FOLDER, disagreements, generated, installed_by, load_agreement
from evbotos.definitions import Definitions, load_definitions
from evbotos.plan import ROOTFS

LAYERS = ("meta-evbotos-bsp", "meta-evbotos-distro")
UPSTREAM = frozenset(
    {
        "binutils",
        "busybox",
        "busybox-mdev",
        "busybox-syslog",
        "dropbear",
        "gcc",
        "gcc-symlinks",
        "gdb",
        "git",
        "glibc",
        "libc6-dev",
        "linux-libc-headers-dev",
        "make",
        "python3-cffi",
        "python3-core",
        "python3-dev",
        "python3-modules",
        "python3-msgpack",
        "python3-numpy",
        "python3-opencv",
        "python3-psutil",
        "python3-pydantic",
        "python3-pyserial",
        "python3-pyyaml",
        "python3-rich",
        "python3-structlog",
        "python3-typer",
    }
)
"""Packages of openembedded-core and meta-openembedded."""


@pytest.fixture(scope="module")
def definitions() -> Definitions:
    return load_definitions()


def recipes(pattern: str = "*") -> list[Path]:
    return [path for kind in ("bb", "bbappend", "inc", "conf") for path in FOLDER.glob(f"meta-*/**/{pattern}.{kind}")]


def test_the_generated_files_are_what_the_definitions_say(definitions: Definitions) -> None:
    stale = [
        name for name, text in generated(definitions, load_agreement()).items() if (FOLDER / name).read_text() != text
    ]
    assert not stale, "python -m evbotos.agreement --write makes them anew"


def test_no_generated_file_is_left_of_a_definition_that_is_gone(definitions: Definitions) -> None:
    made = {
        path.relative_to(FOLDER).as_posix()
        for path in [*recipes(), *FOLDER.glob("kas/*.yml")]
        if path.read_text().startswith("# Made by")
    }
    assert made == set(generated(definitions, load_agreement()))


def test_every_package_exists_somewhere(definitions: Definitions) -> None:
    own = {re.sub(r"_[^_]*$", "", path.stem) for path in FOLDER.glob("meta-*/recipes-*/*/*.bb")}
    services = {f"evbotos-rootfs-{path.name}" for path in (ROOTFS / "services").iterdir()}
    agreement = load_agreement()
    for image in definitions.images.values():
        unknown = set(installed_by(image, agreement)) - own - services - UPSTREAM - {"python3-eal-actors-plugins"}
        assert not unknown, image.name
    assert set(filter(None, agreement.modules.values())) <= own | UPSTREAM


def test_a_new_package_and_a_forgotten_one_are_told(definitions: Definitions) -> None:
    agreement = load_agreement()
    robot = definitions.images["robot"].model_copy(update={"packages": ("strace",)})
    changed = replace(definitions, images={"robot": robot})
    told = [str(problem) for problem in disagreements(changed, agreement)]
    assert "agreement.yaml: packages.strace: has no counterpart" in told
    assert "agreement.yaml: packages.dropbear-bin: is in no definition any more" in told
    with pytest.raises(ConfigError, match=r"packages\.strace"):
        generated(changed, agreement)


def test_every_platform_has_a_machine_with_its_console_and_processor(definitions: Definitions) -> None:
    tunes = {
        "beagle-armhf": "armhf",
        "pc104-i686": "i386",
        "qemu-amd64": "amd64",
        "qemu-arm64": "arm64",
        "raspberry-pi": "arm64",
    }
    for name, machine in load_agreement().machines.items():
        platform = definitions.platforms[name]
        text = (FOLDER / f"meta-evbotos-bsp/conf/machine/{machine.machine}.conf").read_text()
        assert 'SERIAL_CONSOLES = "115200;tty' in text
        if platform.console is not None:  # else the device tree says it
            assert f'EVBOTOS_CONSOLE = "{platform.console}"' in text
            assert f";{platform.console}" in text
        assert tunes[name] == platform.architecture
        disk = re.search(r'WKS_FILE \??= "(.*)"', text)
        assert disk is not None
        wks = (FOLDER / "meta-evbotos-bsp/files/wic" / disk[1]).read_text()
        assert wks.count("EVBOTOS_SLOT_MIB") == 2
        assert platform.boot == "grub" or "bootimg_pcbios" not in wks


def test_the_root_names_every_program_of_the_inittabs() -> None:
    """What the services call is in the root, in busybox's folder, or linked from there."""
    called = {
        match
        for path in [ROOTFS / "base/etc/inittab", *ROOTFS.glob("services/*/inittab")]
        for match in re.findall(r":(/\S+)", path.read_text())
    }
    own = {
        f"/{path.relative_to(layer)}"
        for layer in (ROOTFS / "base", *ROOTFS.glob("services/*"))
        for path in layer.rglob("*")
    }
    linked = {f"/usr/bin/{name}" for name in load_agreement().in_sbin}
    assert called <= own | linked


@pytest.mark.parametrize("layer", LAYERS)
def test_a_layer_has_what_the_compatibility_check_asks_for(layer: str) -> None:
    folder, series = FOLDER / layer, load_agreement().series
    assert f'LAYERSERIES_COMPAT_{layer.removeprefix("meta-")} = "{series}"' in (folder / "conf/layer.conf").read_text()
    readme = (folder / "README.md").read_text()
    assert re.search("maintainer", readme, re.IGNORECASE)
    assert re.search("patch", readme, re.IGNORECASE)
    assert "depend" in readme.lower()
    assert (folder / "SECURITY.md").is_file()
    distro = (folder / "conf/distro").exists()
    assert distro != (folder / "conf/machine").exists(), "machines and policy live in layers of their own"


def test_every_source_has_a_hash() -> None:
    for path in FOLDER.glob("meta-*/recipes-*/*/*.bb"):
        text = path.read_text()
        if re.search(r"https?://\S+\.tar|GNU_MIRROR|inherit pypi", text):
            assert re.search(r'SRC_URI\[sha256sum\] = "[0-9a-f]{64}"', text), path.name
    crates = next(iter(recipes("*-crates"))).read_text()
    assert crates.count("crate://") == crates.count(".sha256sum] = ") > 100


@pytest.mark.skipif(importlib.util.find_spec("oelint_adv") is None, reason="oelint-adv is in the group `openembedded`")
def test_the_linter_finds_nothing() -> None:
    options = ["--release", load_agreement().series, "--quiet", "--hide", "info", "--jobs", "1"]
    offline = ["--suppress", "oelint.vars.homepageping"]
    own = ["--constantmods", f"+{FOLDER / 'oelint.json'}"]
    argv = [sys.executable, "-m", "oelint_adv", *options, *offline, *own, "--", *map(str, recipes())]
    done = subprocess.run(argv, capture_output=True, text=True, check=False, timeout=110)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@pytest.mark.skipif(importlib.util.find_spec("kas") is None, reason="kas is in the group `openembedded`")
def test_kas_takes_every_project_file(tmp_path: Path) -> None:
    steps = "repo_setup_loop finish_setup_repos repos_checkout repos_apply_patches setup_environ"
    skipped = [word for step in [*steps.split(), "write_bbconfig"] for word in ("--skip", step)]
    for name, machine in load_agreement().machines.items():
        argv = [sys.executable, "-m", "kas", "dump", *skipped, "--format", "json", str(FOLDER / f"kas/{name}.yml")]
        env = {**os.environ, "KAS_WORK_DIR": str(tmp_path)}
        done = subprocess.run(argv, capture_output=True, text=True, check=False, env=env, timeout=100)
        assert done.returncode == 0, done.stderr
        project = json.loads(done.stdout)
        assert (project["machine"], project["distro"]) == (machine.machine, "evbotos")
        assert set(machine.layers) <= set(project["repos"])
        layers = project["repos"]["evbotos"]["layers"]
        assert all((FOLDER.parent.parent / layer / "conf/layer.conf").is_file() for layer in layers)


def test_the_branches_are_those_of_the_series() -> None:
    repositories = yaml.safe_load((FOLDER / "kas/common.yml").read_text())["repos"]
    branches = {name: repository["branch"] for name, repository in repositories.items() if "url" in repository}
    series = load_agreement().series
    assert branches == {"bitbake": "2.18", "openembedded-core": series, "meta-openembedded": series}
