from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.scenario import Scenario, check_scenario, load_scenario, scenario_schema
from eal_actors.scenario.language.values import RetryPolicy
from eal_actors.scenario.steps.calls import GetValue, SendCmd
from eal_actors.scenario.steps.for_ import ForStep
from eal_actors.scenario.steps.on import OnStep
from eal_actors.scenario.steps.repeat import RepeatStep

SHIPPED = sorted(bundled_path("scenarios").glob("*.yaml"))
HEAD = "version: 1\nname: x\ndescription: d\nroles: {r: {}}\n"


def load(folder: Path, body: str, head: str = HEAD) -> Scenario:
    (folder / "s.yaml").write_text(head + body)
    return load_scenario(folder / "s.yaml")


def problems(folder: Path, body: str, head: str = HEAD) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load(folder, body, head)
    return [str(problem).removeprefix(f"{folder}/") for problem in caught.value.problems]


def in_role(*steps: str) -> str:
    return "steps:\n- on: r\n  do:\n" + "".join(f"  - {step}\n" for step in steps)


def test_a_scenario_keeps_values_as_they_are_written(tmp_path: Path) -> None:
    file = load(
        tmp_path,
        "timeout_s: 5\non_failure: {retry: 2, back_off_s: 0.5, then: drop}\nsteps:\n"
        "- for: {x: [r45, 1, 1.0, true, [1, 2]]}\n  do:\n  - on: r\n    do:\n"
        '    - send_cmd: {resource: Base, cmd: "${x}", data: 3}\n      on_failure: drop\n'
        "- repeat: 2\n  do:\n  - on: r\n    do: [{get_value: {resource: Eye}, save_as: eye, timeout_s: 1}]\n",
    ).file
    loop, repeat = file.steps

    assert file.on_failure == RetryPolicy(retry=2, back_off_s=0.5, then="drop")
    assert isinstance(loop, ForStep)
    assert [(type(value), value) for value in loop.values] == [
        (str, "r45"),
        (int, 1),
        (float, 1.0),
        (bool, True),
        (tuple, (1, 2)),
    ]
    assert isinstance(loop.do[0], OnStep)
    command = loop.do[0].do[0]
    assert isinstance(command, SendCmd)
    assert (command.send_cmd.cmd, command.send_cmd.data, command.on_failure) == ("${x}", 3, "drop")
    assert isinstance(repeat, RepeatStep)
    assert repeat.repeat == 2
    assert isinstance(repeat.do[0], OnStep)
    answer = repeat.do[0].do[0]
    assert isinstance(answer, GetValue)
    assert (answer.save_as, answer.save, answer.timeout_s) == ("eye", None, 1.0)


