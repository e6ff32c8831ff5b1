"""The user of the image's robot: the files that it gets from root."""

from __future__ import annotations

import importlib.util
import os
import pwd
import stat
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

import evbotos
from evbotos.claim_command import claim_machine, keys_of
from evbotos.errors import BuildError
from evbotos.identity import dropbear_key, write_identity

FOLDER = Path(evbotos.__file__).parent / "rootfs/services/robot/usr/lib/evbotos"
CODE = "ABCD-EFGH-IJKL-MN23"


def module_of(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # as dataclasses need it
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A robot's files as the boot partition has them."""
    folder = tmp_path / "robot"
    (folder / "keys").mkdir(parents=True)
    for name in (
        "fleet.yaml",
        "name",
        "host_ed25519",
        "authorized_keys",
        "update_key",
        "wifi.conf",
        "keys/ca.pem",
        "keys/one.key",
    ):
        (folder / name).write_text(f"{name} of one\n")
    return folder


def copy_files(source: Path, target: Path) -> None:
    """Copy a robot's files as its start does."""
    module = module_of("robot_user")
    contents = module.read_files(source)
    module.write_files({**contents, **module._revoked_lists((target,), contents)}, target)


def names_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_the_robot_gets_its_own_files_and_none_of_ssh_and_updates(source: Path, tmp_path: Path) -> None:
    copy = tmp_path / "serve"
    copy_files(source, copy)
    assert names_in(copy) == {"fleet.yaml", "name", "keys/ca.pem", "keys/one.key"}
    assert stat.S_IMODE((copy / "keys/one.key").stat().st_mode) == 0o600
    assert stat.S_IMODE(copy.stat().st_mode) == 0o700
    before = {path: path.stat().st_ino for path in copy.rglob("*")}
    copy_files(source, copy)
    assert {path: path.stat().st_ino for path in copy.rglob("*")} == before  # nothing was written anew


def test_a_copy_follows_its_source_and_no_link_leads_out_of_it(source: Path, tmp_path: Path) -> None:
    copy = tmp_path / "serve"
    copy_files(source, copy)
    (source / "fleet.yaml").write_text("another\n")
    (source / "keys/one.key").unlink()
    (copy / "old").mkdir()
    (copy / "old/file").write_text("old")
    outside = tmp_path / "outside"
    outside.write_text("of root")
    (copy / "name").unlink()
    (copy / "name").symlink_to(outside)  # by a robot that an attacker has taken
    copy_files(source, copy)
    assert (copy / "fleet.yaml").read_text() == "another\n"
    assert names_in(copy) == {"fleet.yaml", "name", "keys/ca.pem"}
    assert outside.read_text() == "of root"
    assert not (copy / "name").is_symlink()
    assert not (copy / "old").exists()
    (copy / "keys/revoked.txt").symlink_to(outside)
    copy_files(source, copy)
    assert "keys/revoked.txt" not in names_in(copy)


def test_who_is_revoked_stays_revoked_while_the_authority_is_the_same(source: Path, tmp_path: Path) -> None:
    copy = tmp_path / "serve"
    copy_files(source, copy)
    (copy / "keys/revoked.txt").write_text("mallory\n")  # as the robot writes it
    (source / "keys/revoked.txt").write_text("eve\n")
    copy_files(source, copy)
    assert (copy / "keys/revoked.txt").read_text() == "eve\nmallory\n"
    (source / "keys/revoked.txt").unlink()
    copy_files(source, copy)
    assert (copy / "keys/revoked.txt").read_text() == "eve\nmallory\n"
    (source / "keys/ca.pem").write_text("another fleet's\n")
    copy_files(source, copy)
    assert not (copy / "keys/revoked.txt").exists()


@pytest.mark.parametrize("folder", ["a-file", "missing/folder"])
def test_a_folder_that_cannot_be_written_is_replaced_by_one_in_ram(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], folder: str
) -> None:
    module, ram = module_of("robot_user"), tmp_path / "ram"
    (tmp_path / "a-file").write_text(
        "in place of the folder"
    )  # as read-only and full partitions, which need privileges
    monkeypatch.setattr(module, "_COPY", tmp_path / folder)
    monkeypatch.setattr(module, "_IN_RAM", ram)
    with (tmp_path / "console").open("wb") as console:
        own = module.Own(source / "fleet.yaml", source / "fleet.yaml", console.fileno())
        own = module._copied(own, module.read_files(source))
    assert own.fleet == ram / "fleet.yaml"
    assert names_in(ram) == {"fleet.yaml", "name", "keys/ca.pem", "keys/one.key"}
    for told in ((tmp_path / "console").read_text(), capsys.readouterr().err):
        assert "the data partition cannot be written" in told
    (ram / "keys/revoked.txt").write_text("mallory\n")
    with (tmp_path / "console").open("wb") as console:
        module._copied(module.Own(source / "fleet.yaml", source, console.fileno()), module.read_files(source))
    assert (ram / "keys/revoked.txt").read_text() == "mallory\n"


