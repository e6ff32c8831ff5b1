"""Operators: names, roles and tokens from the fleet file, lockout, HTTPS, and the audit log of what they command."""

from __future__ import annotations

import json
import re
import ssl
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from eal_actors import Fleet
from eal_actors.kernel.errors import AccessDeniedError, ConfigError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import OperatorRole, OperatorSection
from eal_actors.managers.keys.certificates import certificate_file, key_file, make_authority, make_certificate
from eal_actors.operate.audit import AUDIT_FILE, AuditLog, read_audit
from eal_actors.operate.dashboard import Access, Dashboard, tls_context
from eal_actors.operate.dashboard.access import Role
from eal_actors.operate.dashboard.session import SIGN_IN
from eal_actors.operate.dashboard.sign_in import KEPT_OUT_S, WRONG_TOKENS, SignIn
from eal_actors.operate.dashboard.tokens import hash_token, matches
from tests.cli.conftest import Program
from tests.manual_clock import ManualClock
from tests.operate.agents.waiting_plan import keep_plan
from tests.operate.dashboard.rig import Page, connect_to, counting_fleet, page_of

ROLES: tuple[OperatorRole, ...] = ("watch", "drive", "run", "administer")
HASHES = {role: hash_token(f"token-of-{role}") for role in ROLES}
OPERATORS = {f"a.{role}": OperatorSection(role=role, token=HASHES[role]) for role in ROLES}
COMMANDS: dict[str, tuple[OperatorRole, dict[str, Any]]] = {
    "stop": ("drive", {"do": "stop"}),
    "resume": ("drive", {"do": "resume"}),
    "call": ("drive", {"do": "call", "robot": "one", "resource": "Base", "method": "send_cmd", "text": "turn9"}),
    "start": ("run", {"do": "start", "file": "none.yaml"}),
    "control": ("run", {"do": "control", "what": "abort"}),
    "configure": (
        "administer",
        {"do": "call", "robot": "one", "resource": "Base", "method": "set_config", "text": "none", "value": 1},
    ),
    "reload": ("administer", {"do": "reload"}),
}


def token_of(role: str) -> str:
    return f"a.{role}.token-of-{role}"


@pytest.fixture
def dashboard(fleet: Fleet, tmp_path: Path) -> Iterator[Dashboard]:
    with Dashboard(fleet, Access("127.0.0.1", operators=OPERATORS), runs_dir=tmp_path / "runs") as opened:
        yield opened


def refused(dashboard: Dashboard, token: str | None) -> str:
    """Return the reason with which the server closes the connection of a page."""
    with connect_to(dashboard) as socket, pytest.raises(ConnectionClosed) as ending:
        Page(socket, token)
    assert ending.value.rcvd is not None
    assert ending.value.rcvd.code == SIGN_IN
    return ending.value.rcvd.reason


# Tokens and lockout alone.


def test_a_hash_matches_its_token_only() -> None:
    kept = hash_token("the token")
    assert matches("the token", kept)
    assert not matches("the token ", kept)
    assert not matches("the token", "***")  # in the copy of the fleet file beside a run
    assert kept != hash_token("the token"), "each hash has its own salt"


class TestSignIn:
    """With a manual clock."""

    def test_wrong_tokens_keep_an_address_out_for_a_while(self) -> None:
        clock = ManualClock()
        sign_in = SignIn(Access("127.0.0.1", operators=OPERATORS), clock)
        for _ in range(WRONG_TOKENS):
            with pytest.raises(AccessDeniedError, match="wrong token"):
                sign_in.visitor("a.run.guess", "10.0.0.1")
        clock.advance(1.0)
        with pytest.raises(AccessDeniedError, match=r"too many wrong tokens from 10.0.0.1: try again in 59 s"):
            sign_in.visitor(token_of("run"), "10.0.0.1")
        assert sign_in.visitor(token_of("run"), "10.0.0.2").name == "a.run"
        assert sign_in.visitor(token_of("run"), "10.0.0.1").name == "a.run"  # known by now, so nobody guessed it
        clock.advance(KEPT_OUT_S)
        assert sign_in.visitor(token_of("drive"), "10.0.0.1").role is Role.DRIVE

    def test_a_token_in_place_of_a_link_is_limited_too(self) -> None:
        sign_in = SignIn(Access("127.0.0.1", "the-token"), ManualClock())
        for _ in range(WRONG_TOKENS):
            assert sign_in.visitor("guess", "10.0.0.1").role is Role.WATCH
        with pytest.raises(AccessDeniedError, match="too many wrong tokens"):
            sign_in.visitor("the-token", "10.0.0.1")

    @pytest.mark.parametrize("token", ["", ".", "nobody.x", "a.run", "a.run.", "a.drive.token-of-run", "ä.ö"])
    def test_no_other_token_is_anybodys(self, token: str) -> None:
        with pytest.raises(AccessDeniedError, match="wrong token"):
            SignIn(Access("127.0.0.1", operators=OPERATORS)).visitor(token, "10.0.0.1")


