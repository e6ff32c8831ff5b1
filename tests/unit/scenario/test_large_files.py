"""Files of ten thousand steps, files that are nested deep, and what YAML would make of odd words."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from eal_actors.scenario import Scenario, load_scenario
from eal_actors.scenario.language.binding import Binding, RobotFacts
from eal_actors.scenario.language.robot_check import RobotCheck
from tests.unit.scenario.test_robots import ROBOTS

HEAD = "version: 1\nname: x\nroles: {all: {}}\n"


def load(folder: Path, body: str) -> Scenario:
    (folder / "s.yaml").write_text(HEAD + body)
    return load_scenario(folder / "s.yaml")


def refused(folder: Path, body: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load(folder, body)
    return str(caught.value).replace(f"{folder}/", "")


def test_ten_thousand_steps_on_a_hundred_robots(tmp_path: Path) -> None:
    steps = "".join(f"  - send_cmd: {{resource: Base, cmd: 'r${{{n} % 360}}'}}\n" for n in range(5000))
    steps += "".join(f"  - send_cmd: {{resource: Base, cmd: r{n % 360}}}\n" for n in range(5000))
    scenario = load(tmp_path, f"steps:\n- on: all\n  do:\n{steps}")
    assert len(scenario.file.steps[0].children()[0][1]) == 10_000

    robots = {f"r{number}": RobotFacts(dict(ROBOTS["a"].resources)) for number in range(100)}
    start_s = time.process_time()
    assert RobotCheck(robots, Binding({"all": tuple(robots)}, {}), None).problems_of(scenario) == []
    assert time.process_time() - start_s < 5.0


def nested(depth: int, inner: str) -> str:
    """Return steps inside each other, as people write them: in flow style, so that a line is not as long as deep."""
    return "steps: [" + "{repeat: 1, do: [" * depth + inner + "]}" * depth + "]\n"


def test_sixty_blocks_inside_each_other_are_fine(tmp_path: Path) -> None:
    scenario = load(tmp_path, nested(60, "{log: x}"))

    assert RobotCheck({"a": ROBOTS["a"]}, Binding({"all": ("a",)}, {}), None).problems_of(scenario) == []


@pytest.mark.parametrize("depth", [100, 1000, 20_000])
def test_what_is_nested_deeper_is_refused_in_plain_words(tmp_path: Path, depth: int) -> None:
    message = refused(tmp_path, nested(depth, "{log: x}"))

    assert message.startswith("s.yaml:4:")
    assert message.endswith(": is nested more than 128 levels deep")


def test_anchors_do_not_explode(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9)]

    assert "the file has more than 200000 values, each use of an anchor counted" in refused(tmp_path, "\n".join(lines))


def test_anchors_are_fine_where_they_stay_small(tmp_path: Path) -> None:
    body = "steps:\n- &wait {wait_s: 1}\n- *wait\n- on: all\n  do: [*wait]\n"

    assert len(load(tmp_path, body).file.steps) == 3


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("steps:\n- log: a\n\twait_s: 1\n", "s.yaml:6:1: YAML does not allow a tab here; use spaces"),
        ("steps: [{log: a, log: b}]\n", "s.yaml:4:18: steps[0].log: duplicate key; first defined in line 4"),
        (
            "steps: [{parallel: {a: [{log: x}], a: [{log: y}]}}]\n",
            "s.yaml:4:36: steps[0].parallel.a: duplicate key; first defined in line 4",
        ),
        ("steps: [{<<: {log: x}}]\n", "s.yaml:4:10: steps[0]: merge keys (<<) are not supported"),
        ("steps: [{log: !!python/name:os.system x}]\n", "s.yaml:4:15: the tag"),
        ("steps: [{wait_s: yes}]\n", "s.yaml:4:18: steps[0].wait_s: must be a number, not 'yes'"),
        ("steps: [{wait_s: 1:30}]\n", "s.yaml:4:18: steps[0].wait_s: must be a number, not '1:30'"),
        (
            "steps: [{repeat: 010.5, do: [{log: x}]}]\n",
            "s.yaml:4:18: steps[0].repeat: must be a whole number, not 10.5",
        ),
        (
            "steps: [{true: x}]\n",
            "s.yaml:4:10: steps[0]: a key must be text, and true is not; write it in quotes: 'true'",
        ),
        ("---\nsteps: [{log: x}]\n---\n", "a second document starts here"),
    ],
)
def test_what_yaml_would_take_for_something_else(tmp_path: Path, body: str, expected: str) -> None:
    assert expected in refused(tmp_path, body)


def test_on_and_no_are_words(tmp_path: Path) -> None:
    scenario = load(tmp_path, "steps: [{on: all, do: [{log: no}, {log: on}, {log: off}]}]\n")

    assert [step.log for _, steps in scenario.file.steps[0].children() for step in steps] == ["no", "on", "off"]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("body", "missing"),
    [
        ("steps: [{on: all, do: [{barrier: b}]}]", "steps[0].do[0].timeout_s: is missing"),
        ("steps: [{on: all, do: [{signal: s}, {wait_for: s}]}]", "steps[0].do[1].timeout_s: is missing"),
        ("steps: [{on: all, do: [{wait_until: value('B')}]}]", "steps[0].do[0].timeout_s: is missing"),
        ("steps: [{while: 'true', do: [{log: x}]}]", "steps[0].limit: is missing"),
    ],
)
def test_nothing_is_without_a_bound(tmp_path: Path, body: str, missing: str) -> None:
    assert missing in refused(tmp_path, body)
