"""A simulated fleet that a test controls."""

from __future__ import annotations

import gc
import math
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path
from textwrap import indent

import pytest

from eal_actors.kernel.errors import (
    ArgumentError,
    ConfigError,
    EALError,
    PluginError,
    ResourceNotFoundError,
    RobotFailedError,
    RobotNotFoundError,
    ScenarioError,
    UnavailableError,
    WaitTimeoutError,
)
from eal_actors.testing import Pose, Simulation
from eal_actors.testing.simulation import read_scenario
from tests.scenario_texts import scenario_of

TURN = indent(scenario_of("{send_cmd: {resource: Base, cmd: l90}}", name="turn"), "    ")
ROOM = {"version": 1, "name": "room", "size_m": (6, 4)}


@pytest.fixture
def pair() -> Iterator[Simulation]:
    """Two robots without noise, 2 m apart, that look at each other."""
    robots = {
        "left": {"model": "roomba", "start": (-1.0, 0.0), "noise": False},
        "right": {"model": "evbot3", "start": (1.0, 0.0, 180), "noise": False},
    }
    with Simulation(robots, ROOM) as pair:
        yield pair


def test_robots_stand_where_they_were_put(pair: Simulation) -> None:
    assert pair.pose("left") == Pose(-1.0, 0.0, 0.0)
    assert pair.pose("right").yaw_rad == pytest.approx(math.pi)
    assert pair.distance_m("left", "right") == 2.0
    assert pair.distance_m("left", (-1.0, 0.5)) == 0.5


def test_time_stands_still_unless_it_is_moved(pair: Simulation) -> None:
    drive = pair["left"]["Base"].send_cmd("f0.5")
    assert [pair.pose("left") for _ in range(5)] == [Pose(-1.0, 0.0, 0.0)] * 5
    assert pair.now_s == 0.0
    assert not drive.done()

    pair.advance(0.25)
    assert -1.0 < pair.pose("left").x_m < -0.9

    pair.advance(30.0)
    assert pair.now_s == 30.25
    assert drive.done()
    assert pair.pose("left").x_m == pytest.approx(-0.5, abs=0.01)


def test_waiting_for_an_answer_takes_as_long_as_the_answer(pair: Simulation) -> None:
    pair["left"]["Base"].send_cmd("f0.5").get()
    assert pair.pose("left").x_m == pytest.approx(-0.5, abs=0.01)
    assert 0.5 < pair.now_s < 30.0


def test_a_condition_ends_the_advance(pair: Simulation) -> None:
    pair["left"]["Base"].send_cmd("f3")
    assert not pair.is_bumping("left")

    took_s = pair.advance_until(lambda: pair.is_bumping("left"))

    assert took_s == pytest.approx(pair.now_s)
    assert pair.is_bumping("left")
    assert 0.2 < pair.distance_m("left", "right") < 0.5


def test_a_condition_that_holds_takes_no_time(pair: Simulation) -> None:
    assert pair.advance_until(lambda: True, 0.0) == 0.0
    assert pair.now_s == 0.0


def test_a_condition_that_never_holds_tells_where_the_robots_are(pair: Simulation) -> None:
    def it_rains() -> bool:
        return False

    with pytest.raises(WaitTimeoutError) as caught:
        pair.advance_until(it_rains, 1.5)
    assert isinstance(caught.value, TimeoutError)
    assert str(caught.value) == (
        "the condition it_rains was not met within 1.5 s; 1.5 s since the start; "
        "left is at x -1.000 m, y 0.000 m, yaw 0.0 deg; right is at x 1.000 m, y 0.000 m, yaw 180.0 deg"
    )
    with pytest.raises(WaitTimeoutError, match=r"^the condition was not met within 0 s; "):
        pair.advance_until(lambda: False, 0)


def test_a_condition_is_asked_as_often_as_wanted(pair: Simulation) -> None:
    asked_s: list[float] = []

    def fifth_time() -> bool:
        asked_s.append(pair.now_s)
        return len(asked_s) == 5

    pair.advance_until(fifth_time, every_s=0.5)
    assert asked_s == [0.0, 0.5, 1.0, 1.5, 2.0]


