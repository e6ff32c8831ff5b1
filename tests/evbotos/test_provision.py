"""The files of a robot: only its own keys, and identities for each robot of a fleet."""

from __future__ import annotations

import json
import re
import stat
import subprocess
import tarfile
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from eal_actors.managers.keys.certificates import make_authority, make_certificate
from evbotos import identity
from evbotos.errors import BuildError
from evbotos.fields import ROOTFS
from evbotos.hosttools import find_tool
from evbotos.identity import dropbear_key, identity_files, put_identity, read_identity, write_identity
from evbotos.model import Local
from evbotos.provision_command import provision_fleet
from evbotos.robot_files import gather_robot_files
from tests.evbotos.proof import eal

FLEET = """version: 1
name: lab
robots:
  one: {plugins: {sim: {model: evbot3}}, address: tls/one.local:50000}
  two: {plugins: {sim: {model: evbot2}}, address: "tls/192.0.2.7:50000"}
  here: {plugins: {sim: {model: roomba}}}
network:
  security: {keys: lab-keys, controller: controller, roles: {controllers: [controller]}}
"""
ACCESS = {"authorized_keys": b"ssh-ed25519 AAAA me\n", "update_key": b"ab" * 32}


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """A secured fleet, with keys as `eal keys` makes them."""
    file = tmp_path / "lab/fleet.yaml"
    keys = file.parent / "lab-keys"
    keys.mkdir(parents=True)
    file.write_text(FLEET)
    make_authority(keys, "lab")
    for name in ("one", "two", "controller"):
        make_certificate(keys, name)
    return file


def gathered(folder: Path) -> tuple[set[str], list[str]]:
    files, left_out = gather_robot_files(Local(version=1, robot=str(folder)))
    return set(files), left_out


def test_a_robot_gets_its_own_keys_alone(fleet: Path) -> None:
    folder, keys = fleet.parent, fleet.parent / "lab-keys"
    with pytest.raises(BuildError, match="robot: which of one, two is it"):
        gathered(folder)
    (folder / "name").write_text("two\n")
    with pytest.raises(BuildError, match=r"lab/lab-keys/ca\.key is the private key of the fleet's authority"):
        gathered(folder)
    (keys / "ca.key").unlink()
    files, left_out = gathered(folder)
    assert files == {"fleet.yaml", "name", "lab-keys/ca.pem", "lab-keys/two.pem", "lab-keys/two.key"}
    assert left_out == [f"lab-keys/{name}" for name in ("controller.key", "controller.pem", "one.key", "one.pem")]


@pytest.mark.parametrize("form", ["PEM", "DER", "OpenSSH", "within another file", "empty but of its name"])
def test_the_authoritys_key_is_refused_by_name_and_by_content(fleet: Path, form: str) -> None:
    folder = fleet.parent
    (folder / "name").write_text("two\n")
    file = folder / "lab-keys/ca.key"
    pem = file.read_bytes()
    file.unlink()
    key = load_pem_private_key(pem, None)
    forms = {
        "PEM": ("notes.txt", pem),
        "DER": ("picture.png", key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())),
        "OpenSSH": ("id_ecdsa", key.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption())),
        "within another file": ("lab-keys/two.key", (folder / "lab-keys/two.key").read_bytes() + b"\n" + pem),
        "empty but of its name": ("old/ca.key", b""),
    }
    name, content = forms[form]
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_bytes(content)
    with pytest.raises(BuildError, match=f"{name} is the private key of the fleet's authority"):
        gathered(folder)


def test_an_identity_holds_what_one_robot_needs_and_dropbears_form_of_its_host_key(fleet: Path, tmp_path: Path) -> None:
    host_key = Ed25519PrivateKey.generate()
    files = identity_files(fleet, "one", ACCESS, host_key)
    out = tmp_path / "one.identity.tar"
    write_identity(files, out)
    assert stat.S_IMODE(out.stat().st_mode) == 0o600
    assert read_identity(out) == files
    keys = {"lab-keys/ca.pem", "lab-keys/one.pem", "lab-keys/one.key"}
    assert set(files) == {"fleet.yaml", "name", "host_ed25519", *keys, *ACCESS}
    assert files["name"] == b"one\n"
    assert identity.host_key_in(out) is not None
    public = host_key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    assert dropbear_key(host_key).startswith(b"\0\0\0\x0bssh-ed25519\0\0\0\x40")
    assert dropbear_key(host_key).endswith(public)
    (fleet.parent / "lab-keys/two.key").unlink()
    with pytest.raises(BuildError, match=r"lab-keys lacks two\.key of two: eal keys robot two --fleet"):
        identity_files(fleet, "two", ACCESS, host_key)


