"""Robots and their controller on separate machines (network namespaces), with cables that can be cut."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from tests.net.links import eventually
from tests.net.namespaces import Cabled, cabled, why_not
from tests.net.rig import Process, Rig

REASON = why_not()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))

DANCERS = ("evbot2-1", "evbot3-1", "roomba-1")


def started(stack: ExitStack, within: tuple[str, ...], folder: Path, *words: object) -> Process:
    """Start `eal` on one of the machines; it ends with the exit stack."""
    process = Process(["-m", "eal_actors", *map(str, words)], folder, within)
    stack.callback(process.end)
    return process


def serve(stack: ExitStack, net: Cabled, file: Path) -> dict[str, Process]:
    """Serve each robot on its own machine, and wait until all listen."""
    servers = {
        robot: started(stack, tuple(net.at(robot)), file.parent, "serve", "--fleet", file, "--robot", robot)
        for robot in net.robots
    }
    for server in servers.values():
        server.wait_until_listening()
    return servers


def summary(runs: Path) -> Any:
    (run,) = runs.iterdir()
    return json.loads((run / "summary.json").read_text(encoding="utf-8"))


def test_the_dance_of_three_hosts(tmp_path: Path) -> None:
    file, runs = tmp_path / "hosts.yaml", tmp_path / "runs"
    with cabled(DANCERS) as net, ExitStack() as stack:
        addresses = "".join(f'  {robot}: {{address: "tcp/{host}:50000"}}\n' for robot, host in net.hosts.items())
        file.write_text(
            f"version: 1\nname: hosts\ninclude: ['{bundled_path('fleets/sim.yaml')}']\nclock: {{rate: 10}}\n"
            f"robots:\n{addresses}",
            encoding="utf-8",
        )
        serve(stack, net, file)
        dance = bundled_path("scenarios/dance.yaml")
        words = ("run", dance, "--fleet", file, "--runs-dir", runs, "--no-plot")
        run = started(stack, tuple(net.at_controller()), tmp_path, *words)
        assert run.wait() == 0, run.lines
    told = summary(runs)
    assert told["outcome"] == "done"
    assert sorted(told["robots"]) == sorted(DANCERS)


def test_a_robot_whose_cable_is_cut_halts_and_the_run_names_it(tmp_path: Path) -> None:
    robots = ("r1", "r2", "r3")
    rig = Rig(tmp_path, robots, network={"dead_man_s": 1.0, "lease_s": 1.0})
    scenario, runs = tmp_path / "move.yaml", tmp_path / "runs"
    scenario.write_text(
        "version: 1\nname: move\nroles: {all: {}}\non_failure: drop\nsteps:\n- on: all\n  do:\n"
        "  - send_cmd: {resource: Arm, cmd: move4}\n    timeout_s: 100\n",
        encoding="utf-8",
    )
    with cabled(robots) as net, ExitStack() as stack:
        for robot, host in net.hosts.items():
            rig.content["robots"][robot]["address"] = f"tcp/{host}:50000"
        rig.write()
        servers = serve(stack, net, rig.file)
        words = ("run", scenario, "--fleet", rig.file, "--runs-dir", runs, "--no-plot", "--strict")
        run = started(stack, tuple(net.at_controller()), tmp_path, *words)
        assert eventually(lambda: len(rig.notes("begin")) == len(robots)), run.lines
        net.cut("r2")
        servers["r2"].wait_for("its controller is silent: halted")
        assert eventually(lambda: rig.notes("halt", robot="r2"))
        assert run.wait() != 0
        assert {note.robot for note in rig.notes("end")} == {"r1", "r3"}  # the other robots were not disturbed
    told = summary(runs)
    assert {name: robot["outcome"] for name, robot in told["robots"].items()} == {
        "r1": "done",
        "r2": "dropped",
        "r3": "done",
    }
    error = told["robots"]["r2"]["error"]
    assert error["code"] == "unavailable"  # long before its deadline
    assert error["message"].startswith("r2/Arm: its outcome is unknown: the robot ")
