from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from eal_actors.scenario import load_scenario
from eal_actors.scenario.language.parameters import missing_parameters, read_settings, with_parameters

HEAD = "version: 1\nname: x\nroles: {r: {}}\nsteps: [{log: x}]\n"
DECLARED = """\
parameters:
  speed_m_s: {type: double, unit: m/s, minimum: 0.05, maximum: 0.5, default: 0.3}
  legs: {type: int, minimum: 1}
  side: {type: string, choices: [left, right], default: left}
  angles: {type: list, default: [45, 90]}
  loud: {type: bool, default: false}
"""


def load(folder: Path, declared: str = DECLARED, **given: object) -> dict[str, object]:
    (folder / "s.yaml").write_text(HEAD + declared)
    return dict(load_scenario(folder / "s.yaml", given).parameters)


def problems(folder: Path, declared: str = DECLARED, **given: object) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load(folder, declared, **given)
    return [str(problem).removeprefix(f"{folder}/") for problem in caught.value.problems]


def test_defaults_and_what_is_given(tmp_path: Path) -> None:
    defaults = {"speed_m_s": 0.3, "side": "left", "angles": (45, 90), "loud": False}
    assert load(tmp_path) == defaults
    assert load(tmp_path, legs=3, angles=[1], speed_m_s=0.5) == {
        **defaults,
        "legs": 3,
        "angles": (1,),
        "speed_m_s": 0.5,
    }
    scenario = load_scenario(tmp_path / "s.yaml", {"legs": 3})
    assert with_parameters(scenario, {"side": "right"}).parameters["legs"] == 3
    assert missing_parameters(scenario, {"legs": 1})[0].path == "parameters.speed_m_s"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"speed_m_s": 1}, "6:3: parameters.speed_m_s: must be double 0.05..0.5 m/s, not 1 as it was given"),
        ({"legs": 1.5}, "7:3: parameters.legs: must be int 1.., not 1.5 as it was given"),
        ({"legs": True}, "7:3: parameters.legs: must be int 1.., not true as it was given"),
        ({"side": "up"}, "8:3: parameters.side: must be one of 'left', 'right', not 'up' as it was given"),
        ({"angles": "x"}, "9:3: parameters.angles: must be list, not 'x' as it was given"),
        ({"side": None}, "8:3: parameters.side: must be string 'left'|'right', not nothing as it was given"),
        ({"loud": 1}, "10:3: parameters.loud: must be bool, not 1 as it was given"),
        ({"speed": 1}, "5:1: parameters: unknown parameter 'speed'; did you mean 'speed_m_s'?"),
    ],
)
def test_what_may_not_be_given(tmp_path: Path, given: dict[str, object], expected: str) -> None:
    assert problems(tmp_path, DECLARED, **given) == [f"s.yaml:{expected}"]


@pytest.mark.parametrize(
    ("declared", "expected"),
    [
        ("a: {type: double, default: fast}", "6:30: parameters.a.default: must be double, not 'fast'"),
        ("a: {type: int, minimum: 3, maximum: 1}", "6:39: parameters.a.maximum: is below the minimum, 3"),
        ("a: {type: bool, minimum: 3}", "6:19: parameters.a.minimum: has no meaning for a bool"),
        ("a: {type: int, choices: [1, x]}", "6:31: parameters.a.choices[1]: must be int 1|'x', not 'x'"),
        (
            "a: {type: float}",
            "6:13: parameters.a.type: must be 'int', 'double', 'bool', 'string' or 'list', not 'float'",
        ),
        ("a: {default: 3}", "6:6: parameters.a.type: is missing"),
        (
            "robot: {type: int}",
            "6:3: parameters.robot: 'robot' is a built-in name, and cannot be the name of a variable",
        ),
        (
            "min: {type: int}",
            "6:3: parameters.min: 'min' is a built-in name of expressions, and cannot be the name of a variable",
        ),
        (
            "if: {type: int}",
            "6:3: parameters.if: 'if' is a keyword of expressions, and cannot be the name of a variable",
        ),
    ],
)
def test_what_may_not_be_declared(tmp_path: Path, declared: str, expected: str) -> None:
    assert problems(tmp_path, f"parameters:\n  {declared}\n") == [f"s.yaml:{expected}"]


def test_parameters_hide_no_problem_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(f"{HEAD}{DECLARED}".replace("{log:", "{lgo:"))
    with pytest.raises(ConfigError, match="unknown step 'lgo'"):
        load_scenario(tmp_path / "s.yaml", {"speed": 1})


def test_settings_of_a_command_line(tmp_path: Path) -> None:
    load(tmp_path)
    file = load_scenario(tmp_path / "s.yaml").file
    texts = ["speed_m_s=0.2", "legs = 3", "side=right", "angles=1,2.5,x", "loud=true"]
    values = {"speed_m_s": 0.2, "legs": 3, "side": "right", "angles": [1, 2.5, "x"], "loud": True}

    assert read_settings(file, texts) == values
    assert read_settings(file, ["angles=[1, 2]", "legs=two"]) == {"angles": [1, 2], "legs": "two"}
    for wrong in ("legs", "=3"):
        with pytest.raises(ValueError, match="must be NAME=VALUE"):
            read_settings(file, [wrong])
    with pytest.raises(ValueError, match="gives 'legs' twice"):
        read_settings(file, ["legs=1", "legs=2"])


WAYPOINTS = """\
parameters:
  waypoints: {type: list, unit: m, default: [[0, 0], [1, 0.5]]}
"""


def test_a_list_of_lists(tmp_path: Path) -> None:
    assert load(tmp_path, WAYPOINTS) == {"waypoints": ((0, 0), (1, 0.5))}
    assert load(tmp_path, WAYPOINTS, waypoints=[[2, 1]]) == {"waypoints": ((2, 1),)}
    file = load_scenario(tmp_path / "s.yaml").file
    assert read_settings(file, ["waypoints=[[1, 2.5], [3, 4]]"]) == {"waypoints": [[1, 2.5], [3, 4]]}
    assert read_settings(file, ["waypoints=[[[1]]]"]) == {"waypoints": "[[[1]]]"}, "which is refused as text"


def test_texts_of_a_list_need_no_quotes(tmp_path: Path) -> None:
    load(tmp_path, WAYPOINTS)
    file = load_scenario(tmp_path / "s.yaml").file
    assert read_settings(file, ["waypoints=[dock, table 2]"]) == {"waypoints": ["dock", "table 2"]}
    assert read_settings(file, ["waypoints=[dock, 'a"]) == {"waypoints": "[dock, 'a"}, "which is refused as text"


def test_a_list_holds_numbers_that_are_numbers(tmp_path: Path) -> None:
    (problem,) = problems(tmp_path, WAYPOINTS, waypoints=[[float("nan"), 1]])
    assert (
        problem == "s.yaml:6:3: parameters.waypoints: must be list m of finite numbers, not [[NaN, 1]] as it was given"
    )


def test_lists_deeper_than_that_are_refused(tmp_path: Path) -> None:
    (problem,) = problems(tmp_path, WAYPOINTS.replace("[0, 0]", "[[0], 0]"))
    assert problem.startswith("s.yaml:6:")
    assert "must be text, a number, true or false, not" in problem
