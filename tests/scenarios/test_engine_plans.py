from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, RobotFailedError, RobotNotFoundError
from eal_actors.scenario import (
    RobotDropped,
    RunStarted,
    make_plan,
)
from tests.scenarios.rig import HEAD, ask, rigs, scenario
from tests.scenarios.running import ON, Watch, outcomes, run


def test_nothing_moves_when_something_is_wrong(two: Fleet, tmp_path: Path) -> None:
    body = (
        f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n"
        "  - for: {seconds: [1, 101]}\n    do: [{send_cmd: {resource: Base, cmd: 'go${seconds}'}}]\n"
        "  - get_value: {resource: Ear}\n"
    )
    with pytest.raises(ConfigError) as caught:
        run(two, tmp_path, body)

    assert [(problem.line, problem.message) for problem in caught.value.problems] == [
        (11, "fast, slow: command 'go101': its argument must be double 0..100 s, not 101"),
        (12, "fast, slow: unknown resource 'Ear'; known: Base, Eye"),
    ]
    assert ask(two, "fast", "tries") == 0


def test_a_plan_counts_its_calls(two: Fleet, tmp_path: Path) -> None:
    step = "send_cmd: {resource: Base, cmd: now}"
    loop = f"for: {{a: [1, 2]}}\n      do: [{{{step}}}]"
    body = f"steps:\n- repeat: 3\n  do:\n  - on: all\n    do:\n    - {step}\n    - {loop}\n"
    plan = make_plan(scenario(tmp_path, body), two)

    assert (plan.roles, plan.robots, plan.calls) == ({"all": ("fast", "slow")}, ("fast", "slow"), 18)


@pytest.mark.parametrize(("trouble", "reason"), [("is_broken", "unplugged"), ("fails_to_open", "no such port")])
def test_a_robot_that_did_not_start_keeps_the_scenario_from_starting(tmp_path: Path, trouble: str, reason: str) -> None:
    plain = scenario(tmp_path, f"{ON}  - log: x\n")
    broken = {trouble: True}
    with (
        rigs(tmp_path, head="defaults: {max_restarts: 0}", a=broken, b={}, c=broken) as fleet,
        pytest.raises(RobotFailedError) as caught,
    ):
        make_plan(plain, fleet)

    assert caught.value.robot == "a"
    assert reason in caught.value.message
    assert caught.value.message.endswith("; nor did c start")


def test_a_robot_that_did_not_start_is_dropped_where_the_scenario_drops(tmp_path: Path) -> None:
    watch = Watch()
    with rigs(tmp_path, a={"is_broken": True}, b={}) as fleet:
        body = f"on_failure: {{retry: 1, then: drop}}\n{ON}  - send_cmd: {{resource: Base, cmd: now}}\n"
        report = run(fleet, tmp_path, body, listeners=[watch])

        with pytest.raises(RobotFailedError, match="role 'all' needs at least 2 robots"):
            make_plan(scenario(tmp_path, body, HEAD.replace("all: {}", "all: {min: 2}")), fleet)

    assert (report.outcome, outcomes(report)) == ("done", {"a": "dropped", "b": "done"})
    assert "unplugged" in str(report.robots["a"].error)
    assert [event.robot for event in watch.events if isinstance(event, RobotDropped)] == ["a"]
    assert [event.calls for event in watch.events if isinstance(event, RunStarted)] == [1]


def test_a_fleet_must_be_connected(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}) as fleet:
        pass

    with pytest.raises(RobotNotFoundError, match="is not connected"):
        make_plan(scenario(tmp_path, f"{ON}  - log: x\n"), fleet)
