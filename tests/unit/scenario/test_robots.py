from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from eal_actors.device.data import DataType
from eal_actors.device.info import CommandInfo, ConfigInfo, ResourceInfo, ResourceType, ValueInfo
from eal_actors.device.motion.map_motions import GOAL
from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Scenario, load_scenario
from eal_actors.scenario.language.binding import Binding, RobotFacts, find_candidates
from eal_actors.scenario.language.robot_check import RobotCheck

ANGLE = ValueInfo(DataType.DOUBLE, "deg", 0, 360)
BASE = ResourceInfo(
    "Base",
    ResourceType.ACTUATOR,
    frozenset({"send_cmd", "set_value", "send_req", "get_config", "set_config"}),
    value=ValueInfo(DataType.INT, minimum=0, maximum=9),
    commands=(
        CommandInfo("g"),
        CommandInfo("goto", GOAL),
        CommandInfo("r<degrees>", ANGLE),
        CommandInfo("say", ValueInfo(DataType.CHAR)),
    ),
    requests=(CommandInfo("name"), CommandInfo("number", returns=ValueInfo(DataType.INT))),
    configs=(ConfigInfo("gain", ValueInfo(DataType.DOUBLE, None, 0, 1)), ConfigInfo("serial", ANGLE, writable=False)),
)
EYE = ResourceInfo("Eye", ResourceType.SENSOR, frozenset({"get_value", "send_req"}))
LIDAR = ResourceInfo(
    "Lidar", ResourceType.SENSOR, frozenset({"get_value"}), value=ValueInfo(DataType.DOUBLE, shape=(8,))
)
FREE = ResourceInfo("Free", ResourceType.OTHER, frozenset({"send_cmd", "write_comm", "set_value"}))
ROBOTS = {
    "a": RobotFacts({"Base": BASE, "Eye": EYE, "Lidar": LIDAR, "Free": FREE}),
    "b": RobotFacts({"Base": BASE, "Free": FREE}, "; left out: no camera"),
}
FLEET = """\
version: 1
name: two
types:
  rover: {tags: [wheeled], plugins: {p: {}}}
robots:
  a: {type: rover}
  b: {tags: [tracked], plugins: {p: {}}}
"""


def scenario(folder: Path, body: str, roles: str = "{all: {}}") -> Scenario:
    path = folder / "s.yaml"
    path.write_text(f"version: 1\nname: x\ndescription: d\nroles: {roles}\n{body}")
    return load_scenario(path)


def steps(*lines: str) -> str:
    """Write steps for the role `all`; the first one stands in line 8."""
    return "steps:\n- on: all\n  do:\n" + "".join(f"  - {line}\n" for line in lines)


def problems(folder: Path, body: str, robots: Mapping[str, RobotFacts] = ROBOTS) -> list[str]:
    found = RobotCheck(robots, Binding({"all": tuple(robots)}, {}), None).problems_of(scenario(folder, body))
    return [str(problem).removeprefix(f"{folder}/s.yaml:") for problem in found]


