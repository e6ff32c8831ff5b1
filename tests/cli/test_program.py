"""Global options, help, exit codes and error messages."""

import json
from pathlib import Path
from typing import Any

import pytest

import eal_actors
from eal_actors.cli.exit_codes import TROUBLESHOOTING, ExitCode, exit_code, report_error
from eal_actors.cli.options import GlobalOptions
from eal_actors.kernel import errors
from eal_actors.kernel.errors import ConfigError, EALError, Problem


def test_it_tells_its_version(eal: Any) -> None:
    assert eal("--version").stdout == f"eal {eal_actors.__version__}\n"


def test_the_help_lists_the_commands_and_exit_codes(eal: Any) -> None:
    result = eal("--help")
    assert result.exit_code == 0
    for word in ("run", "check", "schema", "resources", "call", "plugin", "Exit codes: 0 done", "130 interrupted"):
        assert word in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    "arguments",
    [["no-such-command"], ["run"], ["run", "a.yaml"], ["--log-level", "loud", "plugin", "list"], ["schema", "robot"]],
)
def test_wrong_usage_is_bad_input(eal: Any, arguments: list[str]) -> None:
    result = eal(*arguments)
    assert result.exit_code == ExitCode.BAD_INPUT
    assert "Usage: " in result.stderr
    assert not result.stdout


def all_errors(base: type[EALError] = EALError) -> list[type[EALError]]:
    return [base, *(error for sub in base.__subclasses__() for error in all_errors(sub))]


BAD_INPUT = {
    "DataError",
    "ConfigError",
    "ResourceNotFoundError",
    "UnsupportedError",
    "ArgumentError",
    "PlaceNotFoundError",
    "RobotNotFoundError",
}
UNREACHABLE = {"PluginError", "UnavailableError", "NotReadyError", "RobotFailedError", "RemoteError"}


@pytest.mark.parametrize("kind", [kind for kind in all_errors() if kind.__module__ == errors.__name__])
def test_every_error_has_its_exit_code(kind: type[EALError]) -> None:
    error = ConfigError([Problem("f", 0, 0, "", "m")]) if kind is ConfigError else kind("m")
    wanted = 2 if kind.__name__ in BAD_INPUT else 3 if kind.__name__ in UNREACHABLE else 1
    assert exit_code(error) == wanted


def test_an_error_goes_to_stderr_with_what_to_do_next_and_no_traceback(eal: Any, slides: Path) -> None:
    result = eal("call", "one", "Slid", "get_value", "--fleet", slides)
    assert result.exit_code == ExitCode.BAD_INPUT
    assert result.stdout == ""
    assert result.stderr.splitlines() == [
        "Error: one: unknown resource 'Slid'; did you mean 'Slide'?",
        "`eal resources --fleet FLEET --robot ROBOT` lists resources and their commands.",
        f"resource_not_found: {TROUBLESHOOTING}#resource_not_found",
    ]


def test_debug_shows_the_traceback(eal: Any, slides: Path) -> None:
    result = eal("--log-level", "debug", "call", "one", "Slid", "get_value", "--fleet", slides)
    assert result.exit_code == ExitCode.BAD_INPUT
    assert "Traceback (most recent call last)" in result.stderr


def test_with_json_logs_an_error_is_one_object(eal: Any, slides: Path) -> None:
    result = eal("--log-format", "json", "call", "one", "Slide", "send_cmd", "to2", "--fleet", slides)
    (line,) = result.stderr.splitlines()
    entry = json.loads(line)
    assert (entry["level"], entry["code"], entry["exit_code"]) == ("error", "argument", 2)
    assert entry["event"].startswith("one/Slide: command 'to2': its argument must be double 0..1 m")


def test_every_problem_of_a_file_has_its_line(eal: Any, write: Any) -> None:
    fleet = write("bad.yaml", "version: 1\nseed: x\nrobots:\n  a: {tags: 5}\n")
    result = eal("resources", "--fleet", fleet)
    assert result.exit_code == ExitCode.BAD_INPUT
    lines = result.stderr.splitlines()
    places = [line.removeprefix(f"{fleet}:").split(" ")[0] for line in lines[:-2] if line[0] != " "]
    assert places == ["2:7:", "4:3:", "4:13:"]
    assert lines[1:3] == ["    seed: x", "          ^"]
    assert lines[-2:] == ["3 problems; nothing was done.", f"config: {TROUBLESHOOTING}#config"]


