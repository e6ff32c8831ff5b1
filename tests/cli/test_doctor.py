"""`eal doctor` on this machine, with real robots, ports and keys."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from eal_actors.facade.service import RobotService
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.operate.doctor.plugins import check_plugins
from tests.net.links import free_port


def findings(result: Any, area: str) -> list[tuple[str, str]]:
    return [
        (finding["level"], finding["what"])
        for finding in json.loads(result.stdout)["findings"]
        if finding["area"] == area
    ]


@pytest.fixture
def remote(slides: Path) -> tuple[Path, int]:
    """A fleet of one robot that is served on this machine, and its port."""
    port = free_port()
    text = slides.read_text(encoding="utf-8").replace("  two: {plugins: {slide: {}}}\n", "")
    slides.write_text(text.replace("  one: {", f"  one: {{address: 'tcp/127.0.0.1:{port}', "), encoding="utf-8")
    return slides, port


class TestMachine:
    def test_without_a_fleet_only_the_machine_is_checked(self, eal: Any) -> None:
        result = eal("doctor", "--json")
        answer = json.loads(result.stdout)
        assert {finding["area"] for finding in answer["findings"]} == {"python", "packages", "clock"}
        assert result.exit_code == (1 if answer["problems"] else 0)
        assert findings(result, "python")[0][0] == "ok"

    def test_the_table_has_texts_signs_and_counts(self, eal: Any) -> None:
        text = eal("doctor").stdout
        assert "✓ ok" in text
        assert "python" in text
        assert text.splitlines()[-1].startswith("0 problems, ")

    def test_an_ascii_terminal_gets_ascii_signs(self, start: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("PYTHONIOENCODING", "ascii")
        process = start("doctor", "--fleet", "nowhere.yaml")
        out, _ = process.communicate(timeout=60)
        assert process.returncode == 1
        assert "x problem" in out
        assert out.isascii()


class TestFleetFile:
    def test_a_good_local_fleet_has_no_problem(self, eal: Any, slides: Path) -> None:
        result = eal("doctor", "--fleet", slides, "--json")
        assert result.exit_code == 0
        assert findings(result, "plugins") == [("ok", "slide 0.1.0")]
        assert findings(result, "fleet file") == [("ok", f"{slides}: 2 of 2 robots on this machine")]

    def test_a_broken_file_is_a_problem_with_its_place(self, eal: Any, write: Any) -> None:
        file = write("bad.yaml", "version: 1\nrobots: {one: {plugin: {}}}\n")
        result = eal("doctor", "--fleet", file, "--json")
        assert result.exit_code == 1
        told = findings(result, "fleet file")
        assert all(level == "problem" and what.startswith(f"{file}:2:") for level, what in told)
        assert any("plugin" in what for _, what in told)

    def test_settings_that_a_plugin_refuses_are_a_problem(self, eal: Any, write: Any) -> None:
        file = write("bad.yaml", "version: 1\nrobots: {one: {plugins: {serial_port: {porrt: x}}}}\n")
        result = eal("doctor", "--fleet", file, "--json")
        assert any("porrt" in what for level, what in findings(result, "fleet file") if level == "problem")

    def test_a_plugin_that_needs_an_extra_says_which(self, write: Any) -> None:
        write(
            "plugins/eye/plugin.yaml",
            "version: 1\nname: eye\ndescription: d\nplugin_version: '1'\nrequires: [no_such_module]\nextra: vision\n",
        )
        file = write("f.yaml", "version: 1\nplugin_dirs: [plugins]\nrobots: {one: {plugins: {eye: {}}}}\n")
        config = EALConfigManager.load(file).fleet
        (finding,) = check_plugins(config, config.robots.values())
        assert finding.level == "problem"
        assert "no_such_module" in finding.what
        assert finding.advice == "pip install 'eal-actors[vision]'"

    def test_a_device_that_is_not_there_is_a_problem(self, eal: Any, write: Any) -> None:
        file = write("f.yaml", "version: 1\nrobots: {one: {plugins: {serial_port: {port: /dev/ttyNONE9}}}}\n")
        result = eal("doctor", "--fleet", file, "--json")
        assert result.exit_code == 1
        assert findings(result, "devices") == [("problem", "/dev/ttyNONE9 of one is not there")]

    def test_a_device_that_is_no_serial_port_is_a_problem(self, eal: Any, write: Any) -> None:
        file = write("f.yaml", "version: 1\nrobots: {one: {plugins: {serial_port: {port: /dev/null}}}}\n")
        result = eal("doctor", "--fleet", file, "--json")
        assert result.exit_code == 1
        assert findings(result, "devices") == [("problem", "/dev/null of one is no serial port")]

    def test_a_name_without_a_fleet_is_wrong_input(self, eal: Any, slides: Path) -> None:
        assert eal("doctor", slides).exit_code == 2

    def test_an_unknown_robot_is_wrong_input(self, eal: Any, slides: Path) -> None:
        assert eal("doctor", "--fleet", slides, "three").exit_code == 2


class TestRemoteRobots:
    def test_a_served_robot_answers_and_uses_its_port(self, eal: Any, remote: tuple[Path, int]) -> None:
        file, port = remote
        with RobotService(EALConfigManager.load(file).fleet, "one"):
            result = eal("doctor", "--fleet", file, "--json")
        assert result.exit_code == 0
        assert findings(result, "ports") == [("ok", f"one is served at tcp/127.0.0.1:{port}")]
        ((level, what),) = findings(result, "robots")
        assert level == "ok"
        assert what.startswith("one answers in ")

    def test_a_port_used_by_another_program_is_a_problem(self, eal: Any, remote: tuple[Path, int]) -> None:
        file, port = remote
        with socket.create_server(("127.0.0.1", port)):
            result = eal("doctor", "--fleet", file, "--json")
        assert result.exit_code == 1
        ((level, what),) = findings(result, "ports")
        assert (level, "used by" in what) == ("problem", True)
        ((level, what),) = findings(result, "robots")
        assert (level, "does not answer" in what) == ("problem", True)

    def test_a_host_name_without_an_address_is_named(self, eal: Any, write: Any) -> None:
        file = write("f.yaml", "version: 1\nrobots: {one: {address: tcp/one.invalid:50000, plugins: {sample: {}}}}\n")
        result = eal("doctor", "--fleet", file)
        assert "No address is known here for one.invalid" in " ".join(result.stdout.split())

    def test_a_missing_router_is_named(self, eal: Any, write: Any) -> None:
        with socket.create_server(("127.0.0.1", 0)) as other:
            router = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        file = write(
            "f.yaml",
            f"""\
            version: 1
            network: {{routers: [{router}]}}
            robots: {{one: {{address: router, plugins: {{sample: {{}}}}}}}}
            """,
        )
        result = eal("doctor", "--fleet", file)
        text = " ".join(result.stdout.split())
        assert f"no router answers at {router}" in text
        assert "Check that eal router runs" in text


@pytest.fixture
def secured(write: Any, tmp_path: Path) -> Path:
    """A fleet with one remote robot, an authority and the controller's certificate."""
    make_authority(tmp_path / "keys", "f")
    make_certificate(tmp_path / "keys", "controller")
    write(
        "f.yaml",
        """\
        version: 1
        network: {security: {keys: keys, roles: {controllers: [controller]}}}
        robots: {one: {address: "tls/127.0.0.1:1", plugins: {sample: {}}}}
        """,
    )
    return tmp_path / "f.yaml"