def test_a_scenario_that_fits_has_no_problems(tmp_path: Path) -> None:
    body = steps(
        "for: {angle: [0, 90, 360]}\n    do: [{send_cmd: {resource: Base, cmd: 'r${angle}'}}]",
        "send_cmd: {resource: Base, cmd: say, data: hello}",
        "set_value: {resource: Base, value: 9}",
        "set_config: {resource: Base, key: gain, value: 1}",
        "get_config: {resource: Base, key: serial}",
        "send_req: {resource: Base, req: name}",
        "send_cmd: {resource: Free, cmd: whatever, data: [1, 2]}",
        "write_comm: {resource: Free, data: abc}",
        "send_req: {resource: Base, req: name}\n    save: x.png",
        "get_config: {resource: Base, key: gain}\n    save: x.json",
        "halt: {resource: Base}",
    )

    assert problems(tmp_path, body) == []


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        (
            "log: '${index} of ${[1, 2]}'",
            "8:25: steps[0].do[0].log: ${[1, 2]} is of type list, which has no form in a text",
        ),
        (
            "expect: 1 == 1\n    says: 'not ${[1]}'",
            "9:18: steps[0].do[0].says: ${[1]} is of type list, which has no form in a text",
        ),
        (
            "send_cmd: {resource: Bse, cmd: g}",
            "8:26: steps[0].do[0].send_cmd.resource: a: unknown resource 'Bse'; did you mean 'Base'?",
        ),
        (
            "send_cmd: {resource: Base, cmd: gg}",
            "8:37: steps[0].do[0].send_cmd.cmd: a: unknown command 'gg'; did you mean 'g'?",
        ),
        (
            "send_cmd: {resource: Base, cmd: say}",
            "8:37: steps[0].do[0].send_cmd.cmd: a: command 'say' needs an argument: char",
        ),
        (
            "send_cmd: {resource: Base, cmd: r361}",
            "8:37: steps[0].do[0].send_cmd.cmd: a: command 'r361': its argument must be double 0..360 deg, not 361",
        ),
        (
            "send_cmd: {resource: Base, cmd: goto, data: [1, 2, 90]}",
            "8:37: steps[0].do[0].send_cmd.cmd: a: goto takes its heading in radians, not 90; `go_to` takes degrees",
        ),
        (
            "send_req: {resource: Base, req: nme}",
            "8:37: steps[0].do[0].send_req.req: a: unknown request 'nme'; did you mean 'name'?",
        ),
        (
            "set_value: {resource: Base, value: 10}",
            "8:40: steps[0].do[0].set_value.value: a: its value must be int 0..9, not 10",
        ),
        (
            "set_value: {resource: Free, value: [1, x]}",
            (
                "8:40: steps[0].do[0].set_value.value: a: a list of int, str has no type; "
                "all elements must be bools, or all must be ints and floats"
            ),
        ),
        (
            "get_config: {resource: Base, key: gane}",
            "8:39: steps[0].do[0].get_config.key: a: unknown configuration key 'gane'; did you mean 'gain'?",
        ),
        (
            "set_config: {resource: Base, key: serial, value: 1}",
            "8:39: steps[0].do[0].set_config.key: a: configuration key 'serial' is read-only",
        ),
        (
            "set_config: {resource: Base, key: gain, value: 2}",
            "8:39: steps[0].do[0].set_config.key: a: configuration key 'gain' must be double 0..1, not 2",
        ),
        (
            "set_config: {resource: Base, key: gain}",
            "8:39: steps[0].do[0].set_config.key: a: configuration key 'gain' needs a value: double 0..1",
        ),
        (
            "get_status: {resource: Eye}",
            "8:17: steps[0].do[0].get_status: a: Eye does not support get_status; it supports get_value, send_req",
        ),
        (
            "get_value: {resource: Eye}\n    save: ../x.png",
            "9:11: steps[0].do[0].save: '../x.png' is not a file name inside the run's folder",
        ),
        (
            "send_req: {resource: Base, req: number}\n    save: x.png",
            (
                "9:11: steps[0].do[0].save: a: cannot be saved as x.png: "
                "the answer is int, no image of (h, w, 3) unsigned bytes"
            ),
        ),
        (
            "get_config: {resource: Base, key: gain}\n    save: x.txt",
            "9:11: steps[0].do[0].save: a: cannot be saved as x.txt: the answer is double 0..1, no text",
        ),
        (
            "get_value: {resource: Lidar}\n    save: x.png",
            (
                "9:11: steps[0].do[0].save: a: cannot be saved as x.png: "
                "the answer is double (8), no image of (h, w, 3) unsigned bytes"
            ),
        ),
        (
            "for: {n: [[1, 2]]}\n    do: [{send_cmd: {resource: Base, cmd: 'r${n}'}}]",
            ("9:43: steps[0].do[0].do[0].send_cmd.cmd: a: ${n} is of type list, which has no form in a text"),
        ),
    ],
)
def test_what_a_robot_cannot_do(tmp_path: Path, step: str, expected: str) -> None:
    assert problems(tmp_path, steps(step), {"a": ROBOTS["a"]}) == [expected]


def test_all_problems_come_at_once_and_name_their_robots(tmp_path: Path) -> None:
    body = steps(
        "get_value: {resource: Eye}",
        "for: {angle: [10, 361, 20, 400]}\n    do: [{send_cmd: {resource: Base, cmd: 'r${angle}'}}]",
    )

    assert problems(tmp_path, body) == [
        "8:27: steps[0].do[0].get_value.resource: b: unknown resource 'Eye'; known: Base, Free; left out: no camera",
        (
            "10:43: steps[0].do[1].do[0].send_cmd.cmd: a, b: "
            "command 'r361': its argument must be double 0..360 deg, not 361"
        ),
        (
            "10:43: steps[0].do[1].do[0].send_cmd.cmd: a, b: "
            "command 'r400': its argument must be double 0..360 deg, not 400"
        ),
    ]


def test_many_robots_are_counted(tmp_path: Path) -> None:
    robots = {f"r{number}": ROBOTS["a"] for number in range(100)}

    (problem,) = problems(tmp_path, steps("send_cmd: {resource: Base, cmd: gg}"), robots)

    assert "r0, r1, r2 and 97 more: unknown command 'gg'" in problem


def test_loops_inside_loops_are_tried_together(tmp_path: Path) -> None:
    body = (
        "steps:\n- for: {side: [r, s]}\n  do:\n  - repeat: 2\n    do:\n    - on: all\n"
        "      do: [{send_cmd: {resource: Base, cmd: '${side}${i}'}}]\n"
    )

    assert [problem.partition("a, b: ")[2] for problem in problems(tmp_path, body)] == [
        "unknown command 's0'; known: g, goto, r<degrees>, say",
        "unknown command 's1'; known: g, goto, r<degrees>, say",
    ]


def test_only_the_loops_that_a_step_uses_are_tried(tmp_path: Path) -> None:
    inner = "- on: all\n      do: [{send_cmd: {resource: Base, cmd: 'r${i}'}}]"
    body = f"steps:\n- repeat: 1000000\n  do:\n  - repeat: 360\n    do:\n    {inner}\n"

    assert problems(tmp_path, body) == []