# The dashboard.


def test_nobody_sees_anything_without_a_token(dashboard: Dashboard) -> None:
    assert refused(dashboard, None) == "sign in with your token"
    assert refused(dashboard, "a.run.wrong") == "wrong token"


def test_a_browser_with_wrong_tokens_is_kept_out(dashboard: Dashboard) -> None:
    for _ in range(WRONG_TOKENS):
        assert refused(dashboard, "a.run.wrong") == "wrong token"
    assert re.fullmatch(
        r"too many wrong tokens from 127.0.0.1: try again in \d+ s", refused(dashboard, token_of("run"))
    )


@pytest.mark.parametrize("role", ROLES)
def test_each_role_may_do_what_it_says(dashboard: Dashboard, role: OperatorRole) -> None:
    with page_of(dashboard, token_of(role)) as page:
        assert (page.hello["user"], page.hello["role"]) == (f"a.{role}", role)
        for name, (needed, command) in COMMANDS.items():
            answer = page.ask(**command)
            is_refused = answer.get("code") == "access_denied"
            assert is_refused is (ROLES.index(role) < ROLES.index(needed)), name
            if is_refused:
                assert answer["error"] == f"a.{role} has the role {role}; this needs {needed}"


@pytest.mark.parametrize("role", ROLES)
def test_plans_of_agents_are_shown_to_those_who_decide_about_them(
    dashboard: Dashboard, tmp_path: Path, role: OperatorRole
) -> None:
    plan = keep_plan(tmp_path / "runs", "hall")
    with page_of(dashboard, token_of(role)) as page:
        answer = page.ask(do="plans")
    dashboard.close()
    asked = [entry["outcome"] for entry in read_audit(tmp_path / "runs") if entry["command"] == "plans"]
    if role in ("run", "administer"):
        assert [shown["hash"] for shown in answer["plans"]] == [plan.hash]
        assert asked == [], "the page asks every two seconds, which is no command"
    else:
        assert answer["code"] == "access_denied"
        assert asked == [f"refused: a.{role} has the role {role}; this needs run"]


def test_the_audit_log_has_every_command(dashboard: Dashboard, tmp_path: Path, eal: Program) -> None:
    with page_of(dashboard, token_of("drive")) as page:
        name = page.hello["you"]
        for _, command in COMMANDS.values():
            page.ask(**command)
        for _ in range(3):
            page.drive(robot="one", press=7, speed_m_s=0.1, turn_rad_s=0.0)
        page.say(do="release", robot="one")
        page.ask(do="describe", robot="one")  # which is no command
    refused(dashboard, "a.run.wrong")
    dashboard.close()
    runs = tmp_path / "runs"
    assert stat.S_IMODE((runs / AUDIT_FILE).stat().st_mode) == 0o600
    assert "token-of" not in (runs / AUDIT_FILE).read_text()
    entries = read_audit(runs)
    assert [(entry["command"], entry["outcome"]) for entry in entries] == [
        ("sign in", "ok"),
        ("stop", "ok"),
        ("resume", "ok"),
        ("call", "ok"),
        ("start", "refused: a.drive has the role drive; this needs run"),
        ("control", "refused: a.drive has the role drive; this needs run"),
        ("call", "refused: a.drive has the role drive; this needs administer"),
        ("reload", "refused: a.drive has the role drive; this needs administer"),
        ("drive", "ok"),
        ("sign in", "refused: wrong token"),
    ]
    call = entries[3]
    assert (call["who"], call["role"], call["from"], call["browser"]) == ("a.drive", "drive", "127.0.0.1", name)
    assert (call["arguments"]["robot"], call["arguments"]["text"]) == ("one", "turn9")
    assert call["at"] <= call["ended"]
    shown = eal("audit", "--runs-dir", runs)
    assert shown.exit_code == 0
    assert re.search(r"a\.drive +127\.0\.0\.1 +call one Base", shown.stdout)
    assert json.loads(eal("audit", "--runs-dir", runs, "--last", 1, "--json").stdout)["commands"] == entries[-1:]


