"""Certificates that are revoked and renewed while robots run: nothing is restarted, and all others stay connected."""

from __future__ import annotations

import json
import shutil
import socket
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

from eal_actors.cli.app import app
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import AccessDeniedError, ConfigError, UnavailableError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys import expiry
from eal_actors.managers.keys.certificates import (
    certificate_file,
    key_file,
    list_certificates,
    make_certificate,
    renew_certificate,
)
from eal_actors.managers.keys.key_watch import KeyWatch
from eal_actors.managers.keys.revocation import REVOKED, revoked_names
from eal_actors.operate.doctor import diagnose_fleet
from eal_actors.operate.top.call_statistics import RecentCalls
from eal_actors.operate.top.robot_row import robot_row
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import ACCEPTED
from eal_actors.wire.session import controller_config, open_session, router_config
from eal_actors.wire.session_keeper import router_session
from tests.log_lines import log_lines
from tests.net.links import ask, eventually, free_port
from tests.net.rig import WAIT_S, Rig, ready
from tests.operate.dashboard.rig import open_dashboard, page_of
from tests.security.forging import RawClient, as_seen_by, make_keys, raw_client, secure_rig


def invoke(*arguments: str) -> tuple[int, str]:
    """Run the program, and return its exit code and output."""
    done = CliRunner().invoke(app, [*arguments], env={"COLUMNS": "200"})
    return done.exit_code, done.output


def folder_for(name: str, source: Path, into: Path) -> Path:
    """Make a folder of keys as a robot or router has one: its own files, and the authority's certificate."""
    into.mkdir(exist_ok=True)
    for file in (certificate_file(source, "ca"), key_file(source, name), certificate_file(source, name)):
        shutil.copy(file, into)
    return into


def with_keys(config: FleetConfig, folder: Path) -> FleetConfig:
    assert config.network.security is not None
    security = replace(config.network.security, keys=folder)
    return replace(config, network=replace(config.network, security=security))


@dataclass
class Site:
    """A robot with a folder of keys of its own, and the operator's machine.

    Attributes:
        rig: the operator's fleet file.
        keys: the operator's folder, with the authority.
        theirs: the robot's folder.
    """

    rig: Rig
    keys: Path
    theirs: Path

    @contextmanager
    def served(self) -> Iterator[RobotService]:
        with RobotService(with_keys(self.rig.config, self.theirs), "r1") as service:
            yield service

    def revoke(self, *names: str) -> tuple[int, str]:
        return invoke("keys", "revoke", *names, "--fleet", str(self.rig.file))


@pytest.fixture
def site(tmp_path: Path) -> Site:
    folder = make_keys(tmp_path / "keys")
    return Site(secure_rig(tmp_path, folder, 60.0), folder, folder_for("r1", folder, tmp_path / "theirs"))


def links(client: RawClient) -> list[str]:
    """Return the sessions to which a client is linked."""
    info = client.session.info
    return [str(end) for end in (*info.peers_zid(), *info.routers_zid())]


def answers(client: RawClient) -> bool:
    """Return whether the robot answers a ping, even a malformed one."""
    return bool(ask(client.session, f"eal/f/r1/_/{keys.PING}", client.name))


def test_a_revoked_controller_is_halted_and_cut_off_and_all_others_stay(site: Site) -> None:
    with (
        site.served() as service,
        raw_client(site.rig.config, "mate") as mate,
        raw_client(site.rig.config, "controller") as controller,
        raw_client(site.rig.config, "display") as display,
    ):
        for client in (mate, controller, display):
            client.ping()
        assert mate.call("Arm", "send_cmd", "move60") is ACCEPTED
        overheard: list[str] = []
        mate.session.declare_subscriber("eal/f/@events/r1", lambda event: overheard.append(str(event.key_expr)))

        former = links(controller)

        code, output = site.revoke("mate")

        assert (code, "r1: stored and in force" in output) == (0, True), output
        assert eventually(lambda: site.rig.notes("halt"))
        assert service.robot["Arm"].get_status().get() == 0
        assert revoked_names(site.theirs) == {"mate"}
        assert not answers(mate)
        assert eventually(lambda: links(controller) not in (former, []))  # the robot has opened its session again
        assert eventually(lambda: answers(controller))
        controller.ping()
        assert controller.call("Arm", "send_cmd", "step1") == 1
        assert eventually(lambda: answers(display))
        assert not answers(mate)
        overheard.clear()
        move = controller.call("Arm", "send_cmd", "move60")
        assert move is ACCEPTED
        assert controller.call("Arm", "halt") == 1
        assert eventually(lambda: answers(controller))
        assert overheard == []
    with site.served(), raw_client(site.rig.config, "controller") as controller:  # a restart forgets nothing
        assert answers(controller)
        with open_session(controller_config(as_seen_by(site.rig.config, "mate"))) as mate:
            assert eventually(lambda: list(mate.info.peers_zid()))  # it is linked, and hears nothing
            assert list(mate.liveliness().get("eal/f/@alive/*/*")) == []
            assert ask(mate, "eal/f/r1/_/ping", "mate") == []


