"""Operators and the certificate change while the dashboard serves: nothing is restarted, and all others stay."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed

from eal_actors.facade.fleet import Fleet
from eal_actors.managers.keys.certificates import (
    certificate_file,
    key_file,
    make_authority,
    make_certificate,
    renew_certificate,
)
from eal_actors.operate.dashboard import Access, Dashboard, places, tls_context, web_server
from eal_actors.operate.dashboard.session import SIGN_IN
from eal_actors.operate.dashboard.tokens import hash_token
from eal_actors.operate.doctor.diagnosis import diagnose_fleet
from tests.net.links import eventually
from tests.operate.dashboard.rig import WAIT_S, Page, connect_to, counting_fleet, page_of

HASHES = {name: hash_token(f"token-of-{name}") for name in ("anna", "ben", "carl")}


def token_of(name: str) -> str:
    return f"{name}.token-of-{name}"


def section(roles: Mapping[str, str]) -> str:
    """Return the section of a fleet file with operators."""
    lines = (f"    {name}: {{role: {role}, token: {HASHES[name]}}}\n" for name, role in roles.items())
    return "dashboard:\n  operators:\n" + "".join(lines) if roles else ""


@contextmanager
def served(folder: Path) -> Iterator[Dashboard]:
    """Serve a dashboard with the operators anna and ben."""
    with (
        counting_fleet(folder, "one", more=section({"anna": "drive", "ben": "run"})).connect() as fleet,
        Dashboard(fleet, Access("127.0.0.1", operators=fleet.config.operators)) as dashboard,
    ):
        yield dashboard


def rewrite(folder: Path, **roles: str) -> None:
    counting_fleet(folder, "one", more=section(roles))


def gets_in(dashboard: Dashboard, name: str) -> bool:
    try:
        with page_of(dashboard, token_of(name)) as page:
            return bool(page.hello["user"] == name)
    except ConnectionClosed as end:
        if end.rcvd is None or end.rcvd.code != SIGN_IN:
            raise
        return False


def test_a_removed_operator_is_signed_out_and_a_new_one_gets_in(tmp_path: Path) -> None:
    with (
        served(tmp_path) as dashboard,
        page_of(dashboard, token_of("anna")) as annas,
        page_of(dashboard, token_of("ben")) as bens,
    ):
        rewrite(tmp_path, ben="run", carl="drive")
        assert annas.hear_the_end() == SIGN_IN
        assert not gets_in(dashboard, "anna")  # although the token was known
        assert gets_in(dashboard, "carl")
        assert bens.ask(do="stop")["confirmed"] == ["one"]


def test_a_changed_role_counts_at_once(tmp_path: Path) -> None:
    with served(tmp_path) as dashboard, page_of(dashboard, token_of("ben")) as bens:
        rewrite(tmp_path, anna="drive", ben="watch")
        assert bens.hear_the_end() == SIGN_IN
        with page_of(dashboard, token_of("ben")) as page:
            assert page.hello["role"] == "watch"
            assert page.ask(do="stop")["code"] == "access_denied"


def test_a_wrong_file_changes_nothing_and_no_operators_let_nobody_in(tmp_path: Path) -> None:
    with served(tmp_path) as dashboard, page_of(dashboard, token_of("ben")) as bens:
        (tmp_path / "fleet.yaml").write_text("version: 1\nrobots: [")
        bens.hear_until(lambda: any("operators were not read" in str(line) for line in bens.logs))
        assert bens.ask(do="stop")["confirmed"] == ["one"]
        rewrite(tmp_path)
        assert bens.hear_the_end() == SIGN_IN
        assert not gets_in(dashboard, "ben")
        with connect_to(dashboard) as socket, pytest.raises(ConnectionClosed):
            Page(socket, None)


def test_a_renewed_certificate_is_used_without_a_restart(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (places, web_server):  # on a busy machine this page's own handshake may take longer
        monkeypatch.setattr(module, "WAIT_S", WAIT_S)
    keys = tmp_path / "keys"
    make_authority(keys, "counted")
    make_certificate(keys, "dashboard", ["127.0.0.1"])
    trusting = ssl.create_default_context(cafile=certificate_file(keys, "ca"))
    tls = tls_context(certificate_file(keys, "dashboard"), key_file(keys, "dashboard"))

    def shown(dashboard: Dashboard) -> bytes:
        with (
            socket.create_connection(("127.0.0.1", dashboard.port), WAIT_S) as plain,
            trusting.wrap_socket(plain, server_hostname="127.0.0.1") as peer,
        ):
            return peer.getpeercert(binary_form=True) or b""

    with Dashboard(fleet, tls=tls, keys=keys) as dashboard, page_of(dashboard, ssl=trusting) as page:
        former = shown(dashboard)
        renew_certificate(keys, "dashboard")
        new = ssl.PEM_cert_to_DER_cert(certificate_file(keys, "dashboard").read_text())
        assert eventually(lambda: shown(dashboard) == new)
        assert new != former
        assert page.ask(do="stop")["confirmed"] == ["one", "two"]


def test_the_doctor_warns_of_the_dashboards_certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = counting_fleet(tmp_path, "one").config
    keys = tmp_path / "keys"
    make_authority(keys, "counted")
    assert not [found for found in diagnose_fleet(config) if "dashboard" in str(found)]
    made = make_certificate(keys, "dashboard", ["127.0.0.1"], valid=timedelta(hours=9))
    later = made.expires - timedelta(hours=1)
    monkeypatch.setattr("eal_actors.operate.doctor.certificates.wall_time", lambda: later)
    (found,) = [str(found) for found in diagnose_fleet(config) if "dashboard" in str(found)]
    assert "eal keys renew dashboard" in found
