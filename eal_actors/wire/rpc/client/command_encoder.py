"""CommandEncoder: the messages of commands to one robot, with stamps that prove their age; see freshness.

Thread: one at a time, except `hear`.
"""

from __future__ import annotations

from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.device.data import EALData, Payload
from eal_actors.wire.format.messages import Arguments, CallHeader, CallId, RobotTime, encode_call
from eal_actors.wire.format.readings import encode_command
from eal_actors.wire.rpc.client.channel import Channel

TTL_S: Final = 1.0
"""Time to live of a command: its greatest age when the robot begins it, in real seconds."""


class CommandEncoder:
    """Encodes commands to the robot of a channel."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._echo: tuple[RobotTime, float] | None = None

    def hear(self, time: RobotTime, heard_s: float) -> None:
        """Note the robot's clock from a reply, for the next stamp. Thread: any."""
        self._echo = time, heard_s

    def encode(
        self, call: Call[Any], plain: Arguments, data: EALData | None, traceparent: str, now_s: float, left_s: float
    ) -> tuple[CallId, bytes, Payload]:
        """Return the identifier, the envelope and the payload of a command or a stop, with plain arguments or a value.

        `now_s` is real time, read before the real seconds left until its deadline: so their sum is never later than
        that. Raises DataError if it cannot be sent, and UnavailableError if the robot has not replied yet.
        """
        stamper = self._channel.stamper
        echo = self._echo
        if echo is not None and echo[1] <= now_s:  # a later one is for the next command
            self._echo = None
            (era, time_s, _), heard_s = echo
            stamper.heard(era, time_s, heard_s)
        call_id, _, era, echo_s, held_s = stamper.stamp(TTL_S, now_s)
        if data is None and call.start_s is None:
            return call_id, encode_command(call_id, TTL_S, left_s, plain, (era, echo_s, held_s), traceparent), b""
        start_s = None if call.start_s is None else self._robot_time(call.start_s)
        if data is not None and data.stamp_s is not None:
            data = data.with_meta(stamp_s=self._robot_time(data.stamp_s))
        header = CallHeader(*call_id, TTL_S, left_s, start_s, plain, era, echo_s, held_s, False, traceparent)
        return call_id, *encode_call(header, data)

    def _robot_time(self, fleet_s: float) -> float:
        real_s = self._channel.clock.to_real(fleet_s)
        return real_s + self._channel.clock_tracker.offset(real_s).offset_s
