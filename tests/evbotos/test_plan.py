from __future__ import annotations

from pathlib import Path

import pytest

from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.disk import kernel_line
from evbotos.errors import BuildError
from evbotos.hosttools import needed_for
from evbotos.lock import FOLDER, asked_by, lock_path, read_lock
from evbotos.model import Local
from evbotos.plan import files_of, layers_of, make_plan
from evbotos.run_command import memory_for


def test_a_plan_names_steps_packages_files_and_budgets_of_every_pair() -> None:
    found = load_definitions()
    for platform in found.platforms.values():
        for image in found.images.values():
            plan = make_plan(platform, image, None)
            assert len(plan["steps"]) == 9 + bool(plan["compiled_wheels"]) + platform.needs_stand_ins
            assert set(image.packages) <= set(plan["packages"])
            assert "usr/lib/evbotos/init" in plan["files"]
            assert plan["budget_mb"]["root_with_kernel"] == image.budget_mb.root_with_kernel
            assert plan["kernel_options"] > 50


def test_every_service_of_every_image_has_its_files_and_is_started() -> None:
    for image in load_definitions().images.values():
        base, *others = layers_of(image)
        services = others[len(image.files) :]
        assert (base / "etc/inittab").is_file()
        for service in services:
            assert (service / "inittab").is_file(), service.name
        assert all(folder.is_dir() for folder in others)


def test_files_are_named_as_they_are_in_the_root() -> None:
    files = files_of(load_definitions().image("robot"))
    assert {"usr/lib/evbotos/serve_robot.py", "usr/bin/evbotos-update", "etc/mdev.conf"} <= set(files)
    assert "inittab" not in files


def test_what_a_platform_has_no_wheel_of_is_compiled() -> None:
    found = load_definitions()
    board, image = found.platform("beagle-armhf"), found.image("robot")
    plan = make_plan(board, image, read_lock(lock_path(board, image)))
    assert "pymunk" not in plan["wheels"]
    assert plan["compiled_wheels"] == ["pymunk"]
    assert plan["locked_compiled_wheels"][0].startswith("pymunk ")
    assert "compiled: compile wheels of pymunk from source" in plan["steps"]
    assert "arm-linux-gnueabihf-gcc" in needed_for(board)
    assert make_plan(board, found.image("minimal"), None)["compiled_wheels"] == []


def test_the_shipped_lock_files_are_those_of_the_definitions() -> None:
    found = load_definitions()
    shipped = {path.name for path in FOLDER.glob("*.lock.yaml")}
    assert {"qemu-amd64-minimal.lock.yaml", "qemu-amd64-robot.lock.yaml"} <= shipped
    for platform in found.platforms.values():
        for image in found.images.values():
            path = lock_path(platform, image)
            lock = read_lock(path)
            if lock is not None:
                assert lock.asked == asked_by(*found.chosen(platform.name, image.name)), path.name
            assert lock is None or "://" not in path.read_text()


def test_the_kernel_starts_our_init_on_the_platforms_console() -> None:
    line = kernel_line(load_definitions().platform("qemu-amd64"))
    assert "init=/usr/lib/evbotos/init" in line
    assert "console=ttyS0,115200" in line


def test_an_emulated_machine_has_the_memory_that_its_image_needs() -> None:
    found = load_definitions()
    emulator = found.platform("qemu-amd64").emulator
    assert emulator is not None
    assert [memory_for(emulator, found.image(name)) for name in ("minimal", "robot", "octave")] == [128, 128, 256]
    assert memory_for(emulator.model_copy(update={"memory_mb": 512}), found.image("octave")) == 512


def test_an_output_folder_that_cannot_be_written_is_reported_before_the_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, file = load_definitions(), tmp_path / "file"
    file.touch()
    monkeypatch.setattr("evbotos.build.require", lambda _: None)
    platform, image = found.platform("qemu-amd64"), found.image("robot")
    build = Build(platform, image, Local(version=1, cache=str(tmp_path / "cache")), file, lambda _: None)
    with pytest.raises(BuildError, match=r"file/qemu-amd64-robot cannot be written: Not a directory"):
        build.run(file)
    assert not (tmp_path / "cache").exists()