def test_a_robot_that_was_away_is_named_and_follows_later(site: Site) -> None:
    code, output = site.revoke("driver")
    assert code == 1
    assert "NOT CONFIRMED: r1: did not answer" in output
    with site.served():
        code, output = site.revoke()
    assert (code, "r1: stored and in force" in output) == (0, True), output
    assert revoked_names(site.theirs) == {"driver"}


def test_nobody_but_the_authority_revokes(site: Site) -> None:
    with site.served(), raw_client(site.rig.config, "controller") as controller:
        controller.ping()
        denied = controller.call(keys.ROBOT, keys.REVOKE, "display")
        assert isinstance(denied, AccessDeniedError)
        assert "only the holder of the authority's key" in denied.message
    assert not (site.theirs / REVOKED).exists()
    with pytest.raises(ConfigError, match="cannot be the name of a certificate"):
        make_certificate(site.keys, keys.AUTHORITY_CALLER)


def test_a_revoked_name_is_not_given_again(site: Site) -> None:
    site.revoke("mate")
    for command in (["controller", "mate", "--force"], ["renew", "mate"]):
        code, output = invoke("keys", *command, "--fleet", str(site.rig.file))
        assert code == 2, output
        assert "mate is revoked and stays so" in output
    code, output = invoke("keys", "list", "--json", "--fleet", str(site.rig.file))
    assert [entry["name"] for entry in json.loads(output)["certificates"] if entry["revoked"]] == ["mate"]