BOMB = """
import os, sys
import robot_user
robot_user.bound_threads()
if os.getuid() == 0:
    os.setresuid(*[54321] * 3)
reader, writer = os.pipe()
children = 0
try:
    while children < 1000:
        if not os.fork():
            os.close(writer)
            os.read(reader, 1)  # until this process ends
            os._exit(0)
        children += 1
except BlockingIOError:
    print(children, "children")
"""


def test_a_fork_bomb_of_the_robot_is_bounded() -> None:
    """It took a machine with 128 MB down."""
    command = [sys.executable, "-B", "-c", BOMB]
    ended = subprocess.run(command, cwd=FOLDER, capture_output=True, text=True, timeout=60, check=False)
    assert ended.stderr == ""
    assert int(ended.stdout.removesuffix(" children\n")) < module_of("robot_user")._MOST_THREADS


def test_log_and_console_name_the_fleet_file_that_the_user_knows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with (tmp_path / "console").open("wb") as console:
        own = module_of("robot_user").Own(
            Path("/data/robot/fleet.yaml"), Path("/data/serve/fleet.yaml"), console.fileno()
        )
        own.say("/data/serve/fleet.yaml: is empty")
    assert (tmp_path / "console").read_text() == "evbotos: /data/robot/fleet.yaml: is empty\n"
    assert capsys.readouterr().err == "/data/robot/fleet.yaml: is empty\n"


def test_machine_and_owner_derive_the_same_keys_of_a_claim_code(tmp_path: Path) -> None:
    claim_code = module_of("claim_code")
    machine, owner = keys_of(CODE)
    seeds = claim_code.seeds_of(CODE)
    for key, seed in zip((machine, owner), seeds, strict=True):
        assert key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw) == claim_code.public_key(seed)
    claim_code.main(str(tmp_path / "host"), str(tmp_path / "authorized"))
    told = subprocess.run(["ssh-keygen", "-lf", tmp_path / "authorized"], capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr
    assert len((tmp_path / "host").read_bytes()) == len(dropbear_key(machine))


def test_every_start_has_another_claim_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    claim_code = module_of("claim_code")
    codes = set()
    for number in range(3):
        claim_code.main(str(tmp_path / "host"), str(tmp_path / f"authorized{number}"))
        code = capsys.readouterr().out
        keys_of(code.lower().replace("-", " "))  # as somebody types it
        codes.add(code)
        assert (tmp_path / f"authorized{number}").read_text().startswith('command="/usr/lib/evbotos/take-identity",no-')
    assert len(codes) == 3


@pytest.mark.parametrize("code", ["", "ABCD", "ABCD-EFGH-IJKL-MN01", "ABCD-EFGH-IJKL-MN23-X", "../../../../etc/pw"])
def test_what_is_no_claim_code_is_refused(code: str) -> None:
    with pytest.raises(BuildError, match="is not a claim code"):
        keys_of(code)


def test_a_claim_of_nobody_says_so(tmp_path: Path) -> None:
    identity = tmp_path / "one.identity.tar"
    write_identity({"fleet.yaml": b"version: 1\n", "name": b"one\n"}, identity)
    with pytest.raises(BuildError, match=r"127\.0\.0\.1 has not taken the identity: .*refused"):
        claim_machine("127.0.0.1", 1, CODE, identity)


def test_the_robot_gives_up_every_right_of_root(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give up its rights")
    program = f"""
import os, pwd, sys
from pathlib import Path
sys.path.insert(0, {str(FOLDER)!r})
import robot_user
own = Path({str(tmp_path)!r})
robot_user._STATE, robot_user._USER, robot_user._DEFAULT = own, "nobody", own / "fleet.yaml"
robot_user._COPY, robot_user._IN_RAM = own / "serve", own / "ram"
robot_user.find_fleet = lambda: own / "fleet.yaml"
opened = os.open
os.open = lambda path, *rest, **more: opened(os.devnull if path == "/dev/console" else path, *rest, **more)
robot_user.become_robot()
state = Path("/proc/self/status").read_text()
print([line.split()[1:] for line in state.splitlines() if line.startswith(("Uid", "CapEff", "CapPrm", "NoNewPrivs"))])
try:
    os.setuid(0)
except PermissionError:
    print("stays")
"""
    done = subprocess.run(["python3", "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    states, stays = done.stdout.splitlines()
    uid = str(pwd.getpwnam("nobody").pw_uid)
    assert states == str([[uid] * 4, ["0" * 16], ["0" * 16], ["1"]])
    assert stays == "stays"
