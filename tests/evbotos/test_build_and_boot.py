"""The proof in short, without compiling a kernel: an image is built twice, is the same twice, boots and answers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos.apt_sources import sources_for
from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.hashing import files_sha256
from evbotos.lock import lock_path
from evbotos.model import Local
from evbotos.outputs import Built
from evbotos.packages import Apt
from evbotos.plan import step_names
from evbotos.project import project_files
from tests.evbotos.proof import (
    DEBIAN_KERNEL,
    SERVES,
    Proof,
    compressed_quickly,
    first_answer_s,
    give_keys,
    require_tools,
    started,
    wait_for_words,
)

FOUND = load_definitions()
PLATFORM = FOUND.platform("qemu-amd64").model_copy(update={"kernel": DEBIAN_KERNEL})
IMAGE = FOUND.image("robot")
SAME = ("root.squashfs", "kernel", "initrd", "disk.img", "sbom.cdx.json", "sizes.json")

_LOG = get_logger()

pytestmark = pytest.mark.timeout(1500)


def sources() -> str:
    """Return a hash of the project's own files, as they go into the image."""
    return files_sha256(list(project_files()))


def built_in(folder: Path, local: Local, locks: Path, *, update_lock: bool) -> Built:
    """Build with a cache of its own."""
    settings = local.model_copy(update={"cache": str(folder / "cache")})
    lock_file = lock_path(PLATFORM, IMAGE, locks)
    return Build(PLATFORM, IMAGE, settings, lock_file, _LOG.info).run(folder / "out", update_lock=update_lock)


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proof]:
    """The robot image of the packages that the archive offers now, started by Debian's own kernel."""
    require_tools(PLATFORM)
    folder = tmp_path_factory.mktemp("short")
    try:
        Apt(folder / "apt", PLATFORM.architecture, sources_for(PLATFORM.suite, None), _LOG.info).update()
    except BuildError as error:
        pytest.skip(f"images cannot be built here: {error}")
    fleet, local = give_keys(folder)
    (folder / "sources").write_text(sources())
    with compressed_quickly():
        built = built_in(folder / "one", local, folder / "locks", update_lock=True)
        yield Proof(PLATFORM, IMAGE, built, fleet, folder / "robot", folder / "ssh", folder / "update.pem")
    shutil.rmtree(folder)


def test_it_boots_and_answers(proof: Proof, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)  # docs/evbotos.md, "Limits": a link must not come while the engine opens
        took_s = first_answer_s(proof, machine, monkeypatch)
        _LOG.warning(f"first answered call after {took_s:.1f} s, of which QEMU computed {machine.computed_s():.1f} s")


@pytest.mark.evbotos
def test_a_second_build_is_the_same_to_the_bit(proof: Proof, tmp_path: Path) -> None:
    one = proof.built.folder.parent.parent
    sources_before = (one.parent / "sources").read_text()
    for kept in ("debs", "wheels", "apt"):  # what was downloaded, and nothing that was made of it
        shutil.copytree(one / "cache" / kept, tmp_path / "two/cache" / kept, copy_function=os.link)
    local = Local(
        version=1,
        ssh_keys=((one.parent / "ssh.pub").read_text().strip(),),
        robot=str(proof.robot_files),
        update_key=str(one.parent / "update.pub.pem"),
    )
    before = os.umask(0o077)
    try:
        again = built_in(tmp_path / "two", local, one.parent / "locks", update_lock=False)
    finally:
        os.umask(before)
    assert all(not step["cached"] for step in again.report["steps"])
    assert [step["name"] for step in again.report["steps"]] == step_names(PLATFORM, IMAGE)
    if sources() != sources_before:
        pytest.skip("the project's own files were edited between the two builds")
    for name in SAME:
        assert (again.folder / name).read_bytes() == (proof.built.folder / name).read_bytes(), name
