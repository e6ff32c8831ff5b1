"""Desk: what a robot's server answers to questions about the robot itself, and about commands that are under way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState, release
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError, error_text
from eal_actors.managers.network_model import SecurityConfig
from eal_actors.net import keys
from eal_actors.net.admission import Admission
from eal_actors.net.publishing import StreamPublisher
from eal_actors.net.rights import told_rights
from eal_actors.net.underway import UnderWay
from eal_actors.net.wire import Answer, CallHeader, CallId, Event


class Desk:
    """Answers for one robot.

    Args:
        robot: the robot.
        admission: which commands may begin.
        under_way: the commands under way.
        publisher: its streams.
        publish: publishes an event.
        security: who may do what; None for everybody everything.

    Thread: the host's, but for `ping` and `release`.
    """

    def __init__(
        self,
        robot: RobotHandle,
        admission: Admission,
        under_way: UnderWay,
        publisher: StreamPublisher,
        publish: Callable[[Event], None],
        security: SecurityConfig | None,
    ) -> None:
        self._robot = robot
        self._admission = admission
        self._under_way = under_way
        self._publisher = publisher
        self._publish = publish
        self._rights = told_rights(security, robot.name)

    def ping(self) -> Answer:
        """Answer a ping: how the robot is. Thread: any."""
        received_s = REAL_TIME.now()
        about = {**self._about(), **self._load(), "resources": len(self._robot)}
        return {**about, "received_s": received_s, "replied_s": REAL_TIME.now()}

    def _load(self) -> dict[str, Any]:
        """Return what waits in the mailboxes, in real seconds, and what was restarted."""
        second = self._robot.clock.of_real(1.0)
        mailboxes = {
            name: [waiting.count, waiting.oldest_s / second]
            for name, handle in self._robot.items()
            if (waiting := handle.waiting) is not None and waiting.count
        }
        return {"mailboxes": mailboxes, "restarts": dict(self._robot.restarts)}

    def answer(self, method: str, header: CallHeader) -> Answer:
        """Answer anything else; what goes wrong is the answer."""
        act = {
            keys.HELLO: self._hello,
            keys.REATTACH: self._reattach,
            keys.CANCEL: self._cancel,
            keys.LEAVE: self._leave,
        }[method]
        try:
            return act(header)
        except EALError as error:
            return error.at(self._robot.name)
        except Exception as error:  # noqa: BLE001  # what a controller sends must not end the server
            return ProtocolError(f"the call makes no sense: {error_text(error)}", robot=self._robot.name)

    def _hello(self, header: CallHeader) -> Answer:
        name = next(iter(header.arguments), "")
        self._admission.enter(header.client, header.epoch, str(name))
        if self._robot.state is RobotState.STARTING:
            raise UnavailableError("it is still starting")
        return {
            **self._about(),
            "problems": [error_text(problem) for problem in self._robot.problems],
            "resources": [handle.info.to_dict() for handle in self._robot.values()],
            "rights": self._rights,
        }

    def _about(self) -> dict[str, Any]:
        holders = self._admission.holders()
        return {
            "release": release(),
            "state": self._robot.state.value,
            "stopped": self._robot.stopped_because,
            "holders": {resource: self._admission.names.of(client) for resource, client in holders.items()},
            "holder_ids": holders,
            "not_ready": dict(self._robot.not_ready),
            "running": [[*running.call_id, running.about()] for running in self._under_way.announced()],
        }

    def _reattach(self, header: CallHeader) -> Answer:
        """Tell what is known of commands; the outcomes of those that have ended are told once more."""
        numbers = [int(number) for number in header.arguments]
        running, unknown = [], []
        for epoch, sequence in zip(numbers[::2], numbers[1::2], strict=False):
            call_id = CallId(header.client, epoch, sequence)
            receipt = self._admission.recall(call_id)
            if receipt is None:
                unknown.append([epoch, sequence])
            elif receipt.is_finished:
                self._publish(Event("result", REAL_TIME.now(), call_id, receipt.outcome))
            else:
                running.append([epoch, sequence])
        return {"running": running, "unknown": unknown}

    def _cancel(self, header: CallHeader) -> Answer:
        epoch, sequence = (int(number) for number in header.arguments)
        self._under_way.cancel(CallId(header.client, epoch, sequence))
        return 1

    def release(self, header: CallHeader) -> Answer:
        """Let a controller let go of resources. Thread: any; at once, for a command may come right behind it."""
        for resource in self._admission.release(header.client, [str(name) for name in header.arguments]):
            self._robot[resource].halt()
        return 1

    def _leave(self, header: CallHeader) -> Answer:
        """Let a controller go: what it commanded is halted, what it held is free."""
        self._publisher.leave(header.client)
        for resource in self._admission.leave(header.client):
            self._robot[resource].halt()
        return 1
