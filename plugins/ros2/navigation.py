"""Navigator: Nav2's action NavigateToPose.

An action is two services and a topic: `send_goal` accepts a goal, `get_result` answers when it is over, and `feedback`
tells the distance that remains. `cancel_goal` ends it.

Source: design.ros2.org, actions.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from typing import Final

import zenoh
from zenoh import handlers

from eal_actors.plugin import Activity, BlockedError, Clock, DataError, EALError, LogLimit, UnavailableError, get_logger

from .message_types import MessageTypes
from .session import RosNode

_POLL_S: Final = 0.05
_ACCEPT_S: Final = 5.0
_RESULT_S: Final = 3600.0
"""Longest time of one navigation; a command's deadline usually ends it before."""
_REPEAT_S: Final = 1.0
"""From a cancellation without an answer to the next."""
_SUCCEEDED: Final = 4
_STATES: Final = {5: "it was cancelled", 6: "Nav2 gave up"}


class Navigator:
    """Drives to places by one action of Nav2. Thread: the base's actor."""

    def __init__(self, node: RosNode, types: MessageTypes, action: str, clock: Clock) -> None:
        kind = types.action("nav2_msgs/action/NavigateToPose")
        self.name: Final = node.full_name(action)
        self._send_goal = node.client(f"{action}/_action/send_goal", kind.send_goal)
        self._get_result = node.client(f"{action}/_action/get_result", kind.get_result)
        self._cancel_goal = node.client(f"{action}/_action/cancel_goal", types.service("action_msgs/srv/CancelGoal"))
        self._feedback = node.subscription(f"{action}/_action/feedback", kind.feedback)
        self._goal: bytes | None = None
        self._clock = clock
        self._unwanted: bytes | None = None  # a goal whose cancellation is not confirmed
        self._answer: handlers.Handler[zenoh.Reply] | None = None
        self._repeat_s = 0.0
        self._failed = LogLimit(most=1)

    def go_to(self, x_m: float, y_m: float, yaw_rad: float, report: Callable[[float | None, str], None]) -> Activity:
        """Drive to a pose in the map; closing the activity cancels the goal.

        Raises:
            UnavailableError: Nav2 does not answer, or refuses the goal.
            BlockedError: Nav2 gave up.
        """
        goal = uuid.uuid4().bytes
        orientation = {"z": math.sin(yaw_rad / 2), "w": math.cos(yaw_rad / 2)}
        pose = {"position": {"x": x_m, "y": y_m}, "orientation": orientation}
        wanted = {"goal_id": {"uuid": goal}, "goal": {"pose": {"header": {"frame_id": "map"}, "pose": pose}}}
        self._goal = goal
        is_over = False
        try:
            accepted = yield from self._send_goal.call(wanted, _ACCEPT_S)
            if not accepted.accepted:
                is_over = True
                raise UnavailableError(f"{self.name} refused the goal {x_m:g}, {y_m:g}")
            channel = self._get_result.ask({"goal_id": {"uuid": goal}}, _RESULT_S)
            whole_m = 0.0
            while (result := self._get_result.poll(channel)) is None:
                whole_m = self._report(goal, whole_m, report)
                yield _POLL_S
            is_over = True
        finally:
            if not is_over:
                self.cancel()
            self._goal = None
        if result.status != _SUCCEEDED:
            reason = _STATES.get(result.status, f"it ended with status {result.status}")
            text = getattr(result.result, "error_msg", "")
            raise BlockedError(f"{self.name}: {reason}" + (f": {text}" if text else ""))
        return 1

    def _report(self, goal: bytes, whole_m: float, report: Callable[[float | None, str], None]) -> float:
        try:
            received = self._feedback.take()
        except DataError:  # the result counts
            return whole_m
        if received is None or bytes(received.message.goal_id.uuid) != goal:
            return whole_m
        left_m = float(received.message.feedback.distance_remaining)
        whole_m = max(whole_m, left_m)
        report(1.0 - left_m / whole_m if whole_m > 0 else None, f"{left_m:.2f} m left")
        return whole_m

    def cancel(self) -> None:
        """Cancel the running goal, if there is one; `look_after` repeats it until it is answered."""
        goal, self._goal = self._goal, None
        if goal is not None:
            self._unwanted, self._answer, self._repeat_s = goal, None, 0.0
            self.look_after()

    def look_after(self) -> None:
        """Repeat a cancellation until Nav2 answers: it would drive on."""
        if self._unwanted is None:
            return
        try:
            if self._answer is not None and self._cancel_goal.poll(self._answer) is not None:
                self._unwanted = self._answer = None
            elif self._answer is None and self._clock.now() >= self._repeat_s:
                self._repeat_s = self._clock.now() + _REPEAT_S
                self._answer = self._cancel_goal.ask({"goal_info": {"goal_id": {"uuid": self._unwanted}}}, _ACCEPT_S)
        except EALError as error:
            self._answer = None
            if (more := self._failed.admit()) is not None:
                text = "the goal is not cancelled yet; it is tried again"
                get_logger(action=self.name).error(text, reason=error.message, **more)
