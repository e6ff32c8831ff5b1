"""Fleet.read and Fleet.send: one call to many robots, one future of all answers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.errors import (
    ArgumentError,
    CallCancelledError,
    DataError,
    DeadlineError,
    ResourceNotFoundError,
    RobotNotFoundError,
)

FLEET = """\
version: 1
clock: {rate: max}
world: hall.yaml
robots:
  "robot{n}": {count: 3, plugins: {sim: {model: roomba, noise: false}}}
  evbot: {plugins: {sim: {model: evbot3, noise: false}}}
"""
NAMES = ["robot1", "robot2", "robot3"]


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    file = tmp_path / "fleet.yaml"
    file.write_text(FLEET)
    starts = ", ".join(f"{{x_m: -10, y_m: {3 * row}}}" for row in range(4))  # nobody is in anybody's way
    (tmp_path / "hall.yaml").write_text(f"version: 1\nname: hall\nsize_m: [40, 40]\nstarts: [{starts}]\n")
    with Fleet.load(file) as fleet:
        yield fleet


def test_values_and_statuses_come_by_robot(fleet: Fleet) -> None:
    before = fleet.read(fleet, "Pose").get()
    assert list(before) == [*NAMES, "evbot"]
    assert fleet.send(NAMES, "Base", "f0.3").get() == dict.fromkeys(NAMES, 1)
    after = fleet.read([fleet["robot2"], "robot1"], "Pose").get()
    assert list(after) == ["robot2", "robot1"]
    assert list(fleet.read("robot1", "Pose").get()) == ["robot1"]
    assert list(fleet.read(fleet["robot1"], "Pose").get()) == ["robot1"]  # not its resources
    for name, pose in after.items():
        assert pose.value[0] - before[name].value[0] == pytest.approx(0.3, abs=1e-6)


def test_what_cannot_be_called_is_refused_before_anything_is_sent(fleet: Fleet) -> None:
    with pytest.raises(ResourceNotFoundError, match="evbot"):
        fleet.send(fleet, "Song", "play 1")
    with pytest.raises(ArgumentError, match="twice"):
        fleet.send(["robot1", fleet["robot1"]], "Base", "f0.3")
    with pytest.raises(RobotNotFoundError):
        fleet.read(["robot1", "robot9"], "Pose")
    assert all(not robot.running for robot in fleet.values())
    assert fleet.read([], "Pose").get() == {}


def test_what_is_no_text_is_no_command_request_or_key(fleet: Fleet) -> None:
    base: Any = fleet["robot1"]["Base"]
    for call in (base.send_cmd(5), base.send_req(5), base.get_config(5), base.set_config(5, 1)):
        with pytest.raises(ArgumentError, match=r"robot1/Base: unknown .* 5: it must be a text"):
            call.get()


def test_errors_fail_the_future_or_take_a_values_place(fleet: Fleet) -> None:
    fleet["robot2"]["Faults"].set_config("dead", True).get()  # its link is cut
    with pytest.raises(DeadlineError, match="robot2/Range"):
        fleet.read(NAMES, "Range", timeout_s=1).get()
    answers = fleet.read(NAMES, "Range", return_exceptions=True, timeout_s=1).get()
    assert [isinstance(answer, DeadlineError) for answer in answers.values()] == [False, True, False]


def test_cancelling_cancels_every_command(fleet: Fleet) -> None:
    driving = fleet.send(NAMES, "Base", "f2", timeout_s=60)
    fleet.clock.sleep(0.5)
    assert driving.cancel()
    with pytest.raises(CallCancelledError):
        driving.get()
    fleet.clock.sleep(0.1)
    first = fleet.read(NAMES, "Pose").get()
    fleet.clock.sleep(1.0)
    second = fleet.read(NAMES, "Pose").get()
    assert {name: list(pose.value) for name, pose in first.items()} == {
        name: list(pose.value) for name, pose in second.items()
    }


def test_the_default_deadline_follows_the_length_of_a_motion(fleet: Fleet) -> None:
    base = fleet["robot1"]["Base"]
    started_s = fleet.clock.now()
    assert base.send_cmd("f4").get() == 1
    assert fleet.clock.now() - started_s > 10.0  # the fleet file's timeout_s
    assert fleet.send(["robot2", "robot3"], "Base", "f4").get() == {"robot2": 1, "robot3": 1}
    with pytest.raises(DeadlineError):
        base.send_cmd("f4", timeout_s=10.0).get()


def test_the_default_deadline_follows_the_speed_that_is_set(fleet: Fleet) -> None:
    base = fleet["robot1"]["Base"]
    assert base.set_config("speed_m_s", 0.05).get() == 1
    started_s = fleet.clock.now()
    assert base.send_cmd("f2").get() == 1
    assert fleet.clock.now() - started_s > 2 / 0.05  # more than at the usual speed, with its allowance
    base.set_config("speed_m_s", 0.3).get()
    assert base.info.takes_s("f2") == pytest.approx(2 * 2 / 0.3)


@pytest.mark.parametrize(
    ("command", "takes_s"),
    [("f3", 20.0), ("l90", 2.0), ("r-90", 2.0), ("f", 0.0), ("g", 0.0), ("fast", 0.0), ("goto", 110.0)],
)
def test_a_base_tells_what_its_motions_take(fleet: Fleet, command: str, takes_s: float) -> None:
    info = fleet["evbot"]["Base"].info
    assert info.takes_s(command) == pytest.approx(takes_s, rel=0.5)
    assert ResourceInfo.from_dict(info.to_dict()).takes_s(command) == info.takes_s(command)


def test_a_value_that_cannot_be_sent_lets_no_robot_begin(fleet: Fleet) -> None:
    with pytest.raises(DataError):
        fleet.together({fleet["robot1"]["Base"]: "f1", fleet["robot2"]["Base"]: ("f", object())})
    fleet.clock.sleep(1)
    assert fleet["robot1"].running == ()
    assert fleet["robot1"]["Base"].get_status().get() == 0