@pytest.mark.parametrize("duration_s", [-0.1, math.nan, math.inf])
def test_time_goes_forward_by_finite_steps(pair: Simulation, duration_s: float) -> None:
    for call in (
        lambda: pair.advance(duration_s),
        lambda: pair.advance_until(lambda: True, duration_s),
        lambda: pair.advance_until(lambda: True, every_s=duration_s),
    ):
        with pytest.raises(ArgumentError, match=r"_s must be at least 0 and finite, not (-0\.1|nan|inf)$"):
            call()
    with pytest.raises(ArgumentError, match=r"^every_s must be over 0"):
        pair.advance_until(lambda: True, every_s=0)


def test_a_scenario_runs_from_text_from_a_file_and_ready_made(pair: Simulation, tmp_path: Path) -> None:
    file = tmp_path / "turn.yaml"
    file.write_text(TURN)

    reports = [pair.run(TURN), pair.run(file), pair.run(str(file)), pair.run(read_scenario(TURN))]

    assert [report.outcome for report in reports] == ["done"] * 4
    assert [report.scenario_file for report in reports] == ["scenario", str(file), str(file), "scenario"]
    assert (reports[0].fleet, reports[0].rate) == ("simulation", "max")
    assert pair.pose("left").yaw_rad == pytest.approx(0.0, abs=0.05)
    assert pair.now_s >= sum(report.duration_s for report in reports)


def test_what_is_wrong_with_a_text_is_told_by_its_lines(pair: Simulation) -> None:
    with pytest.raises(ConfigError, match=r"\nscenario:8:37: steps\[0\]\.do\[0\]\.send_cmd\.cm: unknown"):
        pair.run(TURN.replace("cmd: l90", "cm: l90"))
    with pytest.raises(
        ConfigError, match=r"^scenario:6:9: steps\[0\]\.on: there is no role 'nobody', so it is a robot"
    ):
        pair.run(TURN.replace("on: all", "on: nobody"))
    with pytest.raises(ConfigError, match=r"^no\.yaml: no such file$"):
        pair.run("no.yaml")


def test_a_run_keeps_its_files_where_it_is_told_to(pair: Simulation, tmp_path: Path) -> None:
    look = TURN.replace("send_cmd: {resource: Base, cmd: l90}", "get_value: {resource: Range}, save: seen.npy")

    assert pair.run(look, directory=tmp_path).outcome == "done"
    assert (tmp_path / "left" / "seen.npy").is_file()
    with pytest.raises(ScenarioError, match="give its run a `directory`"):
        pair.run(look)


def drive(seed: int) -> tuple[Pose, float]:
    with Simulation({"a": "roomba", "b": "evbot2"}, seed=seed) as simulation:
        for robot in "ab":
            simulation[robot]["Base"].send_cmd("r90")
        simulation.advance_until(lambda: simulation["a"]["Base"].get_status().get() == 0)
        simulation["a"]["Base"].send_cmd("f0.7").get()
        return simulation.pose("a"), simulation.now_s


def test_the_same_seed_gives_the_same_values_and_another_others() -> None:
    assert drive(3) == drive(3)
    assert drive(3)[0] != drive(4)[0]


def test_many_robots_advance_together() -> None:
    with Simulation({"r{n}": {"model": "roomba", "count": 12}}, {**ROOM, "size_m": (12, 12)}) as many:
        before = {name: many.pose(name) for name in many.fleet}
        for robot in many.fleet.values():
            robot["Base"].send_cmd("f0.1")
        many.advance(10)
        assert len(before) == 12
        assert all(many.distance_m(name, before[name][:2]) > 0.05 for name in before)


def test_controllers_in_threads_live_by_its_clock(pair: Simulation) -> None:
    seen_s: list[float] = []

    def control() -> None:
        for _ in range(3):
            pair.fleet.clock.sleep(2.0)
            seen_s.append(pair.now_s)

    pair.fleet.clock.start(threading.Thread(target=control, name="controller"))
    pair.advance(5.0)
    assert seen_s == [2.0, 4.0]
    pair.advance(1.0)
    pair.close()
    assert seen_s == [2.0, 4.0, 6.0]
    assert pair.threads_left(10.0) == ()