def test_the_fleet_may_come_from_the_environment(eal: Any, slides: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EAL_FLEET", str(slides))
    assert eal("call", "one", "Slide", "get_value").stdout == "0.0\n"


def test_flags_stand_in_the_help_without_a_type(eal: Any) -> None:
    for command in ([], ["run"], ["check"], ["call"], ["resources"], ["schema"], ["plugin"], ["plugin", "check"]):
        text = eal(*command, "--help").stdout
        assert "--help " in text
        assert "bool" not in text.lower()


def test_the_help_says_where_global_options_go(eal: Any) -> None:
    assert "Put --log-format and --log-level before the command" in " ".join(eal("--help").stdout.split())


def last_lines(result: Any) -> list[str]:
    lines: list[str] = result.stderr.splitlines()
    assert TROUBLESHOOTING in lines[-1]
    return lines[next(at for at, line in enumerate(lines) if line.startswith("Error: ")) + 1 : -1]


SEE_PLUGIN = "The plugin's code failed there, not the device: `eal plugin check FOLDER` tests it."
SEE_DEVICE = "Check that it is switched on and connected, then try again."


def test_what_to_do_about_a_device(eal: Any, half_dead: Path, move: Path) -> None:
    folder = half_dead.parent / "plugins" / "dead"
    for command in (["call", "lost", "Slide", "get_value"], ["run", move]):
        advice = last_lines(eal(*command, "--fleet", half_dead))
        assert advice == [SEE_DEVICE, f"Details: `eal plugin check {folder}`"]


def test_what_to_do_about_a_plugin(eal: Any, slides: Path, move: Path) -> None:
    plugin = slides.parent / "plugins" / "slide" / "plugin.py"
    plugin.write_text("1 / 0\n", encoding="utf-8")
    for command in (["call", "one", "Slide", "get_value"], ["run", move]):
        advice = last_lines(eal(*command, "--fleet", slides))
        assert advice == [f"Details: `eal plugin check {plugin.parent}`"]


def test_what_to_do_about_a_plugin_that_crashes(eal: Any, slides: Path, move: Path) -> None:
    """The advice was to switch the device on, and the message did not say where it crashed."""
    plugin = slides.parent / "plugins" / "slide" / "plugin.py"
    text = plugin.read_text(encoding="utf-8").replace("self._position_m = 0.0", "self._position_m = 1 / 0")
    plugin.write_text(text, encoding="utf-8")
    line = text[: text.index("1 / 0")].count("\n") + 1
    slides.write_text(slides.read_text(encoding="utf-8") + "defaults: {max_restarts: 0}\n", encoding="utf-8")
    for command in (["call", "one", "Slide", "get_value"], ["run", move]):
        result = eal(*command, "--fleet", slides)
        assert f"Slide crashed with ZeroDivisionError: division by zero (at slide/plugin.py:{line})" in result.stderr
        assert last_lines(result) == [SEE_PLUGIN]


def test_what_to_do_about_settings_that_a_plugin_refuses(eal: Any, write: Any) -> None:
    fleet = write(
        "far.yaml",
        "version: 1\nworld: lab\nrobots: {r: {plugins: {sim: {model: roomba, start: {x_m: 150, y_m: 0}}}}}\n",
    )
    result = eal("call", "r", "Pose", "get_value", "--fleet", fleet)
    assert "plugin 'sim': robot 'r' cannot start at x 150 m, y 0 m" in result.stderr
    assert last_lines(result) == ["Correct its settings in the fleet file."]


def test_what_to_do_about_missing_modules(eal: Any, slides: Path) -> None:
    manifest = slides.parent / "plugins" / "slide" / "plugin.yaml"
    manifest.write_text(manifest.read_text(encoding="utf-8") + "requires: [no_such_module]\n", encoding="utf-8")
    result = eal("call", "one", "Slide", "get_value", "--fleet", slides)
    assert "needs no_such_module: pip install no_such_module\n" in result.stderr
    assert last_lines(result) == ["Install what is missing, then try again."]


@pytest.mark.parametrize(
    "message",
    [
        "tcp/127.0.0.1:50001: cannot listen there: the port is in use by another program",
        "metrics cannot be served at port 9000: Address already in use",
    ],
)
def test_what_to_do_about_a_port_that_is_taken(capsys: pytest.CaptureFixture[str], message: str) -> None:
    report_error(errors.UnavailableError(message), GlobalOptions())
    assert capsys.readouterr().err.splitlines()[-2].startswith("`ss -ltnp` shows the program")


LATE = ["call", "one", "Slide", "send_cmd", "to1", "--timeout-s", "0.05", "--fleet"]


def test_more_time_is_advised_where_it_may_help(eal: Any, slides: Path) -> None:
    advice = "If it needs more time, raise --timeout-s, or timeout_s in the file."
    assert last_lines(eal(*LATE, slides)) == [advice]


def test_more_time_is_not_advised_where_the_actor_is_blocked(eal: Any, slides: Path) -> None:
    plugin = slides.parent / "plugins" / "slide" / "plugin.py"
    text = plugin.read_text(encoding="utf-8").replace("yield _STEP_S  #", "threading.Event().wait(0.01)  #")
    text = text.replace("1\n        finally:", "1\n            yield\n        finally:")
    plugin.write_text(text.replace("\nfrom eal", "\nimport threading\n\nfrom eal", 1), encoding="utf-8")
    advice = "A command blocks its actor: `eal plugin check FOLDER` names the command."
    assert last_lines(eal(*LATE, slides)) == [advice]


@pytest.mark.parametrize("kind", [errors.UnavailableError, errors.RobotFailedError])
def test_what_was_stuck_is_no_matter_of_a_cable(capsys: pytest.CaptureFixture[str], kind: type[EALError]) -> None:
    report_error(kind("was stuck for 1.0 s beyond its deadline; it has been abandoned"), GlobalOptions())
    assert "eal plugin check" in capsys.readouterr().err
    report_error(kind("is restarting: it crashed with OSError: no such port"), GlobalOptions())
    assert SEE_DEVICE in capsys.readouterr().err
