"""Several robots of one process: `eal serve` with more than one robot, in one simulated world."""

from __future__ import annotations

import math
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService, serve_together
from eal_actors.kernel.errors import ConfigError, UnsupportedError
from eal_actors.wire.session import open_session, router_config
from eal_actors.wire.transport import Transport
from tests.net.links import free_port
from tests.net.rig import WAIT_S, Rig, becomes, hold_calls, process, ready


def rig_of(folder: Path) -> Rig:
    """Return two simulated robots that face each other, 0.2 m apart."""
    rig = Rig(folder, ("r1", "r2"), extra={"clock": {"rate": 1}})
    for name, x_m, yaw_deg in (("r1", -0.3, 0), ("r2", 0.3, 180)):
        start = {"x_m": x_m, "y_m": 0.0, "yaw_deg": yaw_deg}
        rig.content["robots"][name]["plugins"] = {"sim": {"model": "roomba", "noise": False, "start": start}}
    rig.write()
    return rig


@pytest.mark.slow
def test_robots_of_one_process_meet_in_one_world(tmp_path: Path) -> None:
    rig = rig_of(tmp_path)
    command = ["-m", "eal_actors", "serve", "--fleet", str(rig.file), "-r", "r1", "-r", "r2"]
    with process(command, tmp_path) as server, Fleet(rig.config) as fleet:
        for name in ("r1", "r2"):
            server.wait_for(f"{name} serves")
            assert becomes(fleet[name], RobotState.READY), server.lines
        fleet["r1"]["Base"].send_cmd("f0.5").exception()  # it pushes against the other robot, or is stopped by it
        x_m, y_m, _ = fleet["r1"]["TruePose"].get_value().get().value
        assert math.hypot(x_m, y_m) < 0.29, "the other robot is in its way"
        server.signal(signal.SIGTERM)
        assert server.wait() == 0


@pytest.mark.parametrize("behind", [None, "router"])
def test_a_call_of_many_robots_costs_one_message_for_each_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, behind: str | None
) -> None:
    groups = [[f"{letter}{number}" for number in range(1, 5)] for letter in "abc"]
    names = [name for group in groups for name in group]
    router = f"tcp/127.0.0.1:{free_port()}"
    entries = [f"{letter}{{n}}" for letter in "abc"]  # with one address each
    rig = Rig(tmp_path, entries, {"routers": [router]} if behind else {"shared_memory": False}, behind=behind)
    for entry in rig.content["robots"].values():
        entry["count"] = 4
    rig.write()
    sent: list[str] = []
    put = Transport.put

    def count(transport: Transport, key: str, *arguments: Any, **options: Any) -> bool:
        if "/Arm/" in key:
            sent.append(key)
        return put(transport, key, *arguments, **options)

    monkeypatch.setattr(Transport, "put", count)
    with ExitStack() as stack:
        if behind is not None:
            stack.enter_context(open_session(router_config([router], fleet=rig.config)))
        for group in groups:  # each like a process: it has a session of its own
            services = stack.enter_context(serve_together(rig.config, group))
            assert [service.robot.name for service in services] == group
        fleet = stack.enter_context(ready(Fleet(rig.config)))
        for step in range(3):
            sent.clear()
            gate = hold_calls(fleet[names[0]])
            poses = fleet.read(fleet, "Arm")
            gate.set()
            assert list(poses.get(timeout=WAIT_S)) == names
            assert len(sent) == len(groups)
            sent.clear()
            gate = hold_calls(fleet[names[0]])
            steps = fleet.send(fleet, "Arm", f"step{step}")
            gate.set()
            assert steps.get(timeout=WAIT_S) == dict.fromkeys(names, step)
            assert len(sent) == len(groups)
        assert all(fleet[name]["Arm"].send_cmd("step9").get(timeout=WAIT_S) == 9 for name in names)
    assert all([note.what for note in rig.notes("step", robot=name)] == ["0", "1", "2", "9"] for name in names)


def test_what_robots_of_one_process_cannot_do_is_refused(tmp_path: Path) -> None:
    rig = rig_of(tmp_path)
    with serve_together(rig.config, ["r1", "r2"]) as (one, other):
        assert one.endpoints != other.endpoints
        with pytest.raises(UnsupportedError, match="restart `eal serve`"):
            one.reload()
    with pytest.raises(ConfigError, match="has no address"), RobotService(rig.local(), "r1"):
        pass