def test_too_many_combinations_are_a_problem(tmp_path: Path) -> None:
    body = "steps:\n- repeat: 100001\n  do:\n  - on: all\n    do: [{send_cmd: {resource: Base, cmd: 'r${i}'}}]\n"

    assert problems(tmp_path, body) == [
        "9:10: steps[0].do[0].do[0]: the loops around this step give 100001 combinations; at most 100000 can be checked"
    ]


def test_a_condition_between_two_loops_of_one_variable_means_the_outer_one(tmp_path: Path) -> None:
    command = "{send_cmd: {resource: Base, cmd: '%s'}}"
    loops = "repeat: 3\n    do:\n    - if: i == %s\n      then:\n      - repeat: 2\n        do: [" + command + "]"

    assert [
        found.partition("cmd.cmd: a, b: ")[2] for found in problems(tmp_path, steps(loops % (2, "r${i + 400}")))
    ] == [
        "command 'r400': its argument must be double 0..360 deg, not 400",
        "command 'r401': its argument must be double 0..360 deg, not 401",
    ]
    assert problems(tmp_path, steps(loops % (3, "r${i + 400}"))) == []


@pytest.mark.parametrize(
    ("count", "problem"),
    [
        ("${6 // n}", "6 // n: a division by zero"),
        ("${[n]}", "must be a whole number from 1 to 1000000, not [0]"),
    ],
)
def test_a_number_of_passes_without_a_value_is_a_problem_of_the_file(tmp_path: Path, count: str, problem: str) -> None:
    body = steps(f"repeat: {count}\n    do: [{{send_cmd: {{resource: Base, cmd: g}}}}]")

    found = problems(tmp_path, f"parameters: {{n: {{type: int, default: 0}}}}\n{body}")
    assert found == [f"9:13: steps[0].do[0].repeat: {problem}"]


def test_too_many_combinations_of_a_number_of_passes_are_a_problem(tmp_path: Path) -> None:
    passes = "- repeat: ${a + b + 1}\n        do: [{log: x}]"
    loops = f"for: {{a: '${{range(999)}}'}}\n    do:\n    - for: {{b: '${{range(999)}}'}}\n      do:\n      {passes}"

    assert [found.partition("repeat: ")[2] for found in problems(tmp_path, steps(loops))] == [
        "the loops around this step give 100001 combinations; at most 100000 can be checked"
    ]


def test_what_is_saved_during_the_run_is_not_checked(tmp_path: Path) -> None:
    body = steps(
        "get_value: {resource: Base}\n    save_as: seen",
        "set_value: {resource: Base, value: '${seen}'}",
        "get_value: {resource: Base}\n    save: '../${seen}.json'",
    )

    assert [problem.partition(" Base does")[0] for problem in problems(tmp_path, body, {"a": ROBOTS["a"]})] == [
        "8:16: steps[0].do[0].get_value: a:",
        "11:16: steps[0].do[2].get_value: a:",
    ]


def test_finally_is_checked_too(tmp_path: Path) -> None:
    body = "steps: [{wait_s: 1}]\nfinally: [{on: all, do: [{halt: {resource: Arm}}]}]\n"

    assert [problem.partition(":")[0] for problem in problems(tmp_path, body)] == ["6", "6"]


# Roles.


def bind(folder: Path, roles: str) -> dict[str, tuple[str, ...]]:
    (folder / "f.yaml").write_text(FLEET)
    fleet = EALConfigManager.load(folder / "f.yaml", environment={}).fleet
    return find_candidates(scenario(folder, "steps: [{wait_s: 1}]", roles), fleet)


@pytest.mark.parametrize(
    ("role", "robots"),
    [
        ("{}", ("a", "b")),
        ("{robots: [b, a]}", ("a", "b")),
        ("{tags: [wheeled]}", ("a",)),
        ("{types: [rover]}", ("a",)),
        ("{tags: [wheeled, tracked], robots: [b]}", ("b",)),
        ("{min: 2}", ("a", "b")),
    ],
)
def test_roles_bind_robots(tmp_path: Path, role: str, robots: tuple[str, ...]) -> None:
    assert bind(tmp_path, f"{{all: {role}}}") == {"all": robots}


def test_all_that_is_wrong_with_roles_comes_at_once(tmp_path: Path) -> None:
    roles = "{p: {min: 3}, q: {tags: [weeled], types: [rover, tank]}, r: {robots: [a], tags: [tracked]}}"

    with pytest.raises(ConfigError) as caught:
        bind(tmp_path, roles)

    assert [str(problem).removeprefix(f"{tmp_path}/s.yaml:") for problem in caught.value.problems] == [
        "4:9: roles.p: needs at least 3 of the robots of fleet 'two', but only 2 (a, b) fit",
        "4:33: roles.q.tags[0]: the fleet 'two' has no robot of tag 'weeled'; did you mean 'wheeled'?",
        "4:57: roles.q.types[1]: the fleet 'two' has no robot of type 'tank'; known: rover",
        "4:65: roles.r: needs at least 1 of the robots of fleet 'two', but none fit",
    ]