def test_the_environment_has_no_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("x", "s")

    body = in_role("for: {x: [g]}\n    do: [{send_cmd: {resource: Base, cmd: '${x}'}}]")
    scenario = load(tmp_path, body)

    assert "cmd='${x}'" in repr(scenario.file.steps)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("steps: []", "5:8: steps: is empty; it needs at least one item"),
        ("", "1:1: steps: is missing"),
        ("steps: [5]", "5:9: steps[0]: must be a mapping, not 5"),
        ("steps: [{wait: 5}]", "5:9: steps[0]: unknown step 'wait'; did you mean 'wait_s'?"),
        (
            "steps: [{on: r, do: [{send_cdm: {}}]}]",
            "5:22: steps[0].do[0]: unknown step 'send_cdm'; did you mean 'send_cmd'?",
        ),
        (
            "steps: [{log: x, wait_s: 1}]",
            "5:9: steps[0]: is 'log' and 'wait_s' at once; begin each step with its own '-'",
        ),
        ("steps: [{wait_s: -1}]", "5:18: steps[0].wait_s: must be at least 0, not -1"),
        (
            "steps: [{wait_s: '${1}${2}'}]",
            "5:18: steps[0].wait_s: must be a number, or ${...} and nothing around it, not '${1}${2}'",
        ),
        (
            "steps: [{log: x, at: 1}]",
            "5:18: steps[0].at: unknown key 'at'; known: log, lost_after_s, on_failure, safe_to_repeat",
        ),
        ("steps: [{repeat: 0, do: [{log: x}]}]", "5:18: steps[0].repeat: must be at least 1, not 0"),
        ("steps: [{repeat: 2, do: []}]", "5:25: steps[0].do: is empty; it needs at least one item"),
        ("steps: [{repeat: 2}]", "5:9: steps[0].do: is missing"),
        (
            "steps: [{for: {a: [1], b: [2]}, do: [{log: x}]}]",
            "5:15: steps[0].for: must name one variable, not 2; write a loop inside a loop for more",
        ),
        (
            "steps: [{for: {a: r45}, do: [{log: x}]}]",
            "5:19: steps[0].for.a: must be a list, not 'r45'",
        ),
        (
            "steps: [{for: {a: [{}]}, do: [{log: x}]}]",
            "5:20: steps[0].for.a[0]: must be text, a number, true, false or a list of them, not a mapping",
        ),
        (
            "steps: [{for: {a: ['${b}']}, do: [{log: x}]}]",
            "5:23: steps[0].for.a[0]: unknown variable 'b'; no variable is known here",
        ),
        (
            "steps: [{for: {a: [1]}, do: [{for: {a: [1]}, do: [{log: x}]}]}]",
            "5:37: steps[0].do[0].for.a: 'a' is the variable of a loop around this one already",
        ),
        ("steps: [{on: rr, do: [{log: x}]}]", "5:14: steps[0].on: unknown role 'rr'; did you mean 'r'?"),
        (
            "steps: [{on: r, do: [{on: r, do: [{log: x}]}]}]",
            "5:23: steps[0].do[0].on: is inside 'on: r'; a robot performs one 'on' at a time",
        ),
        (
            "steps: [{halt: {resource: Base}}]",
            "5:10: steps[0].halt: which robot? 'halt' must be in the 'do' of an 'on'",
        ),
        (
            in_role("send_cmd: {resource: Base}"),
            "8:15: steps[0].do[0].send_cmd.cmd: is missing",
        ),
        (
            in_role("send_cmd: {resource: Base, cmd: 45}"),
            "8:37: steps[0].do[0].send_cmd.cmd: must be text, not 45; put it in quotes if it is meant as text",
        ),
        (
            in_role("get_value: {resource: Eye}\n    save_az: x"),
            "9:5: steps[0].do[0].save_az: unknown key 'save_az'; did you mean 'save_as'?",
        ),
        (
            in_role("set_value: {resource: Base, value: 1}\n    save_as: x"),
            (
                "9:5: steps[0].do[0].save_as: unknown key 'save_as'; known: lost_after_s, on_failure, "
                "safe_to_repeat, set_value, timeout_s, together"
            ),
        ),
        (
            in_role("get_value: {resource: Eye}\n    on_failure: stop"),
            "9:17: steps[0].do[0].on_failure: must be 'abort', 'drop', 'skip' or 'substitute', not 'stop'",
        ),
        (
            in_role("get_value: {resource: Eye}\n    on_failure: {retry: 0}"),
            "9:25: steps[0].do[0].on_failure.retry: must be over 0, not 0",
        ),
        ("roles: {}\nsteps: [{log: x}]", "5:1: roles: duplicate key; first defined in line 4"),
        (
            in_role("log: '${nme}'"),
            "8:13: steps[0].do[0].log: unknown variable 'nme'; known: count, index, robot, role",
        ),
        (
            in_role("for: {name: [1]}\n    do: [{log: '${nme}'}]"),
            "9:19: steps[0].do[0].do[0].log: unknown variable 'nme'; did you mean 'name'?",
        ),
        (
            in_role("log: '${'"),
            "8:11: steps[0].do[0].log: ${ must be closed, as in ${expression}; write $${ for a literal ${",
        ),
        (
            in_role("for: {a: [1]}\n    do: [{get_value: {resource: Eye}, save_as: a}]"),
            "9:48: steps[0].do[0].do[0].save_as: 'a' is the variable of a loop around this step",
        ),
        (
            in_role("get_value: {resource: Eye}\n    save_as: a", "halt: {resource: '${a}'}"),
            (
                "10:25: steps[0].do[1].halt.resource: "
                "the resource must be known before the run, and 'a' is assigned during it"
            ),
        ),
        (
            in_role("get_value: {resource: Eye}\n    save_as: a") + "finally: [{on: r, do: [{log: '${a}'}]}]",
            "10:33: finally[0].do[0].log: unknown variable 'a'; known: count, index, robot, role",
        ),
        (
            in_role("get_value: {resource: Eye}\n    save: a.jpg"),
            "9:11: steps[0].do[0].save: saves as .csv, .json, .npy, .png or .txt, not .jpg; did you mean '.png'?",
        ),
        (
            in_role("repeat: 2\n    do: [{get_value: {resource: Eye}, save: a.png}]"),
            (
                "9:45: steps[0].do[0].do[0].save: each pass of the loop around it overwrites the file: "
                "its name lacks ${i}"
            ),
        ),
        (
            in_role("for: {n: [1, 2]}\n    do: [{repeat: 2, do: [{get_value: {resource: Eye}, save: 'a.${i}.png'}]}]"),
            (
                "9:62: steps[0].do[0].do[0].do[0].save: each pass of the loop around it overwrites the file: "
                "its name lacks ${n}"
            ),
        ),
        (
            "steps: [{for: {n: [1, 2]}, do: [{on: r, do: [{get_value: {resource: Eye}, save: a.png}]}]}]",
            (
                "5:81: steps[0].do[0].do[0].save: each pass of the loop around it overwrites the file: "
                "its name lacks ${n}"
            ),
        ),
        (
            in_role("repeat: 2\n    do: [{repeat: 2, do: [{get_value: {resource: Eye}, save: 'a.${i}.png'}]}]"),
            (
                "9:62: steps[0].do[0].do[0].do[0].save: each pass of the outer 'repeat' overwrites the files of the "
                "one before: ${i} is that of the inner 'repeat' here; write one of them as a 'for'"
            ),
        ),
        (
            in_role("log: x") + "finally: [{on: r, do: [{halt: {resource: B}, on_failure: drop}]}]",
            (
                "9:46: finally[0].do[0].on_failure: has no effect in 'finally': "
                "a failure there is recorded, and the next step runs"
            ),
        ),
    ],
)
def test_a_problem_in_plain_words(tmp_path: Path, body: str, expected: str) -> None:
    assert problems(tmp_path, body) == [f"s.yaml:{expected}"]