def test_a_list_that_cannot_be_read_lets_nobody_in(site: Site) -> None:
    (site.theirs / REVOKED).write_text("mate\n../x\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"'\.\./x' is not the name of a certificate"):
        RobotService(with_keys(site.rig.config, site.theirs), "r1")


def serial_of(site: Site) -> bytes:
    """Return the certificate that the robot presents now; nothing while it does not listen."""
    port = int(site.rig.content["robots"]["r1"]["address"].rpartition(":")[2])
    context = ssl.create_default_context(cafile=site.keys / "ca.pem")
    context.load_cert_chain(certificate_file(site.keys, "controller"), key_file(site.keys, "controller"))
    try:
        with (
            socket.create_connection(("127.0.0.1", port), 20.0) as plain,
            context.wrap_socket(plain, server_hostname="127.0.0.1") as peer,
        ):
            return peer.getpeercert(binary_form=True) or b""
    except OSError:
        return b""


def test_a_renewed_certificate_is_used_without_a_restart(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    fitting, fits = list[bool](), KeyWatch._fits

    def note_fits(watch: KeyWatch) -> bool:
        fitting.append(fits(watch))
        return fitting[-1]

    monkeypatch.setattr(KeyWatch, "_fits", note_fits)
    with site.served() as service, raw_client(site.rig.config, "controller") as controller:
        controller.ping()
        assert controller.call("Arm", "send_cmd", "move60") is ACCEPTED
        code, output = invoke("keys", "renew", "r1", "--valid-for", "8h", "--fleet", str(site.rig.file))
        assert code == 0, output
        new = ssl.PEM_cert_to_DER_cert(certificate_file(site.keys, "r1").read_text())
        assert serial_of(site) != new
        shutil.copy(certificate_file(site.keys, "r1"), site.theirs)  # without its key: not followed
        assert eventually(lambda: fitting)
        assert not any(fitting)
        assert serial_of(site) not in (new, b"")
        shutil.copy(key_file(site.keys, "r1"), site.theirs)
        assert eventually(lambda: serial_of(site) == new)
        assert eventually(lambda: answers(controller))
        assert service.robot["Arm"].get_status().get() == 1  # it moves on
        assert controller.call(keys.ROBOT, keys.CANCEL, 1, controller.sequence - 1) == 1


@dataclass
class RoutedSite:
    """A router and a robot behind it, each with a folder of keys of its own.

    Attributes:
        rig: the operator's fleet file.
        gate: the router's folder.
    """

    rig: Rig
    gate: Path
    _theirs: Path

    def serve(self) -> RobotService:
        return RobotService(with_keys(self.rig.config, self._theirs), "r1")


@pytest.fixture
def routed(tmp_path: Path) -> Iterator[RoutedSite]:
    folder = make_keys(tmp_path / "keys")
    make_certificate(folder, "router", ["127.0.0.1"])
    endpoint = f"tls/127.0.0.1:{free_port()}"
    rig = secure_rig(tmp_path, folder, 60.0)
    network = rig.content["network"]
    network["routers"] = [endpoint]
    network["security"]["roles"] = {**network["security"]["roles"], "routers": ["router"]}
    rig.content["robots"]["r1"]["address"] = "router"
    rig.write()
    gate = folder_for("router", folder, tmp_path / "gate")
    config = with_keys(rig.config, gate)
    with router_session(config, "router", lambda: router_config([endpoint], (), config, "router")):
        yield RoutedSite(rig, gate, folder_for("r1", folder, tmp_path / "theirs"))


def test_a_router_follows_the_list_that_it_forwards(routed: RoutedSite) -> None:
    config = routed.rig.config
    with routed.serve(), raw_client(config, "controller") as controller, raw_client(config, "display") as display:
        assert answers(controller)
        assert answers(display)

        code, output = invoke("keys", "revoke", "display", "--fleet", str(routed.rig.file))

        assert (code, "r1: stored and in force" in output) == (0, True), output
        assert eventually(lambda: revoked_names(routed.gate) == {"display"})
        assert not answers(display)
        assert eventually(lambda: answers(controller))
        assert not answers(display)


def test_a_router_lets_a_revoked_robot_in_no_more(routed: RoutedSite) -> None:
    config = routed.rig.config
    with routed.serve(), raw_client(config, "controller") as controller:
        former = links(controller)
        assert answers(controller)
        code, output = invoke("keys", "revoke", "r1", "--fleet", str(routed.rig.file))
        assert code == 0, output
        assert eventually(lambda: revoked_names(routed.gate) == {"r1"})
        assert eventually(lambda: links(controller) not in (former, []))
        assert not answers(controller)
        assert list(controller.session.liveliness().get("eal/f/@alive/*/*")) == []


def test_a_second_process_of_a_robot_is_refused_behind_a_router_too(routed: RoutedSite) -> None:
    routed.rig.content["network"]["lease_s"] = 1.0
    routed.rig.write()
    with routed.serve(), pytest.raises(UnavailableError, match="r1: is served already, by"):
        routed.serve().open()
    with routed.serve():
        pass


def test_a_router_hears_of_a_revoked_robot_that_is_away(routed: RoutedSite) -> None:
    code, output = invoke("keys", "revoke", "r1", "--fleet", str(routed.rig.file))
    assert code == 0, output
    assert eventually(lambda: revoked_names(routed.gate) == {"r1"})


# Lifetimes.


@pytest.mark.parametrize(("text", "lifetime"), [("8h", timedelta(hours=8)), ("90d", timedelta(days=90))])
def test_a_certificate_lives_as_long_as_was_asked_for(site: Site, text: str, lifetime: timedelta) -> None:
    code, output = invoke("keys", "controller", "anna", "--valid-for", text, "--fleet", str(site.rig.file))
    assert code == 0, output
    (made,) = [made for made in list_certificates(site.keys) if made.name == "anna"]
    assert abs(made.lifetime - lifetime) < timedelta(minutes=1)
    assert abs(renew_certificate(site.keys, "anna").lifetime - lifetime) < timedelta(minutes=1)
    assert expiry.validity(made.file)[1] >= made.expires


@pytest.mark.parametrize("text", ["0h", "8", "8m", "-1h", "9999d", "1e3h"])
def test_no_other_lifetime_is_taken(site: Site, text: str) -> None:
    code, output = invoke("keys", "controller", "anna", f"--valid-for={text}", "--fleet", str(site.rig.file))
    assert code == 2
    assert "is no time from 1h to 3650d" in output


def test_what_is_about_to_expire_is_renewed_and_warned_of(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    make_certificate(site.keys, "r1", ["127.0.0.1"], valid=timedelta(hours=9), force=True)
    folder_for("r1", site.keys, site.theirs)
    later = expiry.validity(certificate_file(site.keys, "r1"))[1] - timedelta(hours=1, minutes=1)
    monkeypatch.setattr(expiry, "wall_time", lambda: later)
    monkeypatch.setattr("eal_actors.cli.keys_lifetime.wall_time", lambda: later)
    with log_lines() as log, site.served(), raw_client(site.rig.config, "controller") as controller:
        (warning,) = controller.ping()["warnings"]
        assert warning in log.getvalue()
        assert warning.startswith("the certificate r1 expires in 1 hours (")
        assert warning.endswith("): eal keys renew r1")
    code, output = invoke("keys", "renew", "--fleet", str(site.rig.file))
    assert code == 0, output
    assert output.count("valid until") == 1
    assert "r1.pem: made for 127.0.0.1" in output


def test_every_tool_warns_before_a_certificate_expires(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the robot's certificate and of this program's own: in pings, `eal top`, `eal doctor` and on the page."""
    for name, hosts in (("r1", ["127.0.0.1"]), ("controller", [])):
        make_certificate(site.keys, name, hosts, valid=timedelta(hours=9), force=True)
    folder_for("r1", site.keys, site.theirs)
    later = expiry.validity(certificate_file(site.keys, "r1"))[1] - timedelta(hours=1, minutes=1)
    monkeypatch.setattr(expiry, "wall_time", lambda: later)
    monkeypatch.setattr("eal_actors.operate.doctor.certificates.wall_time", lambda: later)
    with site.served(), ready(Fleet(site.rig.config)) as fleet:
        ping = fleet["r1"].ping().get()
        own, robots = "eal keys renew controller", "eal keys renew r1"
        assert [warning.rpartition(": ")[2] for warning in ping.warnings] == [robots, own]
        notes = "\n".join(robot_row(fleet["r1"], RecentCalls(), RecentCalls(), ping).notes)
        doctor = "\n".join(str(finding) for finding in diagnose_fleet(site.rig.config))
        pinged = invoke("ping", "--count", "1", "--fleet", str(site.rig.file))[1]
        for told in (notes, doctor, pinged):
            assert own in told
            assert robots in told
        with open_dashboard(fleet) as dashboard, page_of(dashboard) as page:
            page.hear_until(lambda: robots in str(page.robots.get("r1", {}).get("problems")))


@pytest.mark.slow
def test_a_link_ends_with_its_certificate(site: Site) -> None:
    make_certificate(site.keys, "display", valid=timedelta(seconds=20), force=True)
    with site.served(), raw_client(site.rig.config, "display") as display:
        assert answers(display)
        assert eventually(lambda: not answers(display))


@pytest.mark.slow
@pytest.mark.parametrize("late", ["mate", "r1"])
def test_a_robot_halts_when_a_certificate_expires_while_it_moves(site: Site, late: str) -> None:
    site.rig.content["network"]["dead_man_s"] = 1.0
    site.rig.write()
    make_certificate(site.keys, late, ["127.0.0.1"] if late == "r1" else (), valid=timedelta(seconds=20), force=True)
    folder_for("r1", site.keys, site.theirs)
    mate = as_seen_by(site.rig.config, "mate")
    with site.served() as service, ready(Fleet(mate)) as fleet:  # which sends heartbeats
        move = fleet["r1"]["Arm"].send_cmd("move60", timeout_s=120.0)
        assert site.rig.begun("move60")
        assert isinstance(move.exception(timeout=WAIT_S), UnavailableError)
        assert wall_time() >= expiry.validity(certificate_file(site.keys, late))[1]
        assert service.dead_man_trips == {"Arm": 1}
        assert service.robot["Arm"].get_status().get() == 0


def test_the_validity_of_a_certificate_is_read_without_the_library(site: Site) -> None:
    for made in list_certificates(site.keys):
        assert expiry.validity(made.file) == (made.begins, made.expires)
    for garbage in ("", "x", "-----BEGIN CERTIFICATE-----\nMAA=\n-----END CERTIFICATE-----\n"):
        (site.keys / "wrong.pem").write_text(garbage)
        with pytest.raises(ValueError, match=r"."):
            expiry.validity(site.keys / "wrong.pem")
