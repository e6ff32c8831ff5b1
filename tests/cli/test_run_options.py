"""Options of `eal run`: parameters, robots, dry runs, events and resumed runs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.plugin_files import write_plugin

Write = Callable[[str, str], Path]

SCENARIO = """\
version: 1
name: move
description: Move a little.
parameters:
  to: {type: double, minimum: 0, maximum: 0.05, default: 0.02}
  rounds: {type: int, default: 2}
roles: {movers: {}}
safe_to_repeat: true
steps:
  - on: movers
    do:
      - repeat: "${rounds}"
        do:
          - send_cmd: {resource: Slide, cmd: "to${to}"}
            together: true
      - if: index == 0
        then: [{get_value: {resource: Slide}, save_as: seen}, {log: "${seen}"}]
"""


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    path = tmp_path / "trial.yaml"
    path.write_text(SCENARIO)
    return path


def test_a_look_ahead_shows_who_does_what_and_moves_nothing(
    eal: Any, slides: Path, trial: Path, tmp_path: Path
) -> None:
    result = eal("run", trial, "-f", slides, "--dry-run", "--set", "rounds=3", "--runs-dir", tmp_path / "runs")

    assert result.exit_code == 0, result.output
    assert [line.rstrip() for line in result.stdout.splitlines()] == [
        "move on slides: Move a little.",
        "  to = 0.02  (double 0..0.05)",
        "  rounds = 3  (int)",
        "  role movers: one, two",
        "",
        "steps",
        "└── on movers: one, two",
        "    ├── repeat 3 times  (6 calls)",
        "    │   └── send_cmd Slide to0.02, together",
        "    └── if index == 0",
        "        └── then  (2 calls)",
        "            ├── get_value Slide -> seen",
        "            └── log ${seen}  needs seen",
        "",
        (
            "at least 6 calls by 2 robots. All values that are known before the run were checked against these robots. "
            "Nothing has moved."
        ),
    ]
    assert not (tmp_path / "runs").exists()


def test_a_look_ahead_for_programs(eal: Any, slides: Path, trial: Path) -> None:
    plan = json.loads(eal("run", trial, "-f", slides, "--dry-run", "--json", "--bind", "movers=two").stdout)

    assert (plan["roles"], plan["parameters"]) == ({"movers": ["two"]}, {"to": 0.02, "rounds": 2})
    (on,) = plan["steps"]
    assert (on["step"], on["kind"], on["robots"], on["calls"]) == ("steps[0]", "on", ["two"], None)
    repeat, condition = on["inner"]
    assert (repeat["calls"], repeat["inner"][0]["text"]) == (2, "send_cmd Slide to0.02, together")
    assert condition["inner"][0]["inner"][1]["unknown"] == ["seen"]


def test_parameters_and_robots_of_the_command_line(eal: Any, slides: Path, trial: Path, tmp_path: Path) -> None:
    words = ("--set", "to=0.01", "--set", "rounds=1", "--bind", "movers=two", "--rate", "10", "--json")
    report = json.loads(eal("run", trial, "-f", slides, "--runs-dir", tmp_path / "runs", *words).stdout)

    assert report["parameters"] == {"to": 0.01, "rounds": 1}
    assert list(report["robots"]) == ["two"]
    assert report["steps"][0]["command"] == "to0.01"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "to=3"], "trial.yaml:5:3: parameters.to: must be double 0..0.05, not 3.0 as it was given"),
        (["--set", "rounds=two"], "parameters.rounds: must be int, not 'two' as it was given"),
        (["--set", "too=1"], "unknown parameter 'too'; did you mean 'to'?"),
        (["--set", "to"], "must be NAME=VALUE, not 'to'"),
        (["--bind", "movers=three"], "as it was bound: the fleet 'slides' has no robot 'three'"),
        (["--bind", "mover=one"], "unknown role 'mover'; did you mean 'movers'?"),
        (["--bind", "movers"], "must be ROLE=ROBOT,ROBOT, not 'movers'"),
        (["--events", "-", "--json"], "not both"),
        (["--events", "/nowhere/x"], "/nowhere/x cannot be written: No such file or directory"),
        (["--resume", "none"], "none has no record of a run: No such file or directory"),
        (["--resume", "none", "--set", "to=1"], "not with --resume: the run keeps its values"),
    ],
)
def test_what_the_command_line_may_not_say(
    eal: Any, slides: Path, trial: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    result = eal("run", trial, "-f", slides, "--runs-dir", tmp_path / "runs", *words)

    assert result.exit_code == 2
    assert message in " ".join(result.output.replace("│", " ").split()), result.output
    assert not (tmp_path / "runs").exists()


def test_events_while_it_runs(eal: Any, slides: Path, trial: Path, tmp_path: Path) -> None:
    words = ("--rate", "10", "--runs-dir", tmp_path / "runs")
    on_stdout = eal("run", trial, "-f", slides, "--events", "-", *words)
    eal("run", trial, "-f", slides, "--events", tmp_path / "events.jsonl", *words)

    first = [json.loads(line)["event"] for line in on_stdout.stdout.splitlines()]
    second = [json.loads(line)["event"] for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert sorted(first) == sorted(second)
    assert (first[0], first[-1]) == ("run_started", "run_ended")
    assert "move on slides: done" in on_stdout.stderr


CHATTY = """\
from eal_actors.plugin import EALPlugin, Resource, ResourceType, command
print("imported")
class Chatty(Resource):
    types = ResourceType.ACTUATOR
    @command("talk")
    def talk(self):
        'Print a word.'
        print("talks")
        return 1
