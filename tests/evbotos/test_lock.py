from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.interpreter import BUILD_MACHINES, interpreter_packages, of_this_machine
from evbotos.lock import FOLDER, Lock, LockedPackage, LockedWheel, asked_by, read_lock, require_lock, write_lock

FOUND = load_definitions()
PLATFORM, IMAGE = FOUND.platform("qemu-amd64"), FOUND.image("robot")


def package(name: str) -> LockedPackage:
    return LockedPackage(
        name=name, version="1:2.3-4", archive="main", path=f"pool/main/{name}.deb", size=7, sha256="ab" * 32
    )


@pytest.fixture
def lock() -> Lock:
    wheel = LockedWheel(name="pykka", version="4.5.0", file="pykka-4.5.0-py3-none-any.whl", sha256="cd" * 32)
    return Lock(
        version=1,
        platform=PLATFORM.name,
        image=IMAGE.name,
        asked=asked_by(PLATFORM, IMAGE),
        epoch=1_700_000_000,
        kernel=package("linux-source-6.1"),
        packages=(package("busybox"), package("libc6")),
        wheels=(wheel,),
        interpreter=(package("libc6"),),
    )


def test_what_is_written_is_read_again(lock: Lock, tmp_path: Path) -> None:
    write_lock(lock, tmp_path / "a.lock.yaml")
    assert read_lock(tmp_path / "a.lock.yaml") == lock
    assert read_lock(tmp_path / "other") is None


def test_each_package_has_a_line_of_its_own(lock: Lock, tmp_path: Path) -> None:
    write_lock(lock, tmp_path / "a.lock.yaml")
    lines = (tmp_path / "a.lock.yaml").read_text().splitlines()
    assert sum("busybox" in line for line in lines) == 1
    assert all("sha256" in line for line in lines if line.startswith("  - "))


def test_a_lock_with_another_hash_format_or_a_host_is_refused(lock: Lock, tmp_path: Path) -> None:
    path = tmp_path / "a.lock.yaml"
    write_lock(lock, path)
    good = path.read_text()
    for bad in (good.replace("ab" * 32, "ab"), good.replace("path: pool/", "path: http://mirror/pool/")):
        path.write_text(bad)
        with pytest.raises(ConfigError, match="must match the pattern"):
            read_lock(path)


def test_a_definition_that_asks_for_more_than_was_locked_is_refused(lock: Lock, tmp_path: Path) -> None:
    path = tmp_path / "locks/a.lock.yaml"
    with pytest.raises(BuildError, match=r"no locks/a\.lock\.yaml; `evbotos build qemu-amd64 robot --update-lock`"):
        require_lock(path, PLATFORM, IMAGE)
    write_lock(lock, path)
    assert require_lock(path, PLATFORM, IMAGE) == lock
    more = IMAGE.model_copy(update={"packages": (*IMAGE.packages, "gdb")})
    with pytest.raises(BuildError, match=r"a\.lock\.yaml is outdated.*--update-lock"):
        require_lock(path, PLATFORM, more)


def test_pruning_and_services_do_not_need_a_new_lock() -> None:
    other = IMAGE.model_copy(update={"prune": ("usr/**",), "services": ()})
    assert asked_by(PLATFORM, other) == asked_by(PLATFORM, IMAGE)


def test_a_lock_has_the_python_of_its_suite_for_each_kind_of_build_machine() -> None:
    for path in sorted(FOLDER.glob("*.lock.yaml")):
        lock = read_lock(path)
        assert lock is not None
        wanted = interpreter_packages(FOUND.platform(lock.platform).python, compiles_wheels=bool(lock.compiled))
        names = {(one.name, one.path.rpartition("_")[2]) for one in lock.interpreter}
        assert names == {(name, f"{machine}.deb") for name in wanted for machine in BUILD_MACHINES}, path.name


def test_a_build_machine_for_which_no_python_is_locked_is_told() -> None:
    with pytest.raises(BuildError, match="there is no Python for a build machine of"):
        of_this_machine([package("libc6")])
