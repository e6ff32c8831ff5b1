"""A board without a battery takes its first time from its certificates, which are not valid before."""

from __future__ import annotations

import subprocess
from pathlib import Path

from cryptography import x509

from evbotos.fields import ROOTFS
from tests.evbotos.proof import give_keys

PROGRAM = ROOTFS / "base/usr/lib/evbotos/valid-from"


def valid_from(*files: Path) -> str:
    return subprocess.run(["sh", PROGRAM, *files], capture_output=True, text=True, check=True, timeout=60).stdout


def test_the_time_from_which_certificates_are_valid(tmp_path: Path) -> None:
    give_keys(tmp_path)
    files = sorted((tmp_path / "robot/keys").glob("*.pem"))
    assert len(files) == 2
    firsts = [x509.load_pem_x509_certificate(file.read_bytes()).not_valid_before_utc for file in files]
    assert valid_from(*files) == f"{max(firsts):%y%m%d%H%M%S}\n"


def test_a_robot_without_certificates_has_no_such_time(tmp_path: Path) -> None:
    (tmp_path / "wrong.pem").write_text("-----BEGIN CERTIFICATE-----\nbm90aGluZw==\n-----END CERTIFICATE-----\n")
    assert valid_from(tmp_path / "wrong.pem", tmp_path / "*.pem") == "0\n"