def test_a_command_whose_end_is_lost_is_in_the_audit_log(tmp_path: Path, eal: Program) -> None:
    log = AuditLog(tmp_path)
    log.start()
    log.begin({"who": "anna", "role": "drive", "from": "10.0.0.1", "browser": "browser 1"}, "call", {"robot": "one"})
    log.close()
    with (tmp_path / AUDIT_FILE).open("a") as file:
        file.write('{"at": "2026-')  # the process was killed here
    (entry,) = read_audit(tmp_path)
    assert (entry["who"], entry["outcome"]) == ("anna", None)
    assert "none yet" in eal("audit", "--runs-dir", tmp_path).stdout


def test_a_long_error_does_not_push_other_entries_out_of_the_audit_log(tmp_path: Path) -> None:
    """An agent asked for a plan whose hash had four million characters; the refusal repeated them."""
    log = AuditLog(tmp_path).start()
    log.begin({"who": "agent", "from": "stdio"}, "run_plan", {})("refused: " + "a" * 4_000_000)
    log.close()
    assert (tmp_path / AUDIT_FILE).stat().st_size < 2000
    assert read_audit(tmp_path)[0]["outcome"].startswith("refused: aaa")


def test_an_audit_log_that_cannot_be_written_is_an_error_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file")
    with pytest.raises(ConfigError, match=r"audit.jsonl: cannot be written"):
        AuditLog(tmp_path / "runs")


# HTTPS.


def test_https_with_the_fleets_own_authority(fleet: Fleet, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    make_authority(keys, "counted")
    make_certificate(keys, "dashboard", ["127.0.0.1", "lab.example"])
    tls = tls_context(certificate_file(keys, "dashboard"), key_file(keys, "dashboard"))
    trusting = ssl.create_default_context(cafile=certificate_file(keys, "ca"))
    access = Access("127.0.0.1", operators=OPERATORS, names=("lab.example",))
    with Dashboard(fleet, access, tls=tls) as dashboard:
        assert dashboard.url.startswith("https://127.0.0.1:")
        with page_of(dashboard, token_of("drive"), ssl=trusting) as page:
            assert page.ask(do="stop")["confirmed"] == ["one", "two"]
        with pytest.raises(ssl.SSLCertVerificationError), page_of(dashboard, ssl=ssl.create_default_context()):
            pass
    assert access.knows_host("lab.example:8080")


def test_a_certificate_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "dashboard.pem").write_text("no certificate")
    with pytest.raises(ConfigError, match=r"dashboard.pem: cannot be used for HTTPS"):
        tls_context(tmp_path / "dashboard.pem", tmp_path / "dashboard.key")


# The commands that make them.


def test_eal_keys_makes_a_token_whose_hash_a_fleet_file_accepts(tmp_path: Path, eal: Program) -> None:
    made = eal("keys", "operator", "anna", "--role", "run")
    assert made.exit_code == 0
    token = made.stdout.strip()
    section = "".join(f"{line}\n" for line in made.stderr.splitlines() if line.startswith((" ", "dashboard:")))
    config = counting_fleet(tmp_path, "one", more=section).config
    visitor = Access("127.0.0.1", operators=config.operators).visitor(token)
    assert (visitor.name, visitor.role) == ("anna", Role.RUN)
    assert token.partition(".")[2] not in section
    assert eal("keys", "operator", "no name").exit_code == 2


def test_a_hash_that_is_none_is_refused_with_its_line(tmp_path: Path) -> None:
    section = "dashboard:\n  operators:\n    anna: {role: run, token: secret}\n"
    with pytest.raises(
        ConfigError, match=r"fleet.yaml:8:30: dashboard.operators.anna.token: must be the hash"
    ) as caught:
        counting_fleet(tmp_path, "one", more=section)
    assert "secret" not in str(caught.value)


def test_eal_keys_makes_the_certificate_of_the_dashboard(tmp_path: Path, eal: Program) -> None:
    counting_fleet(tmp_path, "one")
    file = tmp_path / "fleet.yaml"
    assert eal("keys", "init", "--fleet", file).exit_code == 0
    made = eal("keys", "dashboard", "--fleet", file, "--host", "lab.example")
    assert made.exit_code == 0
    assert "lab.example" in made.stderr
    keys = EALConfigManager.load(file).fleet.source.parent / "keys"
    tls_context(certificate_file(keys, "dashboard"), key_file(keys, "dashboard"))