class TestCertificates:
    def check(self, eal: Any, file: Path) -> list[tuple[str, str]]:
        return findings(eal("doctor", "--fleet", file, "--json"), "certificates")

    def test_good_certificates_are_reported(self, eal: Any, secured: Path) -> None:
        make_certificate(secured.parent / "keys", "one", ["127.0.0.1"])
        found = self.check(eal, secured)
        assert [level for level, _ in found] == ["ok", "ok"]
        assert found[0][1].startswith("controller is valid until ")

    def test_a_missing_certificate_is_a_problem(self, eal: Any, secured: Path) -> None:
        assert ("problem", f"{secured.parent}/keys/one.pem is missing") in self.check(eal, secured)

    def test_a_revoked_certificate_is_a_problem(self, eal: Any, secured: Path) -> None:
        make_certificate(secured.parent / "keys", "one", ["127.0.0.1"])
        (revoked := secured.parent / "keys/revoked.txt").write_text("controller\n")
        assert [it for it in self.check(eal, secured) if it[0] == "problem"] == [("problem", "controller is revoked")]
        revoked.write_text("no name\n")
        assert ("problem", f"{revoked}:1:1: 'no name' is not the name of a certificate") in self.check(eal, secured)

    def test_an_open_key_a_foreign_authority_and_a_wrong_host(self, eal: Any, secured: Path) -> None:
        keys = secured.parent / "keys"
        make_authority(secured.parent / "other", "g")
        made = make_certificate(secured.parent / "other", "one", ["10.0.0.1"])
        made.file.rename(keys / "one.pem")
        made.file.with_suffix(".key").rename(keys / "one.key")
        (keys / "controller.key").chmod(0o644)
        told = [what for level, what in self.check(eal, secured) if level == "problem"]
        assert f"{keys}/controller.key has the mode 644: other users can read or change it" in told
        assert "one is not signed by the authority in ca.pem" in told
        assert "one has the host 127.0.0.1, but its certificate is for 10.0.0.1" in told

    def test_a_key_that_does_not_match_its_certificate(self, eal: Any, secured: Path) -> None:
        keys = secured.parent / "keys"
        make_certificate(keys, "one", ["127.0.0.1"])
        (keys / "one.key").write_bytes((keys / "controller.key").read_bytes())
        assert ("problem", f"{keys}/one.key is not the key of one.pem") in self.check(eal, secured)
