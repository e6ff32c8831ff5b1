"""Steps that stand in the wrong place, meet nobody, or refer to what nobody gives."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.scenario import check_scenario

HEAD = "version: 1\nname: x\nroles: {r: {}, q: {spares: 1}}\n"


def problems(folder: Path, body: str, head: str = HEAD) -> list[str]:
    (folder / "s.yaml").write_text(head + body)
    return [str(problem).removeprefix(f"{folder}/s.yaml:") for problem in check_scenario(folder / "s.yaml")]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (
            "steps: [{barrier: b, timeout_s: 1}]",
            "4:10: steps[0].barrier: a barrier must be inside an 'on' or a 'parallel'",
        ),
        (
            "steps: [{wait_for: redy, timeout_s: 1}, {signal: ready}]",
            "4:20: steps[0].wait_for: no step gives the signal 'redy'; did you mean 'ready'?",
        ),
        (
            "steps: [{wait_for: ready, timeout_s: 1}]",
            "4:20: steps[0].wait_for: no step gives the signal 'ready'; the scenario gives no signal",
        ),
        (
            "steps: [{on: r, until: frist, do: [{log: x}]}]",
            "4:24: steps[0].until: must be all, first or a signal, not 'frist'; did you mean 'first'?",
        ),
        (
            "steps: [{parallel: [[{on: r, do: [{log: x}]}], [{on: r, do: [{log: y}]}]]}]",
            "4:48: steps[0].parallel[1]: role 'r' is at work in branch '0' at the same time",
        ),
        (
            "steps: [{on: r, do: [{log: x, safe_to_repeat: true}]}]",
            "4:31: steps[0].do[0].safe_to_repeat: is allowed only for steps of the top level",
        ),
        (
            "steps: [{expect: 1 == 1, on_failure: drop}]",
            "4:26: steps[0].on_failure: there is no robot to drop: the step is outside of 'on'",
        ),
        (
            "steps: [{on: r, do: [{log: x, on_failure: substitute}]}]",
            "4:31: steps[0].do[0].on_failure: no spare can take a robot's place: give role 'r' 'spares: 1'",
        ),
        (
            "steps: [{log: \"${value('Range')}\"}]",
            "4:18: steps[0].log: value('Range') reads from a robot, so it must be in the 'do' of an 'on'",
        ),
        (
            "steps: [{on: r, do: [{halt: {resource: \"${value('B')}\"}}]}]",
            "4:43: steps[0].do[0].halt.resource: the resource must be known before the run, and value('B') is not",
        ),
        (
            "steps: [{let: {x: far}}]",
            (
                "4:19: steps[0].let.x: unknown variable 'far'; no variable is known here; "
                "a text needs quotes of its own: \"'far'\""
            ),
        ),
        (
            "steps: [{let: {x: 1}}, {on: r, do: [{let: {x: 2}}]}]",
            "4:44: steps[1].do[0].let.x: 'x' is a variable of the run; inside an 'on' it cannot be changed",
        ),
        (
            "parameters: {p: {type: int, default: 1}}\nsteps: [{let: {p: 2}}]",
            "5:16: steps[0].let.p: 'p' is a parameter, whose value does not change",
        ),
        (
            "steps: [{expect: true, tolerance: 0.1}]",
            "4:24: steps[0].tolerance: has no meaning without 'equals'",
        ),
        (
            "steps: [{if: '1 +', then: [{log: x}]}]",
            "4:15: steps[0].if: '1 +' is not an expression: invalid syntax",
        ),
        (
            "steps: [{on: r, do: [{if: \"index + valu('Range')\", then: [{log: x}]}]}]",
            "4:36: steps[0].do[0].if: unknown function 'valu'; did you mean 'value'?",
        ),
        (
            "steps: [{repeat: many, do: [{log: x}]}]",
            "4:18: steps[0].repeat: must be a whole number, not 'many'",
        ),
        (
            "steps: [{on: r, do: [{get_value: {resource: B}, together: true}]}]",
            (
                "4:49: steps[0].do[0].together: unknown key 'together'; known: get_value, lost_after_s, on_failure, "
                "safe_to_repeat, save, save_as, timeout_s"
            ),
        ),
        (
            "steps: [{while: 'true', limit: 2, do: [{on: r, do: [{get_value: {resource: B}, save: a.png}]}]}]",
            (
                "4:86: steps[0].do[0].do[0].save: each pass of the loop around it overwrites the file: "
                "its name lacks ${i}"
            ),
        ),
    ],
)
def test_a_step_in_the_wrong_place(tmp_path: Path, body: str, expected: str) -> None:
    assert problems(tmp_path, body) == [expected]


def test_roles_that_contradict_themselves(tmp_path: Path) -> None:
    head = "version: 1\nname: x\non_failure: substitute\nroles: {r: {min: 3, max: 2, on_failure: substitute}}\n"

    assert problems(tmp_path, "steps: [{log: x}]", head) == [
        "3:1: on_failure: no spare can take a robot's place: give role 'r' 'spares: 1'",
        "4:26: roles.r.max: is below 'min', 3",
        "4:29: roles.r.on_failure: no spare can take a robot's place: give role 'r' 'spares: 1'",
    ]


@pytest.mark.parametrize(
    "body",
    [
        "steps: [{on: q, on_failure: substitute, do: [{log: x}]}]",
        "steps: [{parallel: [[{barrier: b, timeout_s: 1}], [{barrier: b, timeout_s: 2}]]}]",
        "steps: [{on: r, do: [{parallel: [[{barrier: b, timeout_s: 1}]]}]}]",
        "steps: [{let: {x: 1}}, {on: r, do: [{let: {y: x + index}}, {wait_s: '${y}'}]}]",
        "steps: [{for: {n: '${range(3)}'}, do: [{repeat: '${n + 1}', do: [{log: '${i} ${n}'}]}]}]",
        "steps: [{repeat: 2, do: [{on: r, do: [{get_value: {resource: B}, save: a.csv}]}]}]",
        "steps: [{expect: run.seed == 0}, {if: true, then: [{log: x}]}]",
    ],
)
def test_steps_that_stand_well(tmp_path: Path, body: str) -> None:
    assert problems(tmp_path, body) == []
