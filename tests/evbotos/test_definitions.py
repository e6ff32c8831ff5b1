from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from evbotos.definitions import load_definitions
from evbotos.kernel import fragments_text
from evbotos.lock import FOLDER
from evbotos.model import Kernel

PLATFORM = """
version: 1
name: board
description: a board
architecture: amd64
wheel_tags: [manylinux_2_17_x86_64]
floor: anything
kernel: {source: linux-source-6.1, architecture: x86_64, fragments: [common.config], image: arch/x86/boot/bzImage}
boot: grub
console: ttyS0
"""
EMULATOR = "emulator: {{program: qemu-system-{}, machine: q35}}\n"
SMALL = """
version: 1
name: small
description: little
packages: [busybox]
services: [ssh]
prune: ["usr/share/**"]
budget_mb: {root_with_kernel: 10}
"""
LARGE = """
version: 1
name: large
description: much
include: [small]
packages: [python3-numpy, busybox]
services: [robot]
budget_mb: {root_with_kernel: 20}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in (
        ("platforms/board.yaml", PLATFORM),
        ("images/small.yaml", SMALL),
        ("images/large.yaml", LARGE),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    return tmp_path


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where no local.yaml lies


def test_an_image_joins_the_lists_of_what_it_includes_and_overrides_the_rest(folder: Path) -> None:
    image = load_definitions(folder=folder).image("large")
    assert image.packages == ("busybox", "python3-numpy")
    assert image.services == ("ssh", "robot")
    assert image.prune == ("usr/share/**",)
    assert image.budget_mb.root_with_kernel == 20


def test_local_yaml_wins_over_the_image(folder: Path) -> None:
    (folder / "local.yaml").write_text(
        "version: 1\nimages: {large: {packages: [gdb], budget_mb: {root_with_kernel: 99}, layout: {slot: 64}}}\n"
    )
    found = load_definitions(folder=folder)
    assert found.image("large").packages == ("busybox", "python3-numpy", "gdb")
    assert found.image("large").budget_mb.root_with_kernel == 99
    assert found.image("large").layout.slot == 64
    assert found.image("small").layout.slot == 48


def test_what_a_user_asks_for_is_not_left_out(folder: Path) -> None:
    small = folder / "images/small.yaml"
    small.write_text(f"{small.read_text()}drop_packages: [libstdc++*, libdb5.*, perl]\n")
    (folder / "local.yaml").write_text("version: 1\nimages: {small: {packages: [libstdc++6]}}\n")
    image = load_definitions(folder=folder).image("small")
    names = ("libstdc++6", "libstdc++5", "libdb5.3", "libdb5.3t64", "perl", "perl-base")
    assert [name for name in names if image.leaves_out(name)] == ["libstdc++5", "libdb5.3", "libdb5.3t64", "perl"]


def test_what_a_user_asks_for_besides_is_locked_beside_local_yaml_and_not_among_ours(tmp_path: Path) -> None:
    local = tmp_path / "local.yaml"
    local.write_text("version: 1\nimages: {robot: {packages: [strace]}, dev: {layout: {slot: 256}}}\n")
    found = load_definitions(local)
    board = found.platform("qemu-amd64")
    assert found.lock_path(board, found.image("robot")) == tmp_path / "locks/qemu-amd64-robot.lock.yaml"
    for name in ("dev", "minimal"):
        assert found.lock_path(board, found.image(name)) == FOLDER / f"qemu-amd64-{name}.lock.yaml"


def test_what_builds_on_an_image_gets_what_the_user_adds_only_if_it_says_so_itself(folder: Path) -> None:
    (folder / "local.yaml").write_text("version: 1\nimages: {small: {packages: [gdb]}}\n")
    assert "gdb" not in load_definitions(folder=folder).image("large").packages


@pytest.mark.parametrize(
    ("file", "content", "told"),
    [
        ("platforms/board.yaml", PLATFORM.replace("amd64", "mips"), "board.yaml:5:15: architecture"),
        ("platforms/board.yaml", PLATFORM + "colour: red\n", "board.yaml:11:1: colour"),
        ("images/small.yaml", SMALL.replace("version: 1", "version: 2"), "small.yaml:2:10: version"),
        (
            "images/small.yaml",
            SMALL.replace("name: small", "name: tiny"),
            "is 'tiny', but the file is small.yaml",
        ),
        ("images/large.yaml", LARGE.replace("[small]", "[smal]"), "there is no image 'smal'; did you mean 'small'?"),
        ("images/small.yaml", SMALL + "include: [large]\n", "include loop"),
        ("local.yaml", "version: 1\nimages: {larg: {packages: [gdb]}}\n", "did you mean 'large'?"),
        ("local.yaml", "version: 1\nmiror: x\n", "local.yaml:2:1: miror"),
        (
            "images/small.yaml",
            SMALL.replace("[ssh]", "[shh]"),
            "small.yaml:6:12: services[0]: there is no service 'shh'",
        ),
        (
            "images/small.yaml",
            f"{SMALL}files: [octav]\n",
            "files[0]: there is no folder of files 'octav'; did you mean",
        ),
        ("images/small.yaml", f"{SMALL}layout: {{boot: 1}}\n", "small.yaml:9:16: layout.boot: must be at least 16"),
        ("images/small.yaml", f"{SMALL}layout: {{slot: 99999999999}}\n", "layout.slot: must be at most"),
        ("images/small.yaml", f"{SMALL}layout: {{slot: 2}}\n", "a slot of 2 MiB is smaller than a root of 10 MB"),
        ("local.yaml", 'version: 1\nssh_keys: ["hello"]\n', "local.yaml:2:12: ssh_keys[0]: is not a public SSH key"),
        ("local.yaml", "version: 1\nmirror: not an address\n", "local.yaml:2:9: mirror: must be an address such as"),
        ("local.yaml", "version: 1\nmirror: https:/typing.error\n", "local.yaml:2:9: mirror: must be an address"),
        ("local.yaml", "version: 1\nrobot: nowhere\n", "local.yaml:2:8: robot: there is no folder nowhere"),
        ("local.yaml", "version: 1\nupdate_key: no.pem\n", "local.yaml:2:13: update_key: there is no file no.pem"),
        ("local.yaml", "version: 1\nimages: {small: {services: [sssh]}}\n", "there is no service 'sssh'"),
        ("platforms/board.yaml", f"{PLATFORM}suite: trixy\n", "board.yaml:11:8: suite: must be 'bookworm'"),
        ("platforms/board.yaml", PLATFORM + EMULATOR.format("sparc"), "board.yaml:11:21: emulator.program: must be"),
        ("platforms/board.yaml", PLATFORM + EMULATOR.format("arm"), "amd64 is emulated by qemu-system-x86_64"),
        ("platforms/board.yaml", PLATFORM.replace("grub", "u-boot"), "board.yaml:9:7: boot: amd64 is started by grub"),
        ("platforms/board.yaml", PLATFORM.replace("_x86_64]", "_i686]"), "wheels of amd64 end in x86_64, not"),
        ("platforms/board.yaml", PLATFORM.replace(": x86_64", ": arm"), "board.yaml:8:9: kernel: is for arm, but"),
        (
            "platforms/board.yaml",
            PLATFORM.replace("[common", "[comon"),
            "there is no kernel fragment 'comon.config'; did",
        ),
        ("platforms/board.yaml", f"{PLATFORM}boot_files: {{one: {{a: ../b}}}}\n", "must be a file name on the boot"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(folder: Path, file: str, content: str, told: str) -> None:
    (folder / file).write_text(content)
    with pytest.raises(ConfigError) as caught:
        load_definitions(folder=folder)
    assert told in str(caught.value)


def test_all_problems_are_told_at_once(folder: Path) -> None:
    (folder / "platforms/board.yaml").write_text(PLATFORM + "colour: red\n")
    (folder / "images/small.yaml").write_text(SMALL + "taste: sweet\n")
    with pytest.raises(ConfigError) as caught:
        load_definitions(folder=folder)
    assert {problem.path for problem in caught.value.problems} >= {"colour", "taste"}


def test_unknown_names_are_told_with_what_was_meant(folder: Path) -> None:
    found = load_definitions(folder=folder)
    with pytest.raises(ConfigError, match="there is no platform 'bord'; did you mean 'board'"):
        found.platform("bord")
    with pytest.raises(ConfigError, match="there is no image 'lage'; did you mean 'large'"):
        found.image("lage")


def test_an_image_adds_drivers_to_the_kernel_of_its_platform() -> None:
    found = load_definitions()
    kernel, plain = found.chosen("qemu-amd64", "wireless")[0].kernel, found.chosen("qemu-amd64", "robot")[0].kernel
    assert isinstance(kernel, Kernel)
    assert isinstance(plain, Kernel)
    assert kernel.fragments == (*plain.fragments, "wifi.config")
    assert "CONFIG_MAC80211=y" in fragments_text(kernel)
    assert "CONFIG_MAC80211=y" not in fragments_text(plain)


def test_a_kernel_has_the_drivers_of_the_boards_cameras_for_images_with_libcamera() -> None:
    found = load_definitions()
    kernels = {name: found.chosen("raspberry-pi-5", name)[0].kernel for name in ("libcamera", "vision")}
    for name, kernel in kernels.items():
        assert isinstance(kernel, Kernel)
        assert ("CONFIG_VIDEO_RP1_CFE=y" in fragments_text(kernel)) == (name == "libcamera")


def test_a_real_time_task_preempts_the_unpacking_of_the_root_on_every_board() -> None:
    kernels = [platform.kernel for platform in load_definitions().platforms.values()]
    assert len(kernels) == 6
    for kernel in kernels:
        assert isinstance(kernel, Kernel)
        options = fragments_text(kernel).splitlines()
        # With SQUASHFS_DECOMP_MULTI_PERCPU, `make bench-jitter` measured a loop that woke 6 ms late instead of 0.03.
        assert {"CONFIG_PREEMPT=y", "CONFIG_SQUASHFS_DECOMP_MULTI=y"} <= set(options)


def test_an_image_leaves_a_kernel_of_debian_as_it_is(folder: Path) -> None:
    (folder / "images/small.yaml").write_text(SMALL + "kernel_fragments: [wifi.config]\n")
    packaged = "kernel: {package: linux-image-amd64, modules: [squashfs]}\n"
    (folder / "local.yaml").write_text(f"version: 1\nplatforms: {{board: {{{packaged.strip()}}}}}\n")
    found = load_definitions(folder=folder)
    assert found.chosen("board", "large")[0] == found.platform("board")


def test_what_builds_on_the_robot_image_contains_this_project() -> None:
    images = load_definitions().images.values()
    with_project = {image.name for image in images if image.project}
    assert with_project == {"dev", "libcamera", "octave-robot", "robot", "vision", "wireless"}
    assert {image.name for image in images if "robot" in image.services} == with_project


def test_an_image_is_for_its_architectures_and_so_is_what_builds_on_it(folder: Path) -> None:
    (folder / "images/small.yaml").write_text(SMALL + "architectures: [arm64]\n")
    found = load_definitions(folder=folder)
    assert found.image("large").architectures == ("arm64",)
    with pytest.raises(ConfigError, match="the image large is for arm64; the platform board is amd64"):
        found.chosen("board", "large")
    (folder / "images/large.yaml").write_text(LARGE + "architectures: [amd64]\n")
    assert load_definitions(folder=folder).chosen("board", "large")[1].name == "large"


def test_the_shipped_definitions_name_every_platform_and_image() -> None:
    found = load_definitions()
    boards = {"beagle-armhf", "pc104-i686", "raspberry-pi", "raspberry-pi-5"}
    assert set(found.platforms) == {*boards, "qemu-amd64", "qemu-arm64"}
    images = {"dev", "libcamera", "minimal", "octave", "octave-robot", "robot", "vision", "wireless"}
    assert set(found.images) == images
    assert set(found.image("minimal").packages) < set(found.image("octave").packages)
