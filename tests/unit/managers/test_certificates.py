from __future__ import annotations

import stat
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from cryptography.x509.verification import PolicyBuilder, Store

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.keys import expiry
from eal_actors.managers.keys.certificates import check_keys, list_certificates, make_authority, make_certificate
from eal_actors.managers.keys.revocation import REVOKED, revoke
from eal_actors.managers.network_model import SecurityConfig


def read(file: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(file.read_bytes())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_authority(tmp_path / "keys", "lab")
    return tmp_path / "keys"


def test_the_authority_signs_certificates_and_nothing_below_it_does(folder: Path) -> None:
    authority = read(folder / "ca.pem")
    certificate = read(make_certificate(folder, "r1", ["10.0.0.1"]).file)

    authority.verify_directly_issued_by(authority)
    certificate.verify_directly_issued_by(authority)
    basic = authority.extensions.get_extension_for_class(x509.BasicConstraints)
    assert (basic.critical, basic.value) == (True, x509.BasicConstraints(ca=True, path_length=0))
    basic = certificate.extensions.get_extension_for_class(x509.BasicConstraints)
    assert (basic.critical, basic.value) == (True, x509.BasicConstraints(ca=False, path_length=None))
    assert authority.extensions.get_extension_for_class(x509.KeyUsage).value.key_cert_sign
    assert not certificate.extensions.get_extension_for_class(x509.KeyUsage).value.key_cert_sign


def test_a_certificate_names_its_owner_and_where_it_is_reached(folder: Path) -> None:
    made = make_certificate(folder, "r1", ["10.0.0.1", "robot.local", "::1", "10.0.0.1"])
    certificate = read(made.file)

    assert [name.value for name in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)] == ["r1"]
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["robot.local"]
    assert [str(address) for address in names.get_values_for_type(x509.IPAddress)] == ["10.0.0.1", "::1"]
    usages = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert set(usages) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    assert made.hosts == ("10.0.0.1", "robot.local", "::1")


def test_a_strict_client_takes_a_certificate(folder: Path) -> None:
    """Python from 3.13 on did not: key identifiers were missing."""
    certificate = read(make_certificate(folder, "r1", ["10.0.0.1"]).file)
    strict = PolicyBuilder().store(Store([read(folder / "ca.pem")]))
    chain = strict.build_server_verifier(x509.IPAddress(ip_address("10.0.0.1"))).verify(certificate, [])
    assert chain[0] == certificate


def test_certificates_last_two_years_and_the_authority_ten(folder: Path) -> None:
    now, certificate, authority = wall_time(), read(make_certificate(folder, "r1").file), read(folder / "ca.pem")

    assert timedelta(hours=23) < now - certificate.not_valid_before_utc < timedelta(hours=25)
    assert timedelta(days=824) < certificate.not_valid_after_utc - now < timedelta(days=826)
    assert timedelta(days=3649) < authority.not_valid_after_utc - now < timedelta(days=3651)


def test_private_keys_are_for_their_owner_alone(folder: Path) -> None:
    make_certificate(folder, "r1")

    for name in ("ca.key", "r1.key"):
        assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert sorted(file.name for file in folder.iterdir()) == ["ca.key", "ca.pem", "r1.key", "r1.pem"]


def test_nothing_is_overwritten_unless_forced(folder: Path) -> None:
    make_certificate(folder, "r1")
    before = {file: file.read_bytes() for file in folder.iterdir()}

    with pytest.raises(ConfigError, match=r"r1\.key: is there already; --force replaces it"):
        make_certificate(folder, "r1")
    with pytest.raises(ConfigError, match=r"ca\.key: is there already"):
        make_authority(folder, "lab")
    assert {file: file.read_bytes() for file in folder.iterdir()} == before

    make_certificate(folder, "r1", force=True)
    assert (folder / "r1.key").read_bytes() != before[folder / "r1.key"]
    assert stat.S_IMODE((folder / "r1.key").stat().st_mode) == 0o600


def test_one_of_two_files_counts_as_there(folder: Path) -> None:
    make_certificate(folder, "r1")
    (folder / "r1.key").unlink()

    with pytest.raises(ConfigError, match=r"r1\.pem: is there already"):
        make_certificate(folder, "r1")


