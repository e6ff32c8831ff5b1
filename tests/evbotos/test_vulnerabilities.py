"""Licences in the bill of materials, and known vulnerabilities from database files."""

from __future__ import annotations

import json
import subprocess
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from evbotos.cli import app
from evbotos.definitions import load_definitions
from evbotos.hosttools import tool
from evbotos.licences import Origin, debian_licences, debian_origin, wheel_origin, with_shared
from evbotos.lock import lock_path, read_lock
from evbotos.sbom import bill_of_materials
from evbotos.vulnerabilities import Component, findings, is_older

VERSIONS = (
    *("0", "1.0~rc1-1", "1.0~~", "1.0", "1.0-1", "1.0-1+b1", "1.0-1+deb12u1", "1.0-1+deb12u10", "1.0-1~bpo1", "1.0.1"),
    *(
        "1:0.9",
        "1:1.35.0-4+deb12u1+b1",
        "2:0",
        "1.0a",
        "1.0+",
        "1.0-0",
        "10",
        "9",
        "3.0.17-1~deb12u2",
        "3.0.17-1~deb12u1",
    ),
)
MACHINE_READABLE = """Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Upstream-Name: example

Files: *
License: GPL-2+ and Expat

License: GPL-2+
 text

Files: debian/*
License: LGPL-2.1
"""
PROSE = "On Debian systems, the licence is in /usr/share/common-licenses/GPL-2.\n"


def test_debian_versions_are_ordered_as_dpkg_orders_them() -> None:
    compared = {}
    for one, other in [*pairwise(VERSIONS), *pairwise(VERSIONS[::2]), *pairwise(VERSIONS[::-3])]:
        argv = [tool("dpkg"), "--compare-versions", one, "lt", other]
        compared[one, other] = subprocess.run(argv, capture_output=True, check=False).returncode == 0
    assert {pair: is_older(*pair) for pair in compared} == compared
    assert len(set(compared.values())) == 2


def test_licences_are_read_of_both_forms_of_copyright_files() -> None:
    assert debian_licences(MACHINE_READABLE) == ("GPL-2.0-or-later", "LGPL-2.1-only", "MIT")
    assert debian_licences(PROSE) == ("GPL-2.0-only",)
    assert debian_licences("all rights\n") == ()


def test_a_package_states_its_source_and_licences(tmp_path: Path) -> None:
    folder = tmp_path / "package"
    (folder / "DEBIAN").mkdir(parents=True, mode=0o755)
    (folder / "DEBIAN/control").write_text(
        "Package: libone\nSource: one (1.2-3)\nVersion: 1.2-3+b1\nArchitecture: all\nMaintainer: me <me@example.org>\n"
        "Description: a library\n"
    )
    (folder / "usr/share/doc/libone").mkdir(parents=True)
    (folder / "usr/share/doc/libone/copyright").write_text(MACHINE_READABLE)
    subprocess.run([tool("dpkg-deb"), "-b", folder, tmp_path / "libone.deb"], check=True, capture_output=True)
    origin = debian_origin(tmp_path / "libone.deb")
    assert origin == Origin("one", "1.2-3", ("GPL-2.0-or-later", "LGPL-2.1-only", "MIT"))


def test_a_package_without_a_copyright_file_has_the_licences_of_its_siblings() -> None:
    origins = {"a": Origin("one", "1", ("MIT",)), "b": Origin("one", "1", ()), "c": Origin("two", "1", ())}
    assert [one.licences for one in with_shared(origins).values()] == [("MIT",), ("MIT",), ()]


@pytest.mark.parametrize(
    ("lines", "licences"),
    [
        ("License-Expression: MIT OR Apache-2.0", ("Apache-2.0", "MIT")),
        ("License: EPL-2.0 OR Apache-2.0", ("Apache-2.0", "EPL-2.0")),
        ("Classifier: License :: OSI Approved :: MIT License", ("MIT",)),
        ("License: " + "long text " * 20, ()),
    ],
)
def test_a_wheel_states_its_licences(tmp_path: Path, lines: str, licences: tuple[str, ...]) -> None:
    wheel = tmp_path / "one-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("one-1.0.dist-info/METADATA", f"Metadata-Version: 2.1\nName: one\nVersion: 1.0\n{lines}\n\n")
    assert wheel_origin(wheel) == Origin("one", "1.0", licences)


@pytest.fixture
def built(tmp_path: Path) -> Path:
    """The output folder of an image with its bill of materials."""
    found = load_definitions()
    platform, image = found.platform("qemu-amd64"), found.image("robot")
    lock = read_lock(lock_path(platform, image))
    assert lock is not None
    origins = {"libssl3": Origin("openssl", "3.0.17-1~deb12u2", ("Apache-2.0",)), "pykka": Origin("p", "1", ("MIT",))}
    bill = bill_of_materials(lock, image, platform, origins)
    folder = tmp_path / "out/qemu-amd64-robot"
    folder.mkdir(parents=True)
    (folder / "sbom.cdx.json").write_text(bill)
    (folder / "manifest.json").write_text("{}")
    return tmp_path