@pytest.mark.skipif(find_tool("mformat") is None, reason="not installed: mformat (make evbotos-setup)")
def test_an_identity_goes_onto_an_image_without_one_only(fleet: Path, tmp_path: Path) -> None:
    image, out = tmp_path / "disk.img", tmp_path / "one.identity.tar"
    image.write_bytes(bytes(5 << 20))
    place = f"{image}@@{1 << 20}"
    subprocess.run(["mformat", "-i", place, "-T", str((4 << 20) // 512), "::"], check=True)
    subprocess.run(["mmd", "-i", place, "::/robot"], check=True)
    write_identity(identity_files(fleet, "one", ACCESS, Ed25519PrivateKey.generate()), out)
    assert put_identity(out, image) == "one"
    read = subprocess.run(["mtype", "-i", place, "::/robot/lab-keys/one.key"], check=True, capture_output=True)
    assert read.stdout == (fleet.parent / "lab-keys/one.key").read_bytes()
    with pytest.raises(BuildError, match=r"disk\.img has a robot's files already"):
        put_identity(out, image)
    out.write_bytes(b"nothing")
    with pytest.raises(BuildError, match="is not an identity of `evbotos provision`"):
        put_identity(out, image)


def taken_by_a_machine(identity_bytes: bytes, folder: Path) -> list[str]:
    """Run the machine's program with an identity, in folders in place of its own; return the files that it keeps."""
    for name in ("run", "data", "boot", "stick"):
        (folder / name).mkdir(parents=True)
    (folder / "run/data").touch()
    (folder / "stick/one.identity.tar").write_bytes(identity_bytes)
    text = (ROOTFS / "services/hotplug/usr/lib/evbotos/provision").read_text().replace("exec reboot", "exit 0")
    for place, ours in {"/dev/console": "/dev/null", "/run/evbotos": f"{folder}/run"}.items():
        text = text.replace(place, ours)
    text = re.sub(r"(?<=[ =])/data/", f"{folder}/data/", text)
    subprocess.run(["sh", "-c", text, "provision", folder / "stick"], check=False, capture_output=True, timeout=60)
    return sorted(path.name for path in (folder / "data/robot").glob("**/*") if path.is_file())


def test_an_identity_that_was_cut_at_the_end_of_a_file_is_refused(fleet: Path, tmp_path: Path) -> None:
    """Tar takes it, and a robot without the files behind the cut, such as the key of updates, takes no other one."""
    out = tmp_path / "one.identity.tar"
    files = identity_files(fleet, "one", ACCESS, Ed25519PrivateKey.generate())
    write_identity(files, out)
    whole = out.read_bytes()
    assert taken_by_a_machine(whole, tmp_path / "whole") == sorted(Path(name).name for name in files)
    with tarfile.open(out) as archive:
        ends = [member.offset for member in archive]
    for end in ends:
        assert taken_by_a_machine(whole[:end], tmp_path / f"cut{end}") == []
        out.write_bytes(whole[:end])
        with pytest.raises(BuildError, match="or not a whole one"):
            read_identity(out)


def test_a_fleet_that_is_not_secured_is_told_how(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    with pytest.raises(BuildError, match="there is no fleet file"):
        provision_fleet(fleet, None, {}, tmp_path / "out")
    fleet.write_text(FLEET.partition("network:")[0])
    with pytest.raises(BuildError, match="is not secured: eal keys init --write --fleet"):
        provision_fleet(fleet, None, {}, tmp_path / "out")


@pytest.mark.evbotos
def test_ten_robots_from_nothing(tmp_path: Path) -> None:
    fleet, out = tmp_path / "fleet.yaml", tmp_path / "identities"
    names = [f"robot{number}" for number in range(1, 11)]
    robots = "".join(
        f"  {name}: {{plugins: {{sim: {{model: evbot3}}}}, address: tls/{name}.local:50000}}\n" for name in names
    )
    fleet.write_text(f"version: 1\nname: lab\nrobots:\n{robots}")
    eal("keys", "init", "--write", "--fleet", fleet)
    made = provision_fleet(fleet, None, ACCESS, out)
    assert list(made) == names
    listed = json.loads(eal("keys", "list", "--json", "--fleet", fleet))
    assert {"controller", *names} <= {entry["name"] for entry in listed["certificates"]}
    for name in names:
        secrets = [path for path in read_identity(made[name]) if path.endswith(".key")]
        assert secrets == [f"keys/{name}.key"]
    assert sum(path.stat().st_size for path in made.values()) < 10 * 25_000
    before, known = made["robot3"].read_bytes(), (out / "known_hosts").read_text()
    assert len(known.splitlines()) == 10
    assert provision_fleet(fleet, ["robot3"], ACCESS, out)["robot3"].read_bytes() == before
    assert sorted((out / "known_hosts").read_text().splitlines()) == sorted(known.splitlines())
    with pytest.raises(BuildError, match="no robot with an address named robot11"):
        provision_fleet(fleet, ["robot11"], ACCESS, out)
