"""Scenarios inside scenarios."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import LogLine, Run, load_scenario, make_plan
from tests.scenarios.rig import HEAD, ask, rigs, scenario
from tests.scenarios.running import Watch, brief, outcomes, run

PART = """\
version: 1
name: part
parameters:
  seconds: {type: double, minimum: 0, maximum: 5, default: 1}
  word: {type: string}
roles:
  movers: {}
steps:
  - let: {x: 5}
  - on: movers
    do:
      - send_cmd: {resource: Base, cmd: "go${seconds}"}
      - log: "${word} ${role} ${x}"
      - barrier: same
        timeout_s: 100
finally:
  - on: movers
    do: [{send_cmd: {resource: Base, cmd: s}}]
"""
ROLES = HEAD.replace("all: {}", "all: {}\n  quick: {tags: [quick]}\n  heavy: {tags: [heavy]}")


@pytest.fixture
def part(tmp_path: Path) -> Path:
    (tmp_path / "part.yaml").write_text(PART)
    return tmp_path / "part.yaml"


def problems(folder: Path, body: str, head: str = ROLES) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        scenario(folder, body, head)
    return [str(problem).replace(f"{folder}/", "") for problem in caught.value.problems]


@pytest.mark.usefixtures("part")
def test_a_part_has_its_own_variables_roles_and_end(two: Fleet, tmp_path: Path) -> None:
    watch = Watch()
    body = """
        steps:
          - let: {y: 3}
          - for: {n: [1, 2]}
            do:
              - scenario: part.yaml
                with: {seconds: "${n}", word: "pass ${n}"}
                roles: {movers: quick}
          - scenario: part.yaml
            with: {word: "${str(y)}"}
            roles: {movers: heavy}
        """
    report = run(two, tmp_path, body, ROLES, listeners=[watch])

    lines = [(event.robot, event.text) for event in watch.events if isinstance(event, LogLine)]
    assert report.outcome == "done", report.error
    assert lines == [("fast", "pass 1 movers 5"), ("fast", "pass 2 movers 5"), ("slow", "3 movers 5")]
    assert [line[0] for line in brief(report, "fast")] == [
        *("send_cmd Base go1", "barrier same", "send_cmd Base s"),
        *("send_cmd Base go2", "barrier same", "send_cmd Base s"),
    ]
    assert report.steps[0].step == "steps[1].do[0].part.steps[1].do[0]"


@pytest.mark.usefixtures("part")
def test_parts_in_branches_do_not_meet_each_other(tmp_path: Path) -> None:
    step = "scenario: part.yaml, with: {word: x}"
    body = f"steps: [{{parallel: [[{{{step}, roles: {{movers: quick}}}}], [{{{step}, roles: {{movers: heavy}}}}]]}}]"
    fast, slow = {"slowness": 0.1, "tags": ["quick"]}, {"tags": ["heavy"]}
    with rigs(tmp_path, clock=LockStepClock(), fast=fast, slow=slow) as fleet:
        report = run(fleet, tmp_path, body, ROLES)

    assert report.outcome == "done"
    ends_s = {record.robot: record.end_s for record in report.steps if record.kind == "barrier"}
    assert ends_s["fast"] < ends_s["slow"] - 0.5


@pytest.mark.usefixtures("part")
def test_the_end_of_a_part_is_carried_out_after_an_abort(two: Fleet, tmp_path: Path) -> None:
    text = PART.replace("      - barrier: same\n        timeout_s: 100\n", "      - expect: 1 == 2\n")
    (tmp_path / "part.yaml").write_text(text)
    report = run(two, tmp_path, "steps: [{scenario: part.yaml, with: {word: x}, roles: {movers: all}}]", ROLES)

    assert report.outcome == "failed"
    assert [ask(two, robot, "stops") for robot in two] == [1, 1]


@pytest.mark.usefixtures("part")
def test_what_is_wrong_with_the_use_of_a_part(tmp_path: Path) -> None:
    body = "steps: [{scenario: part.yaml, with: {seconds: 9, wrd: x}, roles: {moovers: all, movers: al}}]"

    assert problems(tmp_path, body) == [
        "trial.yaml:8:20: steps[0].scenario: parameter 'word' of scenario 'part' has no default: give it under 'with'",
        "trial.yaml:8:47: steps[0].with.seconds: must be double 0..5, not 9",
        "trial.yaml:8:50: steps[0].with.wrd: unknown parameter 'wrd' of scenario 'part'; did you mean 'word'?",
        "trial.yaml:8:67: steps[0].roles.moovers: unknown role 'moovers' of scenario 'part'; did you mean 'movers'?",
        "trial.yaml:8:89: steps[0].roles.movers: unknown role 'al'; did you mean 'all'?",
    ]


def test_problems_inside_a_part_are_told_with_its_own_places(two: Fleet, tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(PART.replace("Base, cmd: s", "Bse, cmd: s"))
    body = "steps: [{scenario: part.yaml, with: {word: x, seconds: 4}, roles: {movers: all}}]"

    with pytest.raises(ConfigError) as caught:
        make_plan(scenario(tmp_path, body, ROLES), two)
    assert str(caught.value).endswith(
        "part.yaml:18:32: finally[0].do[0].send_cmd.resource: fast, slow: unknown resource 'Bse'; did you mean 'Base'?"
    )


def test_circles_and_missing_files_are_refused(tmp_path: Path) -> None:
    step = "steps: [{scenario: trial.yaml}]"
    assert problems(tmp_path, step) == [
        "trial.yaml:8:20: steps[0].scenario: trial.yaml: includes itself: trial.yaml -> trial.yaml"
    ]
    assert problems(tmp_path, "steps: [{scenario: none.yaml}]") == [
        "trial.yaml:8:20: steps[0].scenario: none.yaml: no such file"
    ]


def test_scenarios_stand_inside_each_other_only_so_deep(tmp_path: Path) -> None:
    for number in range(12):
        step = f"{{scenario: s{number + 1}.yaml}}" if number < 11 else "{log: x}"
        text = f"version: 1\nname: s{number}\nroles: {{all: {{}}}}\nsteps: [{step}]\n"
        (tmp_path / f"s{number}.yaml").write_text(text)

    load_scenario(tmp_path / "s5.yaml")
    with pytest.raises(ConfigError, match="is the 9th scenario inside another"):
        load_scenario(tmp_path / "s0.yaml")


@pytest.mark.usefixtures("part")
def test_one_robot_in_two_branches_is_refused(two: Fleet, tmp_path: Path) -> None:
    step = "scenario: part.yaml, with: {word: x}"
    branches = f"left: [{{{step}, roles: {{movers: all}}}}], right: [{{on: quick, do: [{{log: x}}]}}]"
    body = f"steps: [{{parallel: {{{branches}}}}}]"

    with pytest.raises(ConfigError) as caught:
        make_plan(scenario(tmp_path, body, ROLES), two)
    assert "fast has role 'quick' here and role 'all' in branch 'left' at the same time" in str(caught.value)


SCOUT = """\
version: 1
name: scout
parameters: {seconds: {type: double, default: 1}}
roles: {me: {}, again: {}}
steps:
  - let: {x: 5}
  - on: me
    do:
      - send_cmd: {resource: Base, cmd: "go${seconds}"}
      - let: {mine: "x + seconds"}
      - log: "${robot} ${role} ${index} of ${count}: ${mine}"
  - on: again
    do: [{signal: seen, value: "${robot}"}]
