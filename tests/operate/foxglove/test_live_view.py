"""The live view of a fleet, as a viewer that others could have written receives it."""

from __future__ import annotations

import json
import logging
import math
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME, wall_time
from eal_actors.kernel.errors import UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.operate.foxglove import LiveView
from eal_actors.recording import messages
from tests.operate.foxglove.viewer import RECEIVE_S, Viewer

ROUNDS = 10
"""Poses of each robot that a viewer waits for."""


def fleet_of(folder: Path, count: int = 1, **settings: Any) -> Fleet:
    file = folder / "fleet.yaml"
    plugin = {"model": "evbot2", **settings}
    (folder / "hall.yaml").write_text("version: 1\nname: hall\nsize_m: [20, 20]\n")
    content = {
        "version": 1,
        "name": "live",
        "world": "hall.yaml",
        "robots": {"r{n}": {"count": count, "plugins": {"sim": plugin}}},
    }
    file.write_text(json.dumps(content))
    return Fleet.load(file)


@pytest.mark.slow
def test_a_viewer_receives_a_hundred_robots_at_twenty_hertz(tmp_path: Path) -> None:
    """Each robot has a transform each 0.05 s, or fewer on a loaded machine; none comes twice."""
    with fleet_of(tmp_path, 100) as fleet, LiveView(fleet, port=0) as view, Viewer(view.url) as viewer:
        viewer.subscribe("/tf")
        times_s: dict[str, list[float]] = {}
        for shown in viewer.messages():
            for transform in shown.message["transforms"]:
                stamp = transform["timestamp"]
                times_s.setdefault(transform["child_frame_id"], []).append(stamp["sec"] + stamp["nsec"] / 1e9)
            if len(times_s) == 100 and min(map(len, times_s.values())) >= ROUNDS:
                break
    for times in times_s.values():
        assert times == sorted(set(times))


def test_every_channel_has_messages_of_its_schema_and_of_today(tmp_path: Path) -> None:
    with (
        fleet_of(tmp_path, 2, lidar={"rays": 20}) as fleet,
        LiveView(fleet, port=0) as view,
        Viewer(view.url) as viewer,
    ):
        topics = ["/tf", "/state", "/robots", "/r1/Lidar", "/r1/Camera", "/r2/Pose", "/r2/Battery", "/r2/plan"]
        fleet["r2"]["Base"].send_cmd("goto", [-8.0, 8.0, 1.5])
        viewer.subscribe(*topics)
        found: dict[str, Any] = {}
        for shown in viewer.messages():
            if shown.message.get("poses") != []:  # the motion has not begun
                found[shown.topic] = shown
            if set(found) == set(topics):
                break
        for topic, shown in found.items():
            schema = json.loads(viewer.channels[topic]["schema"])
            jsonschema.validate(shown.message, schema)
            assert abs(shown.time_ns / 1e9 - wall_time().timestamp()) < RECEIVE_S
        end = found["/r2/plan"].message["poses"][-1]
        pose = end["position"]["x"], end["position"]["y"], messages.yaw_of(end["orientation"])
        assert pose == pytest.approx((-8.0, 8.0, 1.5))
        assert {entity["frame_id"] for entity in found["/robots"].message["entities"]} == {"r1/base", "r2/base"}
        assert viewer.channels["/tf"]["schemaName"] == "foxglove.FrameTransforms"
        assert viewer.info["capabilities"] == []


def test_the_log_is_shown_while_it_is_written(tmp_path: Path) -> None:
    with fleet_of(tmp_path) as fleet, LiveView(fleet, port=0) as view, Viewer(view.url) as viewer:
        viewer.subscribe("/log", "/state")
        get_logger(robot="r1").warning("the battery is low", charge=0.1)
        for shown in viewer.messages():
            if shown.topic == "/log":
                break
            get_logger(robot="r1").warning("the battery is low", charge=0.1)  # it may not be subscribed yet
        line = shown.message
        assert (line["name"], line["level"], line["message"]) == ("r1", 3, "the battery is low robot=r1 charge=0.1")
    assert not logging.getLogger("eal_actors").handlers


def test_a_late_viewer_gets_the_scenes_too(tmp_path: Path) -> None:
    with fleet_of(tmp_path) as fleet, LiveView(fleet, port=0) as view:
        for _ in range(2):
            with Viewer(view.url) as viewer:
                viewer.subscribe("/robots")
                assert next(viewer.messages()).topic == "/robots"


def test_a_viewer_drives_with_a_dead_man_and_sets_parameters(tmp_path: Path) -> None:
    with (
        fleet_of(tmp_path) as fleet,
        LiveView(fleet, port=0, allow_control=True) as view,
        Viewer(view.url) as viewer,
    ):
        truth, base = fleet["r1"]["TruePose"], fleet["r1"]["Base"]

        def gone_m() -> float:
            x_m, y_m, _ = truth.get_value().get().value
            return math.hypot(x_m - begin[0], y_m - begin[1])

        begin = truth.get_value().get().value
        channels = [{"id": 7, "topic": "/r1/cmd_vel", "encoding": "json", "schemaName": "geometry_msgs/Twist"}]
        viewer.send(op="advertise", channels=channels)
        end_s = REAL_TIME.now() + RECEIVE_S
        while gone_m() < 0.05:
            viewer.publish(7, {"linear": {"x": 0.2}, "angular": {"z": 0.0}})
            assert REAL_TIME.now() < end_s, "it does not move"
            REAL_TIME.sleep(0.02)
        while base.get_status().get() != 0:  # no message arrives any more
            assert REAL_TIME.now() < end_s, "it does not stop"
            REAL_TIME.sleep(0.02)
        stopped_m = gone_m()
        wrongs: tuple[Any, ...] = (
            {},
            [],
            {"linear": {"x": None}, "angular": {"z": 0}},
            {"linear": {"x": 1e308}, "angular": {"z": 0}},
        )
        for wrong in wrongs:
            viewer.publish(7, wrong)
        viewer.send(op="setParameters", parameters=[{"name": "r1.Base.speed_m_s", "value": 0.123}], id="a")
        while viewer.parameters.get("r1.Base.speed_m_s") != 0.123:
            viewer.receive()
        assert base.get_config("speed_m_s").get().value == 0.123
        viewer.send(op="setParameters", parameters=[{"name": "r1.Base.speed_m_s", "value": 99}], id="b")
        viewer.parameters.clear()
        while viewer.parameters.get("r1.Base.speed_m_s") != 0.123:  # refused: the answer is the former value
            viewer.receive()
        assert gone_m() == pytest.approx(stopped_m, abs=1e-6)


def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    with fleet_of(tmp_path) as fleet, LiveView(fleet, port=0) as view:
        port = int(view.url.rpartition(":")[2])
        with pytest.raises(UnavailableError, match=f"cannot listen at 127.0.0.1:{port}"), LiveView(fleet, port=port):
            pass