def test_all_problems_come_at_once(tmp_path: Path) -> None:
    assert problems(tmp_path, in_role("log: '${a}'", "on: r\n    do: [{log: '${b}'}]")) == [
        "s.yaml:8:13: steps[0].do[0].log: unknown variable 'a'; known: count, index, robot, role",
        "s.yaml:9:5: steps[0].do[1].on: is inside 'on: r'; a robot performs one 'on' at a time",
        "s.yaml:10:19: steps[0].do[1].do[0].log: unknown variable 'b'; known: count, index, robot, role",
    ]


def test_variables_are_known_where_they_should_be(tmp_path: Path) -> None:
    load(
        tmp_path,
        in_role(
            "get_value: {resource: Eye}\n    save_as: seen",
            "repeat: 2\n    do: [{repeat: 2, do: [{log: '${i} ${seen} $${literal}'}]}]",
        )
        + "- on: r\n  do: [{set_value: {resource: Base, value: ['${seen}', 2]}}]\n",
    )


@pytest.mark.parametrize(
    "step",
    [
        "for: {n: [1, 2]}\n    do: [{repeat: 2, do: [{get_value: {resource: Eye}, save: '${n}/${i}.png'}]}]",
        "for: {n: [1]}\n    do: [{get_value: {resource: Eye}, save: a.png}]",
        "repeat: 1\n    do: [{repeat: 2, do: [{get_value: {resource: Eye}, save: '${i}.png'}]}]",
        (
            "repeat: 2\n    do: [{get_value: {resource: Eye}, save_as: seen}, "
            "{get_value: {resource: Eye}, save: '${seen}.png'}]"
        ),
    ],
)
def test_files_that_need_not_be_overwritten(tmp_path: Path, step: str) -> None:
    load(tmp_path, in_role(step))


