"""`eal rehearse`: hand-calculated distances, collisions, simulated twins of real robots, and invalid input."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
import structlog
from typer.testing import CliRunner, Result

from eal_actors.cli import app
from eal_actors.device.world import load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError
from eal_actors.lab.rehearsal.proximity import ProximityRecorder
from eal_actors.lab.rehearsal.rehearse import Rehearsal, rehearse
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import simulated
from eal_actors.plugin import FleetServices, PluginContext
from eal_actors.scenario import Scenario, load_scenario, parse_scenario
from plugins.sim import plugin as sim
from tests.manual_clock import ManualClock
from tests.plugin_files import write_plugin
from tests.scenario_texts import scenario_of

RADIUS_M = 0.17  # of a Roomba
SPEED_M_S, ACCELERATION_M_S2 = 0.3, 0.8
TICK_M = SPEED_M_S * 0.02

WORLD = """\
version: 1
name: room
size_m: [6, 4]
"""


def seconds_to(distance_m: float) -> float:
    """Return the time of a Roomba that starts from rest and does not brake."""
    return distance_m / SPEED_M_S + SPEED_M_S / ACCELERATION_M_S2 / 2


@pytest.fixture
def fleet(tmp_path: Path) -> Callable[..., Path]:
    def write(robots: Mapping[str, str], world: str = "") -> Path:
        """Write a fleet file of robots whose plugins are given as YAML."""
        (tmp_path / "world.yaml").write_text(WORLD + dedent(world))
        lines = [f"  {name}: {{plugins: {{{plugins}}}}}" for name, plugins in robots.items()]
        file = tmp_path / "fleet.yaml"
        file.write_text("\n".join(["version: 1", "name: trial", "world: world.yaml", "robots:", *lines, ""]))
        return file

    return write


def roomba(x_m: float, y_m: float, yaw_deg: float = 0) -> str:
    return f"sim: {{model: roomba, noise: false, start: {{x_m: {x_m}, y_m: {y_m}, yaw_deg: {yaw_deg}}}}}"


def moves(**commands: str) -> Scenario:
    """Return a scenario in which each robot drives once, all at the same time."""
    branches = [
        f"    {name}: [{{on: {name}, do: [{{send_cmd: {{resource: Base, cmd: {command}}}}}]}}]"
        for name, command in commands.items()
    ]
    roles = [f"  {name}: {{robots: [{name}]}}" for name in commands]
    head = ["version: 1", "name: trial", "timeout_s: 60", "roles:", *roles, "steps:", "- parallel:"]
    return parse_scenario("\n".join([*head, *branches, ""]), "trial.yaml")


def of(file: Path) -> FleetConfig:
    return EALConfigManager.load(file, environment={}).fleet


def rehearsed(file: Path, scenario: Scenario, margin_m: float = 0.1, seed: int = 0) -> Rehearsal:
    config = of(file)
    return rehearse(scenario, simulated(config, config.robots), margin_m, seed)


def told(rehearsal: Rehearsal) -> list[tuple[str, str, bool]]:
    found = [incident.approach for incident in rehearsal.incidents]
    return [(approach.robot, approach.nearest.other, approach.is_hit) for approach in found]


@pytest.mark.parametrize(("margin_m", "is_near"), [(0.0499, False), (0.0501, True)])
def test_a_near_pass_of_an_obstacle_is_told_inside_the_margin_and_not_outside(
    fleet: Callable[..., Path], margin_m: float, is_near: bool
) -> None:
    y_m = RADIUS_M + 0.2 + 0.05  # the pillar's outline is 5 cm off the Roomba's as it passes
    world = f"obstacles:\n  - {{kind: circle, x_m: 0.0, y_m: {y_m}, radius_m: 0.2}}\n"
    rehearsal = rehearsed(fleet({"a": roomba(-1.0, 0.0)}, world), moves(a="f2"), margin_m)

    assert rehearsal.report.outcome == "done"
    assert rehearsal.is_clear is not is_near
    nearest = rehearsal.nearest["a"]
    assert nearest.other == f"obstacles[0] (circle at x 0 m, y {y_m:g} m)"
    assert nearest.gap_m == pytest.approx(0.05, abs=(TICK_M / 2) ** 2)
    assert nearest.gap_m >= 0.05
    assert nearest.time_s == pytest.approx(seconds_to(1.0), abs=0.02)
    assert nearest.place_m == pytest.approx((0.0, 0.0), abs=TICK_M)
    if is_near:
        (incident,) = rehearsal.incidents
        assert incident.approach.start_s < nearest.time_s < incident.approach.end_s
        assert [(step.robot, step.label) for step in incident.steps] == [("a", "send_cmd Base f2")]


@pytest.mark.parametrize(("margin_m", "near"), [(0.0799, []), (0.0801, [("a", "b", False)])])
def test_two_robots_that_pass_each_other_are_told_once(
    fleet: Callable[..., Path], margin_m: float, near: list[tuple[str, str, bool]]
) -> None:
    robots = {"a": roomba(-1.0, 0.0), "b": roomba(1.0, 2 * RADIUS_M + 0.08, 180)}
    rehearsal = rehearsed(fleet(robots), moves(a="f2", b="f2"), margin_m)

    assert told(rehearsal) == near
    for name in robots:
        assert rehearsal.nearest[name].gap_m == pytest.approx(0.08, abs=1e-4)
        assert rehearsal.nearest[name].time_s == pytest.approx(seconds_to(1.0), abs=0.021)
    assert [step.robot for incident in rehearsal.incidents for step in incident.steps] == ["a", "b"][: 2 * len(near)]


def test_two_robots_that_collide_are_told_with_the_time_of_the_first_touch(fleet: Callable[..., Path]) -> None:
    rehearsal = rehearsed(fleet({"a": roomba(-0.5, 0.0), "b": roomba(0.5, 0.0)}), moves(a="f1"))

    (incident,) = rehearsal.incidents
    assert incident.approach.is_hit
    assert {incident.approach.robot, incident.approach.nearest.other} == {"a", "b"}
    assert incident.approach.nearest.time_s == pytest.approx(seconds_to(1.0 - 2 * RADIUS_M), abs=0.05)
    assert incident.approach.start_s == pytest.approx(seconds_to(1.0 - 2 * RADIUS_M - 0.1), abs=0.021)
    assert [step.robot for step in incident.steps] == ["a"]  # the other robot waits and has no step


@pytest.mark.parametrize(
    ("command", "world", "other"),
    [
        ("f4", "", "the east wall"),
        ("f3", "boxes: [{name: crate, x_m: 1, y_m: 0, size_m: [0.2, 0.2], mass_kg: 1}]", "box crate"),
        ("f3", "beacons: [{name: dock, x_m: 1, y_m: 0, colour: [1, 2, 3]}]", "beacon dock"),
        ("f3", "obstacles: [{kind: wall, start_m: [1, -1], end_m: [1, 1]}]", "obstacles[0] (wall)"),
    ],
)
def test_what_is_hit_has_its_name(fleet: Callable[..., Path], command: str, world: str, other: str) -> None:
    rehearsal = rehearsed(fleet({"a": roomba(-0.5, 0.0)}, world), moves(a=command), 0.02)
    assert told(rehearsal)[0] == ("a", other, True)


def test_a_drop_counts_as_an_obstacle(fleet: Callable[..., Path]) -> None:
    world = "drops: [{x_m: 0, y_m: 0.5, size_m: [0.2, 0.2]}]"  # its edge is at y 0.4 m, 0.23 m off the outline
    file = fleet({"a": roomba(-1.0, 0.0)}, world)
    assert rehearsed(file, moves(a="f2"), 0.2299).is_clear
    rehearsal = rehearsed(file, moves(a="f2"), 0.2301)
    assert told(rehearsal) == [("a", "drops[0]", False)]


def test_robots_that_stand_too_near_are_told_though_nothing_moves(fleet: Callable[..., Path]) -> None:
    scenario = parse_scenario("version: 1\nname: wait\nroles: {a: {robots: [a]}}\nsteps: [{wait_s: 5}]\n", "wait.yaml")
    rehearsal = rehearsed(fleet({"a": roomba(0, 0), "b": roomba(0.4, 0)}), scenario)
    (incident,) = rehearsal.incidents
    assert (incident.approach.nearest.time_s, incident.steps) == (0.0, ())
    assert incident.approach.nearest.gap_m == pytest.approx(0.4 - 2 * RADIUS_M)


def test_two_approaches_are_two_incidents(fleet: Callable[..., Path]) -> None:
    drives = "{send_cmd: {resource: Base, cmd: f0.5}}, {send_cmd: {resource: Base, cmd: b0.5}}"
    scenario = parse_scenario(scenario_of(f"{{repeat: 2, do: [{drives}]}}", role="a"), "twice.yaml")
    start_m = 3.0 - RADIUS_M - 0.55  # half a metre ahead, 5 cm are left to the wall
    rehearsal = rehearsed(fleet({"a": roomba(start_m, 0)}), scenario)
    assert told(rehearsal) == [("a", "the east wall", False)] * 2
    assert [incident.steps[0].label for incident in rehearsal.incidents] == ["send_cmd Base f0.5"] * 2


def test_nothing_is_missed_between_two_looks() -> None:
    """Checking every robot at every tick finds the same approaches, to the last bit."""

    class Unresting(ProximityRecorder):
        looks = 0

        def observe(self, *arguments: Any) -> float:
            self.looks += 1
            super().observe(*arguments)
            return math.inf

    class Counting(Unresting):
        def observe(self, *arguments: Any) -> float:
            self.looks += 1
            return ProximityRecorder.observe(self, *arguments)

    world = load_world(bundled_path("fleets/worlds/lab.yaml"))
    seen: list[Unresting] = []
    for approaches in (Unresting(0.05), Counting(0.05)):
        clock = ManualClock()
        services = FleetServices(clock, 3, world)
        services.proximity_observer = approaches
        bases = []
        for number in range(6):
            settings = sim.Settings.model_validate({"model": ("evbot2", "evbot3", "roomba")[number % 3]})
            context = PluginContext(f"r{number}", "sim", settings, services)
            bases.append(sim.connect(context).makers["Base"]())
        for round_number in range(12):
            drives = [
                base.send_cmd(("f0.9", "l130", "b0.4", "r75")[(round_number + number) % 4])
                for number, base in enumerate(bases)
            ]
            for drive in drives:
                next(drive)
            clock.advance(4.0)
            for base in bases:
                base.halt()
        seen.append(approaches)
    every, some = seen
    assert every.events == some.events
    assert every.nearest == some.nearest
    assert every.events
    assert some.looks < every.looks


def test_a_real_robot_is_stood_in_for_by_its_model(fleet: Callable[..., Path]) -> None:
    file = fleet(
        {
            "track": "evbot2: {port: /dev/no-such-port}, camera: {source: 0}",
            "wheels": "evbot3: {address: 'udp://192.0.2.1:5000'}",
            "vacuum": "roomba: {protocol: sci, port: /dev/no-such-port}",
            "later": "roomba: {protocol: oi, port: /dev/no-such-port}",
        }
    )
    config = of(file)
    twins = simulated(config, config.robots)
    models = {name: robot.plugins["sim"].settings["model"] for name, robot in twins.config.robots.items()}
    assert models == {"track": "evbot2", "wheels": "evbot3", "vacuum": "roomba", "later": "roomba"}
    assert all(set(robot.plugins) == {"sim"} for robot in twins.config.robots.values())
    assert set(twins.replaced) == set(config.robots)
    assert rehearse(moves(track="f0.3", vacuum="l90"), twins, 0.05, 1).is_clear


def test_a_driver_on_a_simulated_port_stays_and_its_body_goes_by_its_name(fleet: Callable[..., Path]) -> None:
    body = roomba(2.0, 0.0).replace("noise: false, ", "")  # as the port has it too
    file = fleet({"a": "roomba: {protocol: sci, link: sim, port: 'sim://world/body'}", "body": body})
    twins = simulated(of(file), ["a", "body"])
    assert set(twins.config.robots["a"].plugins) == {"roomba"}
    rehearsal = rehearse(moves(a="f1.5"), twins, 0.05, 0)
    assert ("a", "the east wall", True) in told(rehearsal)
    assert [step.robot for step in rehearsal.incidents[0].steps] == ["a"]


def test_a_camera_above_the_simulated_floor_stays() -> None:
    twins = simulated(EALConfigManager.load("arena").fleet, ["cameras-1", "roomba-1"])
    assert set(twins.config.robots["cameras-1"].plugins) == {"tracker"}
    assert "cameras-1" not in twins.bodies
    assert not twins.left_out


def test_what_cannot_be_simulated_is_refused_where_it_is_needed_and_left_out_where_not(
    fleet: Callable[..., Path],
) -> None:
    config = of(fleet({"a": roomba(0, 0) + ", system: {}", "b": "sample: {}"}))
    with pytest.raises(ConfigError) as refused:
        simulated(config, ["a", "b"])
    (problem,) = refused.value.problems
    assert (Path(problem.file).name, problem.line, problem.path) == ("fleet.yaml", 6, "robots.b.plugins.sample")
    assert "cannot be simulated: no twin is declared for sample; plugins with a twin: evbot2" in problem.message

    twins = simulated(config, ["a"])
    assert (set(twins.config.robots), set(twins.config.robots["a"].plugins)) == ({"a"}, {"sim"})
    assert set(twins.left_out) == {"a", "b"}

    kept = simulated(config, ["a", "b"], keep=["sample", "system"])
    assert {name: set(robot.plugins) for name, robot in kept.config.robots.items()} == {
        "a": {"sim", "system"},
        "b": {"sample"},
    }


def test_a_twin_that_is_not_installed_is_named_with_the_plugin_whose_manifest_names_it(tmp_path: Path) -> None:
    write_plugin(tmp_path, "lift", "", "Base")
    manifest = tmp_path / "plugins/lift/plugin.yaml"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"twin": {"plugin": "sims"}}))
    file = tmp_path / "fleet.yaml"
    file.write_text(
        "version: 1\nplugin_dirs: [plugins]\nrobots:\n"
        "  a: {plugins: {sim: {model: roomba}}}\n  b: {plugins: {lift: {}}}\n"
    )
    with pytest.raises(ConfigError) as refused:
        simulated(of(file), ["a", "b"])
    (problem,) = refused.value.problems
    assert (problem.line, problem.path) == (5, "robots.b.plugins.lift")
    reason = "cannot be simulated: the manifest of lift names a twin that is not installed: unknown plugin 'sims'"
    assert problem.message == f"{reason}; did you mean 'sim'?"
    assert simulated(of(file), ["a"]).left_out == {"b": problem.message}


def test_robots_of_other_processes_are_rehearsed_in_this_one() -> None:
    config = of(bundled_path("fleets/loopback.yaml"))
    twins = simulated(config, config.robots)
    assert all(robot.address is None for robot in twins.config.robots.values())
    assert rehearse(load_scenario(bundled_path("scenarios/dance.yaml")), twins, 0.1, 7).is_clear


# The command.


@pytest.fixture
def eal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.delenv("EAL_FLEET", raising=False)
    yield lambda *arguments: CliRunner().invoke(app, ["rehearse", *map(str, arguments)])
    structlog.reset_defaults()  # it still refers to the captured stderr


COLLIDE = """\
version: 1
name: collide
parameters:
  metres: {type: double, unit: m, default: 0.3, minimum: 0, maximum: 3}
