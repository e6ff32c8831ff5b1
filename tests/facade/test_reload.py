"""fleet.reload: robots added, removed, re-configured and re-addressed while the others continue."""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.errors import (
    ConfigError,
    PreemptedError,
    ResourceNotFoundError,
    RobotFailedError,
    RobotNotFoundError,
    UnavailableError,
)
from eal_actors.managers.fleet_changes import FleetChanges
from tests.plugin_files import write_plugin

PLUGIN = '''
from eal_actors.plugin import *

class Settings(PluginSettingsModel):
    speed: float = 1.0
    has_arm: bool = False

class Base(Resource):
    """A base that drives until it is stopped."""
    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.DOUBLE)
    def __init__(self, speed):
        self.speed = speed
        self.halts = 0
    def get_value(self):
        return self.speed
    def get_status(self):
        return self.halts
    @command("drive")
    def drive(self):
        while True:
            yield 1.0
    def halt(self):
        self.halts += 1

class Arm(Resource):
    """An arm."""
    def get_value(self):
        return 1.0

def connect(context):
    return EALPlugin("Base", "Arm") if context.settings.has_arm else EALPlugin("Base")
def create_Base(context): return Base(context.settings.speed)
'''


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write the fleet file."""
    write_plugin(tmp_path, "mover", PLUGIN, "Base", "Arm")

    def write_fleet(robots: str, top: str = "") -> Path:
        file = tmp_path / "fleet.yaml"
        file.write_text(f"version: 1\nplugin_dirs: [plugins]\n{top}robots:\n{robots}", encoding="utf-8")
        return file

    return write_fleet


Write = Callable[..., Path]
TWO = "  one: {plugins: {mover: {}}}\n  two: {plugins: {mover: {}}}\n"


def test_a_robot_is_added_while_another_drives_on(write: Write) -> None:
    with Fleet.load(write("  one: {plugins: {mover: {}}}\n")) as fleet:
        drive = fleet["one"]["Base"].send_cmd("drive")
        fleet["one"]["Base"].get_value().get()
        write(TWO)
        assert fleet.reload() == FleetChanges(added=("two",))
        assert fleet["two"]["Base"].get_value().get().value == 1.0
        assert list(fleet) == ["one", "two"]
        assert fleet["one"].running[0].command == "drive"
        assert not drive.done()
        assert fleet["one"]["Base"].get_status().get() == 0  # never halted
        assert [robot.name for robot in fleet.select(["two"])] == ["two"]


def test_a_removed_robot_is_halted_and_gone(write: Write) -> None:
    with Fleet.load(write(TWO)) as fleet:
        two, drive, other = fleet["two"], fleet["two"]["Base"].send_cmd("drive"), fleet["one"]["Base"].send_cmd("drive")
        two["Base"].get_value().get()
        base = two.get("Base")
        assert base is not None
        resource = base.resource()
        write("  one: {plugins: {mover: {}}}\n")
        assert fleet.reload() == FleetChanges(removed=("two",))
        assert isinstance(drive.exception(), PreemptedError)
        assert isinstance(base.get_value().exception(), UnavailableError)
        assert resource.halts > 0  # type: ignore[attr-defined]  # the plugin's own
        assert two.state is RobotState.STOPPED
        with pytest.raises(RobotNotFoundError, match="unknown robot 'two'"):
            _ = fleet["two"]
        fleet["one"]["Base"].get_value().get()
        assert not other.done()


def test_a_robot_is_configured_anew_and_keeps_its_handle(write: Write) -> None:
    with Fleet.load(write(TWO)) as fleet:
        two, former = fleet["two"], fleet["two"]["Base"]
        seen: list[RobotState] = []
        forget = two.on_state(seen.append)
        drive = fleet["one"]["Base"].send_cmd("drive")
        write("  one: {plugins: {mover: {}}}\n  two: {tags: [fast], plugins: {mover: {speed: 2.5, has_arm: true}}}\n")
        assert fleet.reload() == FleetChanges(restarted=("two",))
        assert fleet["two"] is two
        assert two["Base"].get_value().get().value == 2.5
        assert two["Arm"].get_value().get().value == 1.0
        assert fleet.select(tags=["fast"]) == [two]
        assert isinstance(former.get_value().exception(), UnavailableError)
        assert [state for state in seen if state is not RobotState.STARTING] == [
            RobotState.READY,
            RobotState.STOPPED,
            RobotState.READY,
        ]
        forget()
        write(TWO)
        fleet.reload()
        assert seen.count(RobotState.READY) == 2  # not called any more
        assert "Arm" not in two
        assert not drive.done()


def test_tags_change_without_a_restart(write: Write) -> None:
    with Fleet.load(write(TWO)) as fleet:
        drive = fleet["two"]["Base"].send_cmd("drive")
        write(
            "  one: {plugins: {mover: {}}}\n  two: {type: cart, plugins: {mover: {}}}\n", "types: {cart: {tags: [t]}}\n"
        )
        assert fleet.reload() == FleetChanges(relabelled=("two",))
        assert (fleet["two"].type, fleet["two"].tags) == ("cart", ("t",))
        assert fleet.select(types=["cart"]) == [fleet["two"]]
        fleet["two"]["Base"].get_value().get()
        assert not drive.done()


def test_a_robot_with_another_start_is_connected_anew(write: Write) -> None:
    with Fleet.load(write(TWO)) as fleet:
        write(TWO.replace("two: {", "two: {pose: {start: {x_m: 1, y_m: 2}}, "))
        assert fleet.reload() == FleetChanges(restarted=("two",))


def test_an_unchanged_file_changes_nothing(write: Write) -> None:
    with Fleet.load(write(TWO)) as fleet:
        drive = fleet["two"]["Base"].send_cmd("drive")
        assert str(fleet.reload()) == "nothing changed"
        assert not drive.done()


def test_an_emergency_stop_outlives_the_restart(write: Write) -> None:
    with Fleet.load(write(TWO)) as fleet:
        fleet["two"].stop("a person in the way").get()
        write("  one: {plugins: {mover: {}}}\n  two: {plugins: {mover: {speed: 2}}}\n")
        fleet.reload()
        assert fleet["two"].stopped_because == "a person in the way"
        assert "a person in the way" in str(fleet["two"]["Base"].send_cmd("drive").exception())
        fleet["two"].resume().get()
        assert not fleet["two"]["Base"].send_cmd("drive", timeout_s=100).done()


@pytest.mark.parametrize(
    ("robots", "top", "problem"),
    [
        (TWO, "name: other\n", r"fleet\.yaml:3:7: name: 'name' cannot change while the fleet is open"),
        (TWO, "seed: 4\n", r"fleet\.yaml:3:7: seed: 'seed' cannot change"),
        (TWO, "clock: {rate: 2}\n", r"fleet\.yaml:3:15: clock\.rate: 'clock\.rate' cannot change"),
        (TWO, "world: lab\n", r"fleet\.yaml:3:8: world: 'world' cannot change"),
        ("  two: {plugins: {mover: {speed: fast}}}\n", "", r"fleet\.yaml:4:34: robots\.two\.plugins\.mover\.speed"),
        ("  two: {plugins: {moover: {}}}\n", "", r"fleet\.yaml:4:19: .*unknown plugin 'moover'"),
        ("  two: {plugins: {mover: {}}\n", "", r"fleet\.yaml:5:3: a .,. or .}. is missing"),
        ("  two: {typ: x}\n", "", r"fleet\.yaml:4:9: robots\.two\.typ"),
    ],
)
def test_what_cannot_change_is_refused_by_place_and_nothing_changes(
    write: Write, robots: str, top: str, problem: str
) -> None:
    with Fleet.load(write(TWO)) as fleet:
        drives = [robot["Base"].send_cmd("drive") for robot in fleet.values()]
        before = fleet.config
        write(robots + "  three: {plugins: {mover: {}}}\n", top)
        with pytest.raises(ConfigError, match=problem):
            fleet.reload()
        assert fleet.config is before
        assert list(fleet) == ["one", "two"]
        for robot, drive in zip(fleet.values(), drives, strict=True):
            assert robot["Base"].get_value().get().value == 1.0
            assert not drive.done()
        write(TWO)
        assert fleet.reload() == FleetChanges()


def test_every_problem_is_named_at_once(write: Write) -> None:
    with Fleet.load(write(TWO)) as fleet:
        write(TWO, "name: other\nseed: 4\n")
        with pytest.raises(ConfigError) as refused:
            fleet.reload()
        assert [problem.path for problem in refused.value.problems] == ["name", "seed"]


def test_a_closed_fleet_is_not_reloaded(write: Write) -> None:
    fleet = Fleet.load(write(TWO))
    with pytest.raises(UnavailableError, match="not connected"):
        fleet.reload()


def test_the_file_keeps_its_environment(write: Write) -> None:
    file = write("  one: {plugins: {mover: {}}, tags: ['${ROOM}']}\n")
    with Fleet.load(file, environment={"ROOM": "lab"}) as fleet:
        write("  one: {plugins: {mover: {}}, tags: ['${ROOM}', more]}\n")
        assert fleet.reload().relabelled == ("one",)
        assert fleet["one"].tags == ("lab", "more")


def test_robots_that_were_left_out_stay_so(write: Write) -> None:
    with Fleet.load(write(TWO)).connect(["one"]) as fleet:
        write("  one: {plugins: {mover: {}}}\n  two: {plugins: {mover: {speed: 3}}}\n")
        fleet.reload()
        assert list(fleet) == ["one"]
        assert fleet.connect()["two"]["Base"].get_value().get().value == 3.0


def test_a_robot_that_does_not_start_leaves_the_others_alone(write: Write, tmp_path: Path) -> None:
    write_plugin(
        tmp_path, "broken", "from eal_actors.plugin import *\ndef connect(): raise OSError('no such port')\n", "X"
    )
    with Fleet.load(write(TWO)) as fleet:
        drive = fleet["one"]["Base"].send_cmd("drive")
        write(TWO + "  three: {plugins: {broken: {}}}\n")
        assert fleet.reload().added == ("three",)
        assert "no such port" in str(fleet["three"].problems[-1])
        with pytest.raises(RobotFailedError, match="no such port"):
            fleet["three"].require_started()
        assert not drive.done()
        write(TWO + "  three: {plugins: {mover: {}}}\n")
        assert fleet.reload().restarted == ("three",)
        assert fleet["three"].state is RobotState.READY


@pytest.mark.parametrize("seed", [1])
def test_random_edits_disturb_no_robot_that_they_do_not_touch(write: Write, seed: int) -> None:
    dice = random.Random(seed)  # noqa: S311

    def text(speeds: dict[str, float]) -> str:
        return "".join(f"  {name}: {{plugins: {{mover: {{speed: {speed}}}}}}}\n" for name, speed in speeds.items())

    speeds = {"keep": 1.0, "a": 1.0}
    with Fleet.load(write(text(speeds))) as fleet:
        drives = {name: fleet[name]["Base"].send_cmd("drive", timeout_s=1e6) for name in fleet}
        for _ in range(20):
            edited = dict(speeds)
            for name in dice.choices("abcdef", k=3):
                if name in edited and dice.random() < 0.4:
                    del edited[name]
                else:
                    edited[name] = round(dice.uniform(1, 5), 2)
            is_refused = dice.random() < 0.3
            write(text(edited), "seed: 9\n" if is_refused else "")
            with pytest.raises(ConfigError) if is_refused else nullcontext():
                fleet.reload()
            touched = set() if is_refused else {name for name in drives if edited.get(name) != speeds.get(name)}
            speeds = speeds if is_refused else edited
            assert list(fleet) == list(speeds)
            assert {name for name, drive in drives.items() if drive.done()} == touched, seed
            for name, speed in speeds.items():
                assert fleet[name]["Base"].get_value().get().value == speed
                if name not in drives or name in touched:
                    drives[name] = fleet[name]["Base"].send_cmd("drive", timeout_s=1e6)
            drives = {name: drives[name] for name in speeds}


SIM = """
  scout: {{plugins: {{sim: {{model: roomba, start: {{x_m: 0, y_m: 0}}{more}}}}}}}
  mate: {{plugins: {{sim: {{model: evbot3, start: {{x_m: 1, y_m: 0}}}}}}}}
