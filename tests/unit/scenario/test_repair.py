"""Mistakes that hide behind an invalid value are reported with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.scenario import check_scenario

ALL_KINDS = """\
version: 1
name: sixteen
colour: red
parameters:
  a: {type: int, default: 0.5}
  b: {type: doubel, default: 1}
roles:
  all: {min: 3, max: 2}
  two: {mni: 1}
steps:
- on: al
  do:
  - sned_cmd: {resource: Base, cmd: f1}
    save_as: later
  - send_cmd: {resource: Base, cmd: "f${speed}"}
  - send_cmd: {resource: Base}
  - wait_s: -1
  - wait_for: go
    timeout_s: 3
  - repeat: many
    do:
    - log: "${i + nothing}"
  - expect: later > 1
  - barrier: x
  - let: {if: 3}
- send_cmd: {resource: Base, cmd: f1}
- wait_until: "1 +"
  timeout_s: 1
- log: "${1 / 0}"
- scenario: nowhere.yaml
- while: 'true'
  do: [{log: "${b}"}]
"""


def test_mistakes_of_all_kinds_are_reported_at_once(tmp_path: Path) -> None:
    file = tmp_path / "mistakes.yaml"
    file.write_text(ALL_KINDS)
    found = [f"{problem.line}:{problem.column}: {problem.path}" for problem in check_scenario(file)]
    assert found == [
        "3:1: colour",
        "5:27: parameters.a.default",
        "6:13: parameters.b.type",
        "8:22: roles.all.max",
        "9:9: roles.two.mni",
        "11:7: steps[0].on",
        "13:5: steps[0].do[0]",
        "15:41: steps[0].do[1].send_cmd.cmd",
        "16:15: steps[0].do[2].send_cmd.cmd",
        "17:13: steps[0].do[3].wait_s",
        "18:15: steps[0].do[4].wait_for",
        "20:13: steps[0].do[5].repeat",
        "22:19: steps[0].do[5].do[0].log",
        "24:5: steps[0].do[7].timeout_s",
        "25:11: steps[0].do[8].let.if",
        "26:3: steps[1].send_cmd",
        "27:16: steps[2].wait_until",
        "29:11: steps[3].log",
        "30:13: steps[4].scenario",
        "31:3: steps[5].limit",
    ]
    once = [len(check_scenario(write_without(file, line))) for line in (3, 9, 17)]
    assert once == [19, 19, 19]


def write_without(file: Path, line: int) -> Path:
    """Write a copy of a file without one line."""
    lines = file.read_text().splitlines(keepends=True)
    other = file.with_name("other.yaml")
    other.write_text("".join(lines[: line - 1] + lines[line:]))
    return other


@pytest.mark.parametrize(
    "text", ["steps: 3\n", "steps: []\n", "steps: [[], 1, null]\nroles: x\n", "'a.b[0]': {c: 1}\n"]
)
def test_what_is_no_scenario_at_all_is_reported_as_before(tmp_path: Path, text: str) -> None:
    file = tmp_path / "mistakes.yaml"
    file.write_text(f"version: 1\n{text}")
    problems = [str(problem) for problem in check_scenario(file)]
    assert any("name: is missing" in problem for problem in problems)
    assert len(set(problems)) == len(problems)