def test_a_closed_simulation_says_so() -> None:
    simulation = Simulation({"a": "roomba"})
    for call in (
        lambda: simulation.fleet,
        lambda: simulation["a"],
        lambda: simulation.advance(1.0),
        lambda: simulation.advance_until(lambda: True),
        lambda: simulation.pose("a"),
        lambda: simulation.run(TURN),
    ):
        with pytest.raises(UnavailableError, match=r"^the simulation is not open; use `with Simulation"):
            call()
    simulation.close()
    assert repr(simulation) == "<Simulation of a: closed>"


def test_opening_and_closing_twice_is_harmless() -> None:
    with Simulation({"a": "roomba"}) as simulation:
        assert simulation.open() is simulation
        assert repr(simulation) == "<Simulation of a: open>"
        simulation.close()
    assert simulation.threads_left(10.0) == ()


def test_opened_again_it_begins_anew() -> None:
    simulation = Simulation({"a": {"model": "roomba", "start": (0.5, 0.0), "noise": False}})
    for _ in range(2):
        with simulation:
            assert simulation.now_s == 0.0
            assert simulation.pose("a") == Pose(0.5, 0.0, 0.0)
            simulation["a"]["Base"].send_cmd("b0.2").get()


def test_who_keeps_a_closed_simulation_keeps_no_world() -> None:
    with Simulation({"a": "roomba"}) as simulation:
        world = weakref.ref(simulation.fleet.services)
        assert world() is not None
    simulation.threads_left(10.0)
    gc.collect()
    assert world() is None


def test_names_that_are_not_there(pair: Simulation) -> None:
    with pytest.raises(RobotNotFoundError, match="did you mean 'left'"):
        pair.pose("lefd")
    with (
        Simulation({"a": {"plugins": {"sample": {}}}}) as bare,
        pytest.raises(ResourceNotFoundError, match="'TruePose'"),
    ):
        bare.pose("a")


def test_a_fleet_of_other_plugins_runs_too() -> None:
    with Simulation({"a": {"plugins": {"sample": {}}}}) as bare:
        bare["a"]["SampleResource"].set_value(7).get()
        assert bare["a"]["SampleResource"].get_value().get().value == 7
        with pytest.raises(WaitTimeoutError, match=r" s; 1 s since the start$"):
            bare.advance_until(lambda: False, 1.0)


@pytest.mark.parametrize(
    ("robots", "error", "message"),
    [
        ({"a": "romba"}, ConfigError, r"^simulation: robots\.a\.plugins\.sim\.model: .*'romba'; did you mean 'roomba'"),
        ({"a": {"model": "roomba", "strat": (0, 0)}}, ConfigError, r"'strat'; did you mean 'start'"),
        ({"a": {"plugins": {"sampel": {}}}}, ConfigError, r"^simulation: robots\.a\.plugins\.sampel: .*'sample'"),
        ({"a": {"model": "roomba", "start": (9.0, 0.0)}}, RobotFailedError, r"^a: .* cannot start at x 9 m, y 0 m"),
        (
            {"a": {"model": "roomba", "start": (9.0, 0.0), "plugins": {"sample": {}}}},
            PluginError,
            r"^a: .* cannot start at x 9 m, y 0 m",
        ),
    ],
)
def test_robots_that_cannot_start_fail_the_test(
    robots: dict[str, str], error: type[EALError], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    simulation = Simulation(robots)
    with pytest.raises(error, match=message):
        simulation.open()
    assert simulation.threads_left(10.0) == ()
    capfd.readouterr()  # the robot's own log of it


def test_the_package_names_what_it_has() -> None:
    import eal_actors.testing as package

    assert [getattr(package, name).__name__ for name in package.__all__] == package.__all__
    with pytest.raises(AttributeError, match="no attribute 'Simulator'"):
        _ = package.Simulator
