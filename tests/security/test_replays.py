"""Recorded and delayed messages that are sent again, byte by byte: nothing moves twice, late, or against a stop.

Who records a message and sends it under its own certificate is in test_identity. Here the sender is the one that access
control believes: the same controller's link that stalls, a process with the same certificate, a router.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.testing import CliRunner

from eal_actors.cli.app import app
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import EALError, StaleCommandError, StoppedError
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import ACCEPTED, Answer, CallHeader, encode_call
from tests.net.links import eventually
from tests.net.rig import Rig
from tests.security.forging import RawClient, make_keys, raw_client, secure_rig


@dataclass
class Letter:
    """A call as it was recorded: its place, its number and its bytes."""

    resource: str
    method: str
    number: int
    envelope: bytes


class Recorder:
    """Makes calls of a raw client as recorded bytes, and sends them whenever and as often as a test wants."""

    def __init__(self, client: RawClient) -> None:
        self.client = client

    def write(self, resource: str, method: str, *arguments: str) -> Letter:
        """Return a call that is stamped now."""
        client = self.client
        client.sequence += 1
        proof = client.time.era, client.time.time_s, 0.0
        header = CallHeader(client.id, client.epoch, client.sequence, 60.0, 60.0, None, arguments, *proof)
        return Letter(resource, method, client.sequence, encode_call(header)[0])

    def send(self, letter: Letter) -> Answer:
        """Send recorded bytes, and return the robot's answer."""
        self.client.put(letter.resource, letter.method, letter.envelope)
        return self.client.answer_to(letter.number)


@dataclass
class Scene:
    """A robot, and three of its controllers; `mate` may command the arm alone."""

    rig: Rig
    service: RobotService
    controller: RawClient
    mate: RawClient

    @property
    def stopped(self) -> str | None:
        return self.service.robot.stopped_because


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), 60.0)
    with ExitStack() as stack:
        service = stack.enter_context(RobotService(rig.config, "r1"))
        controller, mate = (stack.enter_context(raw_client(rig.config, name)) for name in ("controller", "mate"))
        controller.ping()
        mate.ping()
        yield Scene(rig, service, controller, mate)


def test_a_resume_ends_no_stop_that_came_after_it_was_sent(scene: Scene) -> None:
    """One that a stalled link had kept released a robot that somebody had stopped meanwhile, and so did a repeat."""
    recorder = Recorder(scene.controller)
    assert scene.mate.call(keys.ROBOT, keys.STOP, "first") == 1
    scene.controller.ping()
    delayed, prompt = (recorder.write(keys.ROBOT, keys.RESUME) for _ in range(2))
    assert recorder.send(prompt) == 1
    assert scene.stopped is None

    assert scene.mate.call(keys.ROBOT, keys.STOP, "somebody is on the floor") == 1
    for letter in (delayed, prompt):
        assert isinstance(recorder.send(letter), StaleCommandError)
        assert scene.stopped == "somebody is on the floor"
    assert isinstance(scene.controller.call("Arm", "send_cmd", "step1"), StoppedError)

    scene.controller.ping()
    assert scene.controller.call(keys.ROBOT, keys.RESUME) == 1
    assert scene.stopped is None
    assert scene.controller.call("Arm", "send_cmd", "step1") == 1


def test_a_resume_ends_a_stop_once(scene: Scene) -> None:
    recorder = Recorder(scene.controller)
    assert scene.controller.call(keys.ROBOT, keys.STOP, "x") == 1
    resume = recorder.write(keys.ROBOT, keys.RESUME)
    assert recorder.send(resume) == 1
    assert isinstance(recorder.send(resume), StaleCommandError)


def test_a_resume_without_proof_of_its_age_is_refused(scene: Scene) -> None:
    client = scene.controller
    assert client.call(keys.ROBOT, keys.STOP, "x") == 1
    client.sequence += 1
    client.put(keys.ROBOT, keys.RESUME, encode_call(CallHeader(client.id, 1, client.sequence, 60.0, 60.0))[0])
    assert isinstance(client.answer_to(client.sequence), StaleCommandError)
    assert scene.stopped == "x"


def test_a_command_that_a_stop_has_overtaken_does_not_run_after_the_resume(scene: Scene) -> None:
    """It waited behind a large value, as stops and resumes do not, and ran within a second of its sending."""
    recorders = Recorder(scene.controller), Recorder(scene.mate)
    overtaken = [recorder.write("Arm", "send_cmd", "step7") for recorder in recorders]
    assert scene.controller.call(keys.ROBOT, keys.STOP, "x") == 1
    assert scene.controller.call(keys.ROBOT, keys.RESUME) == 1

    for recorder, letter in zip(recorders, overtaken, strict=True):
        assert isinstance(recorder.send(letter), StoppedError)
    assert scene.rig.steps() == []
    scene.mate.ping()
    assert scene.mate.call("Arm", "send_cmd", "step1") == 1


def test_recorded_commands_halts_and_leaves_do_nothing_again(scene: Scene) -> None:
    recorder = Recorder(scene.controller)
    step, move = (recorder.write("Arm", "send_cmd", text) for text in ("step1", "move60"))
    leave = recorder.write(keys.ROBOT, keys.LEAVE)
    assert recorder.send(step) == 1
    assert recorder.send(move) is ACCEPTED
    assert scene.controller.call("Arm", "halt") == 1
    assert eventually(lambda: scene.service.robot["Arm"].get_status().get() == 0)
    for letter in (step, move):
        assert isinstance(recorder.send(letter), StaleCommandError)
    assert scene.service.robot["Arm"].get_status().get() == 0
    assert recorder.send(leave) == 1
    assert scene.mate.call("Arm", "send_cmd", "step2") == 2
    for letter in (step, move):  # nor after the lease has passed to another one
        assert isinstance(recorder.send(letter), StaleCommandError)
    assert scene.mate.call("Arm", "send_cmd", "move60") is ACCEPTED
    assert recorder.send(leave) == 1
    assert scene.service.robot["Arm"].get_status().get() == 1, "a leave is its sender's alone"
    assert scene.rig.steps() == ["1", "2"]


def test_a_recorded_request_in_free_text_does_nothing_again(scene: Scene) -> None:
    """It counted as a reading: one that came again called a service of ROS 2 twice, and a late one long after it."""
    recorder = Recorder(scene.controller)
    request = recorder.write("Line", "send_req", "fetch the cup")
    assert not isinstance(recorder.send(request), EALError)
    assert isinstance(recorder.send(request), StaleCommandError)
    client = scene.controller
    client.sequence += 1
    header = CallHeader(client.id, 1, client.sequence, 60.0, 60.0, None, ("drop it",))
    client.put("Line", "send_req", encode_call(header)[0])
    assert isinstance(client.answer_to(client.sequence), StaleCommandError)
    assert bytes(scene.service.robot["Line"].read_comm(100).get().payload) == b"fetch the cup"


def test_eal_resume_proves_its_age(scene: Scene) -> None:
    assert scene.controller.call(keys.ROBOT, keys.STOP, "x") == 1
    done = CliRunner().invoke(app, ["resume", "--fleet", str(scene.rig.file)])
    assert (done.exit_code, scene.stopped) == (0, None), done.output