def test_the_bill_of_materials_has_licences(built: Path) -> None:
    bill = json.loads((built / "out/qemu-amd64-robot/sbom.cdx.json").read_text())
    licences = {one["name"]: one.get("licenses") for one in bill["components"]}
    assert licences["libssl3"] == [{"license": {"id": "Apache-2.0"}}]
    assert licences["pykka"] == [{"license": {"id": "MIT"}}]
    assert licences["linux-source-6.1"] == [{"expression": "GPL-2.0-only WITH Linux-syscall-note"}]


def tracked(status: str, **more: str) -> dict[str, Any]:
    return {"description": "a flaw", "releases": {"bookworm": {"status": status, **more}, "sid": {"status": "open"}}}


TRACKER = {
    "openssl": {
        "CVE-2099-0001": tracked("resolved", fixed_version="3.0.17-1~deb12u3", urgency="not yet assigned"),
        "CVE-2099-0002": tracked("resolved", fixed_version="3.0.17-1~deb12u2", urgency="not yet assigned"),
        "CVE-2099-0003": tracked("open", urgency="unimportant"),
        "CVE-2099-0004": tracked("resolved", fixed_version="0", urgency="not yet assigned"),
        "CVE-2099-0005": {"releases": {"sid": {"status": "open"}}},
    },
    "pykka": {"CVE-2099-0006": tracked("open")},  # a source of Debian, which the wheel is not from
}


def run(built: Path, *words: str) -> tuple[int, list[str]]:
    done = CliRunner().invoke(app, ["cve", "qemu-amd64", "--json", "-o", str(built / "out"), *words])
    if not done.stdout:
        return done.exit_code, [done.stderr]
    return done.exit_code, [one["identifier"] for one in json.loads(done.stdout)["findings"]]


def test_debian_s_tracker_names_what_is_open_or_fixed_later(built: Path) -> None:
    database = built / "tracker.json"
    database.write_text(json.dumps(TRACKER))
    assert run(built, "-d", str(database)) == (1, ["CVE-2099-0001"])
    assert run(built, "-d", str(database), "--all") == (1, ["CVE-2099-0001", "CVE-2099-0003"])
    shown = CliRunner().invoke(app, ["cve", "qemu-amd64", "-o", str(built / "out"), "-d", str(database)])
    assert "1 vulnerabilities; 1 unimportant ones are not shown (--all)" in shown.stdout


def test_a_backported_kernel_has_the_flaws_of_unstable(tmp_path: Path) -> None:
    database = tmp_path / "tracker.json"
    fixed = {"CVE-2099-0021": "7.2.11-1", "CVE-2099-0022": "7.2.10-1"}
    releases = {one: {"sid": {"status": "resolved", "fixed_version": version}} for one, version in fixed.items()}
    database.write_text(json.dumps({"linux": {one: {"releases": told} for one, told in releases.items()}}))
    kernel = Component("linux-source-7.2", "linux", "7.2.11-1~bpo13+1", "trixie-backports")
    assert [one.identifier for one in findings([kernel], database)] == ["CVE-2099-0021"]


def advisory(name: str, *events: dict[str, str], ecosystem: str = "PyPI", **more: Any) -> dict[str, Any]:
    ranges = [{"type": "ECOSYSTEM", "events": list(events)}]
    return {"affected": [{"package": {"ecosystem": ecosystem, "name": name}, "ranges": ranges}], **more}


def test_osv_names_what_is_in_an_affected_range(built: Path) -> None:
    after, before = {"introduced": "1000"}, {"fixed": "0.1"}
    entries = [
        advisory("Pykka", {"introduced": "0"}, {"fixed": "1000"}, id="GHSA-1", aliases=["CVE-2099-0011"]),
        advisory("pykka", {"introduced": "0"}, before, id="GHSA-2"),
        advisory("pykka", after, id="GHSA-3"),
        advisory("pykka", {"introduced": "0"}, {"last_affected": "1000"}, id="GHSA-4"),
        advisory("pykka", {"introduced": "0"}, id="GHSA-5", withdrawn="2099-01-01T00:00:00Z"),
        advisory("openssl", {"introduced": "0"}, {"fixed": "3.0.18-1"}, ecosystem="Debian:12", id="DEBIAN-1"),
        advisory("openssl", {"introduced": "0"}, ecosystem="Debian:11", id="DEBIAN-2"),
    ]
    with zipfile.ZipFile(built / "all.zip", "w") as archive:
        for number, entry in enumerate(entries):
            archive.writestr(f"{number}.json", json.dumps(entry))
    assert run(built, "-d", str(built / "all.zip")) == (1, ["DEBIAN-1", "CVE-2099-0011", "GHSA-4"])


def test_nothing_known_is_success_and_a_wrong_file_an_error(built: Path) -> None:
    database = built / "tracker.json"
    database.write_text(json.dumps({"zlib": {}}))
    assert run(built, "-d", str(database)) == (0, [])
    for content in ("", "{}", "[1]", '{"openssl": 3}', "no JSON"):
        database.write_text(content)
        code, (said,) = run(built, "-d", str(database))
        assert code == 1
        assert "is neither Debian's tracker nor OSV" in said
    code, (said,) = run(built)
    assert code == 1
    assert "name a database file" in said
