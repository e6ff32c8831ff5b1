from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

FLEET = """\
# The lab.
version: 1
name: lab
robots:
  r1: {address: tls/10.0.0.1:50000, plugins: {sample: {}}}  # the first
  here: {plugins: {sample: {}}}
"""
ROUTED = """\
version: 1
network: {routers: [tcp/gate.local:7447]}
robots: {r1: {address: router, plugins: {sample: {}}}}
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    file = Path("lab.yaml")
    file.write_text(FLEET)
    return file


def test_init_prints_the_section_that_makes_the_file_valid(eal: Any, lab: Path) -> None:
    assert eal("check", lab).exit_code == 2  # tls without keys

    done = eal("keys", "init", "--fleet", lab)

    assert (done.exit_code, lab.read_text()) == (0, FLEET)
    assert sorted(file.name for file in Path("keys").iterdir()) == [".gitignore", "ca.key", "ca.pem"]
    lab.write_text(FLEET + done.stdout)
    assert eal("check", lab).exit_code == 0


def test_init_appends_the_section_when_asked_and_leaves_the_rest(eal: Any, lab: Path) -> None:
    done = eal("keys", "init", "--fleet", lab, "--write")

    assert (done.exit_code, done.stdout) == (0, "")
    assert lab.read_text().startswith(f"{FLEET}\nnetwork:\n  security:\n    keys: keys\n")
    assert eal("check", lab).exit_code == 0
    assert list(lab.parent.glob(".*.new")) == []


def test_init_changes_no_file_that_would_not_be_valid(eal: Any, lab: Path) -> None:
    lab.write_text(FLEET.replace("tls/", "tcp/"))

    done = eal("keys", "init", "--fleet", lab, "--write")

    assert done.exit_code == 2
    assert "lab.yaml:5:17: robots.r1.address: tcp carries no certificates" in done.stderr
    assert (lab.read_text(), Path("keys").exists()) == (FLEET.replace("tls/", "tcp/"), False)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("network: {identity: id-1}  # ours\n", "network: {security: {keys: keys, controller: controller, roles: {"),
        ("network:\n  # ours\n  identity: id-1\n", "network:\n  # ours\n  security:\n    keys: keys\n"),
    ],
)
def test_init_adds_to_the_network_section_that_is_there(eal: Any, lab: Path, before: str, after: str) -> None:
    """`eal new fleet` and `eal serve` write one with an identity."""
    lab.write_text(FLEET.replace("robots:\n", f"{before}robots:\n"))

    done = eal("keys", "init", "--fleet", lab, "--write")

    assert done.exit_code == 0, done.stderr
    assert after in lab.read_text()
    assert "# ours" in lab.read_text()
    assert "identity: id-1" in lab.read_text()
    assert eal("check", lab).exit_code == 0
    assert eal("keys", "robot", "r1", "--fleet", lab).exit_code == 0


def test_init_knows_the_routers_and_replaces_no_security(eal: Any, lab: Path) -> None:
    lab.write_text(ROUTED.replace("tcp/", "tls/"))
    assert "routers: [router]" in eal("keys", "init", "--fleet", lab).stdout
    assert eal("keys", "init", "--fleet", lab, "--write", "--force").exit_code == 0
    secured = lab.read_text()
    assert "routers: [router]" in secured

    again = eal("keys", "init", "--fleet", lab, "--write", "--force")

    assert (again.exit_code, lab.read_text()) == (2, secured)
    assert "has a section network.security already" in again.stderr


def test_all_the_keys_of_a_fleet(eal: Any, lab: Path) -> None:
    eal("keys", "init", "--fleet", lab, "--write")

    for arguments in (
        ("robot", "r1"),
        ("controller", "controller"),
        ("controller", "display", "--observer"),
        ("router", "--host", "10.0.0.9"),
    ):
        assert eal("keys", *arguments, "--fleet", lab).exit_code == 0, arguments

    listed = json.loads(eal("keys", "list", "--fleet", lab, "--json").stdout)["certificates"]
    assert [(entry["name"], entry["hosts"], entry["may"]) for entry in listed] == [
        ("ca", [], ""),
        ("controller", [], "command"),
        ("display", [], ""),
        ("r1", ["10.0.0.1"], "be the robot"),
        ("router", ["10.0.0.9"], ""),
    ]
    assert {entry["days_left"] for entry in listed[1:]} == {824}
    assert "keys/r1.pem" in eal("keys", "list", "--fleet", lab).stdout


def test_what_is_left_to_do_is_told(eal: Any, lab: Path) -> None:
    eal("keys", "init", "--fleet", lab, "--write")

    robot = eal("keys", "robot", "r1", "--fleet", lab).stderr
    observer = eal("keys", "controller", "display", "--observer", "--fleet", lab).stderr
    controller = eal("keys", "controller", "controller", "--fleet", lab).stderr

    assert "r1 needs keys/ca.pem, keys/r1.pem, keys/r1.key" in robot
    assert "Next: add display to network.security.roles.observers" in observer
    assert "Next:" not in controller


def test_a_router_is_reached_where_the_fleet_file_says(eal: Any, lab: Path) -> None:
    lab.write_text(ROUTED)
    eal("keys", "init", "--fleet", lab)

    assert "made for gate.local" in eal("keys", "router", "--fleet", lab).stderr
    assert "r1.pem: made, valid until" in eal("keys", "robot", "r1", "--fleet", lab).stderr


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("robot", "r2"), "the fleet has no robot 'r2'; known: here, r1"),
        (("robot", "here"), "here has no address: it runs in the controller's process and needs no keys"),
        (("controller", "r1"), "r1 is a robot, and a robot's certificate has no other role; choose another name"),
        (("router",), "network.routers of the fleet file is empty: name the router's host"),
        (("controller", "1st"), "1st: cannot be the name of a certificate"),
        (("init",), "keys/ca.key: is there already; --force replaces it"),
    ],
)
def test_what_is_refused(eal: Any, lab: Path, arguments: tuple[str, ...], expected: str) -> None:
    eal("keys", "init", "--fleet", lab, "--write")
    before = sorted(Path("keys").iterdir())

    done = eal("keys", *arguments, "--fleet", lab)

    assert done.exit_code == 2
    assert expected in " ".join(done.stderr.replace("│", " ").split())
    assert sorted(Path("keys").iterdir()) == before