@pytest.mark.parametrize("name", ["ca", "CA", "../r1", "", "1st", "a" * 65, "r 1"])
def test_names_that_no_certificate_can_have(folder: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be the name of a certificate"):
        make_certificate(folder, name)


def test_without_an_authority_nothing_is_made(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"ca\.key: is missing; `eal keys init` makes the fleet's authority"):
        make_certificate(tmp_path, "r1")

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("file", ["ca.key", "ca.pem"])
def test_a_damaged_authority_is_told(folder: Path, file: str) -> None:
    (folder / file).write_text("no pem")

    with pytest.raises(ConfigError, match=f"{file}: cannot be read as a"):
        make_certificate(folder, "r1")


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")

    with pytest.raises(ConfigError, match="cannot be written: Not a directory"):
        make_authority(tmp_path / "file" / "keys", "lab")


def test_the_list_begins_with_the_authority(folder: Path) -> None:
    for name in ("zoe", "alice"):
        make_certificate(folder, name)

    found = list_certificates(folder)

    assert [certificate.name for certificate in found] == ["ca", "alice", "zoe"]
    assert [certificate.days_left for certificate in found] == [3649, 824, 824]
    with pytest.raises(ConfigError, match="no such folder; `eal keys init` makes it"):
        list_certificates(folder / "nowhere")


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("ca.pem", None, "is missing; make it"),
        ("ca.pem", "half", "is damaged; make it"),
        ("r1.pem", None, "is missing; make it"),
        ("r1.key", None, "is missing; make it"),
        ("r1.key", "half", "does not fit r1.pem, or one of both is damaged; make it"),
        ("r1.key", "empty", "does not fit r1.pem, or one of both is damaged; make it"),
        ("r1.key", "r2.key", "does not fit r1.pem, or one of both is damaged; make it"),
        ("r1.key", "folder", "cannot be read: Is a directory"),
        ("ca.pem", "other/ca.pem", "is not signed by ca.pem; make it"),
    ],
)
def test_keys_that_cannot_be_used_are_reported(folder: Path, name: str, content: str | None, problem: str) -> None:
    make_certificate(folder, "r1")
    make_certificate(folder, "r2")
    make_authority(folder / "other", "the same fleet")
    check_keys(folder, "r1")
    file = folder / name
    whole = file.read_text()
    file.unlink()
    match content:
        case "half":
            file.write_text(whole[: len(whole) // 2])
        case "empty":
            file.touch()
        case "folder":
            file.mkdir()
        case str():
            file.write_bytes((folder / content).read_bytes())
    with pytest.raises(ConfigError) as error:
        check_keys(folder, "r1")
    wrong = folder / "r1.pem" if content == "other/ca.pem" else file
    assert str(error.value).startswith(f"{wrong}: {problem}")


def test_keys_of_any_date_can_be_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot without a clock battery starts in the past, and serves once its clock is right."""
    for days in (-5000, 5000):
        monkeypatch.setattr("eal_actors.managers.keys.certificates.wall_time", lambda: wall_time() + timedelta(days))  # noqa: B023
        make_authority(folder, "f", force=True)
        make_certificate(folder, "r1", force=True)
        check_keys(folder, "r1")


def test_warnings_say_whether_a_certificate_expires_or_has_expired(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, security = make_certificate(folder, "r1", valid=timedelta(days=100)), SecurityConfig(folder, "r1", ())
    for when, told, refused in (
        (made.begins - timedelta(seconds=1), f"is not valid before {made.begins:%Y-%m-%d}: correct this clock", True),
        (made.begins + timedelta(days=60), None, False),
        (made.expires - timedelta(days=3), f"expires in 3 days ({made.expires:%Y-%m-%d}): eal keys renew r1", False),
        (made.expires, f"has expired ({made.expires:%Y-%m-%d}): eal keys renew r1", True),
    ):
        monkeypatch.setattr(expiry, "wall_time", lambda now=when: now)
        warnings = [] if told is None else [f"the certificate r1 {told}"]
        assert [it for it in expiry.certificate_warnings(security, "r1") if "r1" in it] == warnings
        invalid = expiry.certificate_warnings(security, "r1", only_invalid=True)
        assert [it for it in invalid if "r1" in it] == warnings * refused


def test_a_revoked_name_is_told_why_it_is_refused(folder: Path) -> None:
    make_certificate(folder, "anna")
    security = SecurityConfig(folder, "anna", ())
    assert expiry.certificate_warnings(security, "anna", only_invalid=True) == []
    revoke(folder, ["anna"])
    assert expiry.certificate_warnings(security, "anna", only_invalid=True) == [
        "the certificate anna is revoked: its owner needs one with another name"
    ]
    (folder / REVOKED).write_text("no name\n")  # reported when the network opens
    assert expiry.certificate_warnings(security, "anna", only_invalid=True) == []


def test_the_end_of_a_short_lifetime_has_its_minute() -> None:
    now = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
    assert expiry.day_or_minute(now + timedelta(hours=8), now) == "2026-03-01 16:00 UTC"
    assert expiry.day_or_minute(now + timedelta(days=90), now) == "2026-05-30"