finally:
  - on: me
    do: [{send_cmd: {resource: Base, cmd: s}}]
"""


def test_each_robot_of_an_on_carries_a_part_out_by_itself(two: Fleet, tmp_path: Path) -> None:
    (tmp_path / "scout.yaml").write_text(SCOUT)
    watch = Watch()
    body = """
        steps:
          - on: all
            do:
              - let: {mine: "'of the outer one'"}
              - scenario: scout.yaml
                with: {seconds: "${index + 1}"}
                signals: {seen: found}
              - log: "${robot}: ${mine}"
          - wait_for: found
            count: 2
            timeout_s: 5
            save_as: last
          - log: "the last was ${last}"
        """
    report = run(two, tmp_path, body, listeners=[watch])

    assert report.outcome == "done", report.error
    assert sorted(event.text for event in watch.events if isinstance(event, LogLine)) == [
        "fast me 0 of 1: 6",
        "fast: of the outer one",
        "slow me 0 of 1: 7",
        "slow: of the outer one",
        "the last was slow",
    ]
    assert [line[0] for line in brief(report, "slow")] == ["send_cmd Base go2", "send_cmd Base s"]
    first = next(record for record in report.steps if record.robot == "slow")
    assert first.step == "steps[0].do[1].scout.steps[1].do[0]"
    assert make_plan(load_scenario(tmp_path / "trial.yaml"), two).calls == 4


def test_a_robot_that_fails_in_its_part_leaves_the_others_in_theirs(tmp_path: Path) -> None:
    text = SCOUT.replace('"go${seconds}"', "flaky").replace("name: scout", "name: scout\non_failure: drop")
    (tmp_path / "scout.yaml").write_text(text)
    body = "steps: [{on: all, do: [{scenario: scout.yaml}, {send_cmd: {resource: Base, cmd: now}}]}]"
    with rigs(tmp_path, good={}, bad={"failures": 9}) as fleet:
        report = run(fleet, tmp_path, body)

    assert report.outcome == "done"
    assert {name: robot.outcome for name, robot in report.robots.items()} == {"good": "done", "bad": "dropped"}
    assert brief(report, "good")[-1] == ("send_cmd Base now", "done", 1)
    assert ("send_cmd Base s", "done", 1) in brief(report, "bad"), "the end of its part is for it too"


def test_what_a_part_inside_an_on_may_not_say(tmp_path: Path) -> None:
    (tmp_path / "scout.yaml").write_text(SCOUT.replace("again: {}", "again: {min: 2}"))
    body = """
        steps:
          - on: all
            do:
              - scenario: scout.yaml
                roles: {me: quick}
                signals: {sene: found}
        """
    found = problems(tmp_path, body)
    needs, roles, signal = found
    assert roles.endswith(
        "do[0].roles: has no meaning inside 'on: all': each robot takes all roles of the scenario by itself"
    )
    assert "do[0].scenario: inside 'on: all' each robot runs it by itself, but role 'again' of " in needs
    assert needs.endswith("scenario 'scout' needs at least 2")
    assert "signals.sene: scenario 'scout' does not give the signal 'sene'; did you mean 'seen'?" in signal
    assert [problem.split(":")[1] for problem in found] == ["12", "13", "14"]


def test_a_failure_in_the_end_of_a_part_stops_nothing(two: Fleet, tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(
        f"{HEAD}steps:\n- log: x\nfinally:\n- on: all\n  do: [{{send_cmd: {{resource: Base, cmd: fail}}}}]\n"
    )
    body = "steps:\n- scenario: part.yaml\n- on: all\n  do: [{send_cmd: {resource: Base, cmd: now}}]\n"
    report = run(two, tmp_path, body)

    assert [line[:2] for line in brief(report, "fast")] == [
        ("send_cmd Base fail", "failed"),
        ("send_cmd Base now", "done"),
    ]
    assert (report.outcome, outcomes(report)) == ("failed", {"fast": "failed", "slow": "failed"})


END = "finally:\n- on: all\n  do: [{send_cmd: {resource: Base, cmd: go9}}, {send_cmd: {resource: Base, cmd: s}}]\n"


def test_an_abort_during_the_end_of_a_part_lets_it_be_carried_out(two: Fleet, tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(f"{HEAD}steps:\n- log: x\n{END}")
    plan = make_plan(scenario(tmp_path, "steps:\n- scenario: part.yaml\n- wait_s: 1000\n"), two)
    aborted = Run(plan, two, listeners=[Watch("send_cmd Base go9", lambda: aborted.abort("enough"))])
    report = aborted.start().get()

    assert report.outcome == "aborted"
    assert [ask(two, robot, "stops") for robot in two] == [1, 1]


def test_a_part_that_is_stopped_ends_then_and_not_with_the_run(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(f"{HEAD}steps:\n- wait_s: 50\n{END.replace('go9', 'now')}")
    body = """steps:
- repeat: 3
  do:
  - on: all
    do:
    - parallel: [[{scenario: part.yaml}], [{wait_s: 1}]]
      until: first
- wait_s: 10
"""
    with rigs(tmp_path, clock=LockStepClock(), a={}) as fleet:
        report = run(fleet, tmp_path, body)

    assert report.outcome == "done"
    ends_s = [record.end_s for record in report.steps if record.label == "send_cmd Base s"]
    assert ends_s == [pytest.approx(1), pytest.approx(2), pytest.approx(3)]
