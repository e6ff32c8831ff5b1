"""Motion to places is a command like others: who may not command a base or a pose does not move the robot by one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from eal_actors.device.data import EALData
from eal_actors.device.motion.map_motions import MAX_WAYPOINTS
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import EALError
from eal_actors.wire.format.messages import CallHeader, encode_call
from tests.net.rig import Rig
from tests.security.forging import RawClient, make_keys, raw_client

FAR = 1e308
COVARIANCE = np.diag([1e-4, 1e-4, 1e-4]).ravel()


def fix(x_m: float, stamp_s: float | None = 0.0, covariance: object = COVARIANCE) -> EALData:
    return EALData.of(np.concatenate(([x_m, 0.0, 0.0], np.asarray(covariance))), stamp_s=stamp_s)


MOVES = [
    ("Base", "send_cmd", ("goto",), EALData.of([1.0, 0.0])),
    ("Base", "send_cmd", ("follow",), EALData.of([1.0, 0.0, 1.0, 1.0])),
    ("Base", "set_value", (), EALData.of([0.1, 0.0])),
    ("Pose", "send_cmd", ("fix",), fix(1.0)),
    ("Pose", "set_value", (), EALData.of([1.0, 0.0, 0.0])),
]
MALFORMED = [
    *(
        ("Base", "goto", EALData.of(place))
        for place in ([1.0], [1.0] * 4, [math.nan, 0.0], [0.0, math.inf], [FAR, 0.0])
    ),
    *(("Base", "follow", EALData.of(path)) for path in ([1.0], [1.0, math.nan], [1.0, -FAR], np.zeros((0, 2)))),
    ("Base", "follow", EALData.of(np.zeros((2, 3)))),
    ("Base", "follow", EALData.of(np.zeros((MAX_WAYPOINTS + 1, 2)))),
    ("Base", "goto", EALData.of("home")),
    ("Base", "goto", None),
    *(("Pose", "fix", fix(1.0, stamp_s)) for stamp_s in (None, FAR)),
    *(("Pose", "fix", fix(x_m)) for x_m in (math.nan, -math.inf)),
    *(("Pose", "fix", fix(1.0, 0.0, rows)) for rows in ([0.0] * 9, -COVARIANCE, [FAR] * 9, [math.nan] * 9)),
    ("Pose", "fix", None),
]


@pytest.fixture
def clients(tmp_path: Path) -> Iterator[dict[str, RawClient]]:
    """Raw clients of a simulated robot by the names of their certificates."""
    roles = {"controllers": ["controller", {"name": "mate", "resources": ["Camera"]}], "observers": ["display"]}
    security = {"keys": str(make_keys(tmp_path / "keys")), "roles": roles}
    rig = Rig(tmp_path, network={"security": security}, protocol="tls", extra={"clock": {"rate": 1}})
    rig.content["robots"]["r1"]["plugins"] = {"sim": {"model": "evbot3", "noise": False}}
    rig.write()
    with ExitStack() as stack:
        stack.enter_context(RobotService(rig.config, "r1"))
        names = "controller", "mate", "display"
        yield {name: stack.enter_context(raw_client(rig.config, name)) for name in names}


def place_of(client: RawClient) -> list[float]:
    """Return the robot's estimated and true pose."""
    poses = [client.call(resource, "get_value") for resource in ("Pose", "TruePose")]
    assert all(isinstance(pose, EALData) for pose in poses), poses
    return [float(number) for pose in poses for number in pose.value]  # type: ignore[union-attr]  # asserted above


def test_who_may_not_command_them_moves_neither_base_nor_pose(clients: dict[str, RawClient]) -> None:
    controller = clients["controller"]
    controller.ping()
    before = place_of(controller)
    for attacker in (clients["mate"], clients["display"]):
        for resource, method, arguments, data in MOVES:
            for imitated in (attacker, controller):
                time = controller.time
                header = CallHeader(imitated.id, 1, 10**6, 60.0, 60.0, None, arguments, time.era, time.time_s, 0.0)
                envelope, payload = encode_call(header, data)
                attacker.put(resource, method, envelope, imitated.name, imitated.secret, bytes(payload))
        attacker.ping()
        assert controller.call("Base", "get_status") == 0
        assert place_of(controller) == before
    controller.call("Pose", "set_value", data=EALData.of([1.0, 0.0, 0.0]))
    assert place_of(controller) != before, "the same message moves it if its sender may send it"


def test_malformed_places_and_fixes_are_refused(clients: dict[str, RawClient]) -> None:
    controller = clients["controller"]
    controller.ping()
    before = place_of(controller)
    for resource, command, data in MALFORMED:
        answer = controller.call(resource, "send_cmd", command, data=data)
        assert isinstance(answer, EALError), (resource, command, data, answer)
        assert controller.call("Base", "get_status") == 0
        assert place_of(controller) == before