"""


def test_what_a_plugin_prints_is_no_event(eal: Any, tmp_path: Path, write: Any) -> None:
    write_plugin(tmp_path, "chatty", CHATTY, "Chatty")
    fleet = write("fleet.yaml", "version: 1\nplugin_dirs: [plugins]\nrobots: {one: {plugins: {chatty: {}}}}\n")
    steps = "steps: [{on: ones, do: [{send_cmd: {resource: Chatty, cmd: talk}}]}]\n"
    scenario = write("talk.yaml", "version: 1\nname: talk\nroles: {ones: {robots: [one]}}\n" + steps)
    result = eal("run", scenario, "-f", fleet, "--events", "-", "--runs-dir", tmp_path / "runs")
    assert [json.loads(line)["event"] for line in result.stdout.splitlines()][-1] == "run_ended", result.output
    assert {"imported", "talks"} <= set(result.stderr.splitlines())


def test_a_run_goes_on(eal: Any, slides: Path, trial: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    eal("run", trial, "-f", slides, "--rate", "10", "--runs-dir", runs, "--set", "rounds=1")
    (directory,) = runs.iterdir()
    again = eal("run", "--resume", directory)
    assert again.exit_code == 2
    assert "has ended" in " ".join(again.stderr.replace("│", "").split())

    (directory / "summary.json").unlink()
    lines = (directory / "events.jsonl").read_text().splitlines()
    kept = [line for line in lines if json.loads(line)["event"] in ("run_started", "checkpoint")][:2]
    (directory / "events.jsonl").write_text("\n".join([*kept, lines[2], '{"eve']))
    again = eal("run", "--resume", directory, "--json")

    assert again.exit_code == 0, again.output
    report = json.loads(again.stdout)
    assert (report["outcome"], report["parameters"]["rounds"], report["rate"]) == ("done", 1, 10.0)
    assert json.loads((directory / "summary.json").read_text()) == report
    assert len(list(runs.iterdir())) == 1


def test_without_a_scenario_or_a_fleet(eal: Any, slides: Path, trial: Path) -> None:
    assert "SCENARIO" in eal("run", "-f", slides).output
    assert "--fleet" in eal("run", trial).output