def test_what_another_role_saved_is_not_known(tmp_path: Path) -> None:
    head = HEAD.replace("{r: {}}", "{r: {}, q: {}}")
    body = in_role("get_value: {resource: Eye}\n    save_as: seen") + "- on: q\n  do: [{log: '${seen}'}]\n"

    assert problems(tmp_path, body, head) == [
        "s.yaml:11:17: steps[1].do[0].log: unknown variable 'seen'; known: count, index, robot, role"
    ]


def test_check_scenario_returns_what_load_raises(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(HEAD + "steps: [{wait_s: x}]")

    assert [problem.line for problem in check_scenario(tmp_path / "s.yaml")] == [5]
    assert [problem.message for problem in check_scenario(tmp_path / "t.yaml")] == ["no such file"]


@functools.cache
def scenario_validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(scenario_schema())


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_scenarios_are_right_by_model_and_schema(path: Path) -> None:
    assert check_scenario(path) == ()
    scenario_validator().validate(load_yaml(path).root)


SOUND: dict[str, Any] = {
    "version": 1,
    "name": "x",
    "description": "d",
    "roles": {"r": {}},
    "steps": [{"on": "r", "do": [{"send_cmd": {"resource": "Base", "cmd": "g"}, "on_failure": {"retry": 1}}]}],
}


@pytest.mark.parametrize(
    "broken",
    [
        {"version": 2},
        {"name": ""},
        {"roles": {"1": {}}},
        {"roles": {"r": {"min": -1}}},
        {"roles": {"r": {"tags": []}}},
        {"steps": []},
        {"steps": [{"wait": 1}]},
        {"steps": [{"log": "x", "wait_s": 1}]},
        {"steps": [{"for": {}, "do": [{"log": "x"}]}]},
        {"steps": [{"for": {"a": [1], "b": [1]}, "do": [{"log": "x"}]}]},
        {"steps": [{"for": {"a": []}, "do": [{"log": "x"}]}]},
        {"steps": [{"repeat": 1, "do": []}]},
        {"steps": [{"on": "r", "do": [{"send_cmd": {"resource": "Base"}}]}]},
        {"steps": [{"on": "r", "do": [{"set_value": {"resource": "Base", "value": {}}}]}]},
        {"on_failure": "stop"},
        {"on_failure": {"retry": 0}},
        {"finaly": []},
    ],
)
def test_the_schema_refuses_what_the_model_refuses(broken: dict[str, Any]) -> None:
    validator = scenario_validator()

    assert validator.is_valid(SOUND)
    assert not validator.is_valid({**SOUND, **broken})


def test_a_written_count_has_the_limit_of_a_computed_one(tmp_path: Path) -> None:
    body = "steps:\n- signal: x\n- {wait_for: x, count: 1000001, timeout_s: 1}\n"

    assert problems(tmp_path, body) == ["s.yaml:7:24: steps[1].count: must be at most 1000000, not 1000001"]


def test_an_expectation_whose_value_is_missing_is_refused(tmp_path: Path) -> None:
    message = "steps[0].equals: is empty; leave it out to expect that the expression is true"

    assert problems(tmp_path, "steps:\n- {expect: 1 + 1, equals: }\n") == [f"s.yaml:6:26: {message}"]