"""


@pytest.mark.parametrize("rate", ["20", "max"])
def test_simulated_robots(write: Write, rate: str) -> None:
    clock = f"clock: {{rate: {rate}}}\n"
    with Fleet.load(write(SIM.format(more="")[1:], clock)) as fleet:
        fleet["mate"]["Base"].send_cmd("f0.3").get()
        at = fleet["mate"]["TruePose"].get_value().get().value.tolist()
        write(SIM.format(more=", noise: false")[1:], clock)
        with pytest.raises(
            ConfigError, match=r"fleet\.yaml:5:.*noise: cannot change while the robot is in the simulated"
        ):
            fleet.reload()
        more = (
            SIM.format(more=", faults: []")[1:] + "  new: {plugins: {sim: {model: roomba, start: {x_m: -1, y_m: 0}}}}\n"
        )
        write(more, clock)
        assert fleet.reload() == FleetChanges(added=("new",), restarted=("scout",))
        fleet["new"]["Base"].send_cmd("f0.2").get()
        fleet["scout"]["Base"].send_cmd("r45").get()
        assert fleet["mate"]["TruePose"].get_value().get().value.tolist() == at
        write(SIM.format(more=", faults: []")[1:], clock)
        assert fleet.reload() == FleetChanges(removed=("new",))
        fleet["mate"]["Base"].send_cmd("r45").get()
        with pytest.raises(ResourceNotFoundError):
            _ = fleet["mate"]["Bas"]
