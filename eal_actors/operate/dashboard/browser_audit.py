"""BrowserAudit: records the commands of one browser in the audit log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from eal_actors.operate.audit import AuditLog, Finish
from eal_actors.operate.dashboard.access import Role
from eal_actors.operate.dashboard.dispatcher import Reply
from eal_actors.operate.dashboard.messages import DriveRobot, ListPlans, ReleaseRobot, needed_role


class BrowserAudit:
    """Records what the user of a browser commands. A key press that drives a robot is one command.

    Thread: any; never blocks.
    """

    def __init__(self, log: AuditLog, user: Mapping[str, str]) -> None:
        self._log = log
        self._user = user
        self._presses: dict[str, tuple[int, Finish]] = {}

    def begin(self, message: Any, reply: Reply) -> Reply:
        """Record the beginning of a command; return the function to reply with, which records its end."""
        if isinstance(message, ReleaseRobot):
            self._end_press(message.robot, "ok")
            return reply
        if isinstance(message, DriveRobot):
            return self._begin_press(message, reply)
        if needed_role(message) is Role.WATCH or isinstance(message, ListPlans):  # the page asks every two seconds
            return reply
        finish = self._record(message)

        def reply_and_record(answer: dict[str, Any]) -> None:
            finish(_outcome(answer))
            reply(answer)

        return reply_and_record

    def refuse(self, message: Any, reason: str) -> None:
        """Record a command that was refused."""
        self._record(message)(f"refused: {reason}")

    def close(self) -> None:
        """Record the end of the commands that the browser still gives."""
        for robot in list(self._presses):
            self._end_press(robot, "the page left")

    def _record(self, message: Any) -> Finish:
        return self._log.begin(self._user, message.do, message.model_dump(mode="json", exclude={"do", "id", "heard_s"}))

    def _begin_press(self, message: DriveRobot, reply: Reply) -> Reply:
        press, _ = self._presses.get(message.robot, (None, None))
        if press != message.press:
            self._end_press(message.robot, "ok")
            self._presses[message.robot] = (message.press, self._record(message))

        def reply_and_record(answer: dict[str, Any]) -> None:
            self._end_press(message.robot, _outcome(answer))
            reply(answer)

        return reply_and_record

    def _end_press(self, robot: str, outcome: str) -> None:
        _, finish = self._presses.pop(robot, (0, None))
        if finish is not None:
            finish(outcome)


def _outcome(answer: Mapping[str, Any]) -> str:
    if answer.get("ok"):
        return "ok"
    if failed := answer.get("failed"):
        return "; ".join(f"{robot}: {reason}" for robot, reason in failed.items())
    return str(answer.get("drive_error", answer).get("error", "failed"))
