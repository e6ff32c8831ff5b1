"""LiveRecord: a fleet is recorded while others command it, and nothing is halted."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.errors import ScenarioError
from eal_actors.recording import LiveRecord, RunFolder
from eal_actors.scenario import RobotLost, RobotReturned, RunEvent, load_scenario
from tests.net.rig import WAIT_S, Rig, ready, serving


def test_another_controllers_motion_goes_on_after_the_record_and_losses_are_in_it(tmp_path: Path) -> None:
    rig, folder = Rig(tmp_path, ["r1", "r2"]), tmp_path / "record"
    folder.mkdir()
    heard = {kind.kind: threading.Event() for kind in (RobotLost, RobotReturned)}

    def listen(event: RunEvent) -> None:
        if event.kind in heard:
            heard[event.kind].set()

    with serving(rig.file, "r1", "r2") as servers, ready(Fleet(rig.config)) as driving:
        motion = driving["r1"]["Arm"].send_cmd("move1000")
        assert rig.begun("move1000")
        with ready(Fleet(rig.config)) as watching, LiveRecord(watching, folder, "sensors", [listen]):
            servers["r2"].kill()
            assert heard[RobotLost.kind].wait(WAIT_S)
            servers.start("r2")
            assert heard[RobotReturned.kind].wait(WAIT_S)
        assert not motion.done()
        assert rig.notes("end", "halt", robot="r1") == []
        driving["r1"]["Arm"].halt().get(timeout=WAIT_S)
    run = RunFolder.open(folder)
    assert [event["event"] for event in run.events] == ["run_started", "robot_lost", "robot_returned", "run_ended"]
    assert run.summary is not None
    (loss,) = run.summary.robots["r2"].losses
    assert loss.back_s is not None
    assert loss.lost_s < loss.back_s <= run.summary.duration_s
    assert run.record.is_complete
    assert load_scenario(folder / "scenario.yaml").name == "record"


def test_a_folder_with_a_record_stays_as_it_is(tmp_path: Path) -> None:
    with Fleet.load("sim").connect(["roomba-1"]) as fleet:
        with LiveRecord(fleet, tmp_path, "poses"):
            pass
        before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
        (tmp_path / "fleet.yaml").write_text("kept")
        with pytest.raises(ScenarioError, match="already has the record of a run"):
            LiveRecord(fleet, tmp_path, "poses")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before | {"fleet.yaml": b"kept"}


def test_a_folder_that_vanishes_is_reported_and_no_thread_is_left(tmp_path: Path) -> None:
    folder = tmp_path / "record"
    folder.mkdir()
    with (
        Fleet.load("sim").connect(["roomba-1"]) as fleet,
        pytest.raises(ScenarioError, match=r"record cannot be written: No such file or directory"),
        LiveRecord(fleet, folder, "poses"),
    ):
        shutil.rmtree(folder)


class WatchedLock:
    """A lock that tells when a second thread comes to it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.is_wanted = threading.Event()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            self.is_wanted.set()
            self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def test_a_loss_at_the_end_is_in_the_summary_if_it_is_in_the_events(tmp_path: Path) -> None:
    """It was in the events only, and a later one was reported after the end."""
    lock, is_heard, heard = WatchedLock(), threading.Event(), []

    def listen(event: RunEvent) -> None:
        heard.append(event.kind)
        if event.kind == RobotLost.kind:
            is_heard.set()
            assert lock.is_wanted.wait(WAIT_S)

    with Fleet.load("sim").connect(["roomba-1"]) as fleet:
        with LiveRecord(fleet, tmp_path, "poses", [listen]) as record:
            record._lock = lock  # type: ignore[assignment]
            robot = threading.Thread(target=record._note, args=("roomba-1", RobotState.LOST))
            robot.start()
            assert is_heard.wait(WAIT_S)
        robot.join()
        record._note("roomba-1", RobotState.READY)  # its thread was at it when the record ended
    run = RunFolder.open(tmp_path)
    assert [event["event"] for event in run.events] == heard == ["run_started", "robot_lost", "run_ended"]
    assert run.summary is not None
    assert [loss.back_s for loss in run.summary.robots["roomba-1"].losses] == [None]
