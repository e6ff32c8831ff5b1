"""LiveRecord: a fleet is recorded while others command it, and nothing is halted."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest

from eal_actors import Fleet
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