roles: {a: {robots: [a]}}
steps:
  - on: a
    do:
      - send_cmd: {resource: Base, cmd: "f${metres}"}
"""


def test_the_command_says_who_hit_what_when_where_and_doing_what(
    eal: Callable[..., Result], fleet: Callable[..., Path], tmp_path: Path
) -> None:
    file, scenario = fleet({"a": roomba(-0.5, 0.0), "b": roomba(0.5, 0.0)}), tmp_path / "collide.yaml"
    scenario.write_text(COLLIDE)

    clear = eal(scenario, "--fleet", file)
    assert clear.exit_code == 0, clear.output
    assert clear.stdout.splitlines()[-1] == "collide on trial, seeds 0, 1, 2: clear: no gap is smaller than 0.1 m"

    hit = eal(scenario, "--fleet", file, "--set", "metres=1", "--seed", 5)
    assert hit.exit_code == 1
    lines = hit.stdout.splitlines()
    assert lines[-1] == "collide on trial, seed 5: 1 hit, 1 run not done"
    assert lines[-2].endswith(f"seed 5  a hits b at x 0.16 m, y 0.00 m during a send_cmd Base f1 ({scenario}:9)")

    told_as_json = eal(scenario, "--fleet", file, "--set", "metres=1", "--seeds", 2, "--margin", 0.2, "--json")
    assert told_as_json.exit_code == 1
    content = json.loads(told_as_json.stdout)
    assert (content["is_clear"], content["margin_m"], content["parameters"]) == (False, 0.2, {"metres": 1.0})
    assert [run["seed"] for run in content["runs"]] == [0, 1]
    (incident,) = content["runs"][0]["incidents"]
    assert (incident["is_hit"], incident["steps"][0]["line"]) == (True, 9)


def test_a_run_that_is_not_done_is_not_clear(
    eal: Callable[..., Result], fleet: Callable[..., Path], tmp_path: Path
) -> None:
    file, scenario = fleet({"a": roomba(0, 0)}), tmp_path / "wrong.yaml"
    scenario.write_text(COLLIDE + "      - expect: 1 > 2\n")
    result = eal(scenario, "--fleet", file, "--seeds", 1)
    assert result.exit_code == 1
    assert "seed 0: failed: expected 1 > 2 to be true" in result.stdout
    assert result.stdout.splitlines()[-1].endswith("1 run not done")


def test_the_command_refuses_what_it_cannot_rehearse(
    eal: Callable[..., Result], fleet: Callable[..., Path], tmp_path: Path
) -> None:
    file, scenario = fleet({"a": "sample: {}"}), tmp_path / "collide.yaml"
    scenario.write_text(COLLIDE)
    result = eal(scenario, "--fleet", file)
    assert result.exit_code == 2
    assert f"{file}:5:" in result.stderr
    assert eal(scenario, "--fleet", file, "--seeds", 2, "--seed", 1).exit_code == 2


FORMATION = """
version: 1
name: trial
roles: {pair: {}}
steps:
  - formation: {role: pair, shape: line, spacing_m: 3, at: [1.5, 0, 0]}
"""


def test_an_approach_in_a_formation_names_its_step(fleet: Callable[..., Path]) -> None:
    config = of(fleet({"a": roomba(0, 0.8), "b": roomba(0, -0.8)}))
    rehearsal = rehearse(parse_scenario(FORMATION, "trial.yaml"), simulated(config, ["a", "b"]), 0.4, 0)
    assert {nearest for nearest, *_ in told(rehearsal)} == {"a", "b"}  # of the walls
    assert {step.label for incident in rehearsal.incidents for step in incident.steps} == {"formation pair line"}
