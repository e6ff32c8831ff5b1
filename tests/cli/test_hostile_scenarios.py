"""`eal run --dry-run` reports endless and oversized scenarios quickly, with file, line and column."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path

Write = Callable[[str, str], Path]

HEAD = "version: 1\nname: x\nroles: {all: {}}\n"
MOST_CPU_S = 60.0
"""Limit of processor seconds for an answer; an idle machine takes a tenth of it."""


@pytest.fixture
def look(eal: Any, write: Write, tmp_path: Path) -> Callable[[str], str]:
    """Return the output of a dry run on three simulated robots, without the folder's path."""

    def look_ahead(body: str) -> str:
        scenario = write("s.yaml", HEAD + body)
        words = ("-f", bundled_path("fleets/sim.yaml"), "--rate", "max", "--dry-run", "--runs-dir", tmp_path / "runs")
        start_s = time.process_time()
        result = eal("run", scenario, *words)
        assert time.process_time() - start_s < MOST_CPU_S
        assert result.exit_code in (0, 2), result.output
        assert not (tmp_path / "runs").exists()
        text: str = result.stderr if result.exit_code else result.stdout
        return text.replace(f"{tmp_path}/", "")

    return look_ahead


def call(command: str) -> str:
    return f"{{send_cmd: {{resource: Base, cmd: '{command}'}}}}"


@pytest.mark.slow
def test_ten_thousand_steps_are_fine(look: Callable[[str], str]) -> None:
    steps = "".join(f"  - {call(f'r{number % 360}')}\n" for number in range(10_000))
    assert "30000 calls by 3 robots." in look(f"steps:\n- on: all\n  do:\n{steps}")


def test_sixty_blocks_inside_each_other_are_fine(look: Callable[[str], str]) -> None:
    blocks = "{sequence: [" * 55 + call("r10") + "], timeout_s: 5}" * 55
    assert "3 calls by 3 robots." in look(f"steps: [{{on: all, do: [{blocks}]}}]\n")


@pytest.mark.parametrize("depth", [200, 30_000])
def test_deeper_nesting_is_refused(look: Callable[[str], str], depth: int) -> None:
    told = look("steps: [" + "{repeat: 2, do: [" * depth + "{log: x}" + "]}" * depth + "]\n")
    assert told.startswith("s.yaml:4:")
    assert "is nested more than 128 levels deep" in told


def test_anchors_that_explode(look: Callable[[str], str]) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 12)]
    told = look("\n".join(lines) + "\nsteps: [{log: x}]\n")
    assert told.startswith("s.yaml:")
    assert "the file has more than 200000 values, each use of an anchor counted" in told


def nested_loops() -> str:
    loop = f"{{for: {{a: '${{range(1000)}}'}}, do: [{call('r${i + a}')}]}}"
    return f"steps: [{{on: all, do: [{{repeat: 1000, do: [{loop}]}}]}}]\n"


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (
            f"steps: [{{on: all, do: [{{repeat: 1000001, do: [{call('r1')}]}}]}}]\n",
            "s.yaml:4:33: steps[0].do[0].repeat: must be at most 1000000, not 1000001",
        ),
        (
            f"steps: [{{on: all, do: [{{repeat: 1000000, do: [{call('r${i % 360}')}]}}]}}]\n",
            "s.yaml:4:47: steps[0].do[0].do[0]: the loops around this step give 1000000 combinations; at most 100000 ",
        ),
        pytest.param(
            nested_loops(),
            "the loops around this step give 100001 combinations; at most 100000 can be checked",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            f"steps: [{{on: all, do: [{{repeat: 60000, do: [{', '.join([call('r${i % 360}')] * 50)}]}}]}}]\n",
            "steps[0].do[0].do[1]: up to here, loops give more than 200000 combinations; the rest was not checked",
            marks=pytest.mark.slow,
        ),
        (
            f"steps: [{{let: {{a: '[{', '.join(['range(10000)'] * 30)}]'}}}}]\n",
            "s.yaml:4:20: steps[0].let.a: [range(10000), range(10000), range(10000), [...]: needs more work ",
        ),
        (
            f"steps: [{{on: all, do: [{{repeat: 10000, do: [{call('r${len(range(1500 + i)) % 9}')}]}}]}}]\n",
            "s.yaml:4:78: steps[0].do[0].do[0].send_cmd.cmd: evbot2-1, evbot3-1, roomba-1: up to here, ",
        ),
        (
            "steps: [{while: 'true', do: [{log: x}]}]\n",
            "s.yaml:4:9: steps[0].limit: is missing",
        ),
        (
            "steps: [{log: \"${'x' * 10 ** 9}\"}]\n",
            "s.yaml:4:18: steps[0].log: 'x' * 10 ** 9: '*' takes numbers, not text",
        ),
        (
            f"steps: [{{on: nobody, do: [{call('r1')}]}}]\n",
            "s.yaml:4:14: steps[0].on: there is no role 'nobody', so it is a robot, and the fleet",
        ),
        (
            f"parameters: {{d: {{type: int, unit: cm, default: 10}}}}\nsteps: [{{on: all, do: [{call('f${d}')}]}}]\n",
            "steps[0].do[0].send_cmd.cmd: evbot2-1, evbot3-1, roomba-1: parameter 'd' is in cm, and Base f10 takes m",
        ),
        (
            "parameters: {t: {type: double, unit: ms, default: 10}}\nsteps: [{wait_s: '${t}'}]\n",
            "s.yaml:5:18: steps[0].wait_s: parameter 't' is in ms, and this takes s",
        ),
        (
            f"steps: [{{on: all, do: [{call('r9999')}]}}]\n",
            "s.yaml:4:57: steps[0].do[0].send_cmd.cmd: evbot2-1, evbot3-1, roomba-1: ",
        ),
        (
            "steps: [{scenario: s.yaml}]\n",
            "s.yaml:4:20: steps[0].scenario: s.yaml: includes itself: s.yaml -> s.yaml",
        ),
    ],
    ids=lambda text: "" if "steps: [" in text else None,
)
def test_what_would_never_end_or_does_not_fit(look: Callable[[str], str], body: str, expected: str) -> None:
    told = look(body)
    assert expected in told, told
    assert "1 problem; nothing was done." in told


def look_at_nested_parts(look: Callable[[str], str], write: Write, step: str, levels: int = 6, uses: int = 40) -> str:
    """Dry-run nested parts, each of which uses the next one so often; the last part has one step."""
    for level in range(levels):
        write(f"p{level}.yaml", HEAD + f"steps: [{', '.join([f'{{scenario: p{level + 1}.yaml}}'] * uses)}]\n")
    write(f"p{levels}.yaml", HEAD + f"steps: [{{{step}: x}}]\n")
    return look("steps: [{scenario: p0.yaml}]\n")


def test_parts_that_explode(look: Callable[[str], str], write: Write) -> None:
    told = look_at_nested_parts(look, write, "log")
    assert "scenario: makes more than 100000 steps, each use of a scenario counted" in told
    assert told.startswith("p")


def test_a_broken_part_that_is_used_everywhere_is_read_once(look: Callable[[str], str], write: Write) -> None:
    told = look_at_nested_parts(look, write, "lag")
    assert "p6.yaml:4:9: steps[0]: unknown step 'lag'; did you mean 'log'?" in told


def test_parts_inside_each_other_too_deep(look: Callable[[str], str], write: Write) -> None:
    assert "is the 9th scenario inside another" in look_at_nested_parts(look, write, "log", levels=12, uses=1)
