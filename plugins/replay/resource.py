"""A recorded resource."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from eal_actors.plugin import (
    Activity,
    CommandInfo,
    EALData,
    PluginError,
    Resource,
    ResourceFaultError,
    ResourceInfo,
    UnavailableError,
)

from .player import Player

_PLAYED: Final = ("send_cmd", "set_value", "write_comm")


class Replayed(Resource):
    """Returns the recorded values of a resource, and replays its commands.

    A command, a `set_value` or a `write_comm` must be the one that the record has next for the resource; the data of
    the last two are not in a record. It takes the time that it took then, and fails as it failed then. What a record
    does not hold, such as configurations, is not supported.

    Args:
        robot: the robot's name in the record.
        resource: the resource's name in the record.
    """

    def __init__(self, player: Player, robot: str, resource: str) -> None:
        self._player = player
        self._robot = robot
        self._resource = resource
        recorded = player.run.infos[robot].get(resource)
        if recorded is None:
            raise PluginError(f"the record has no resource {resource!r} of robot {robot!r}")
        self._recorded: Final = recorded
        self._calls = [call for call in player.run.calls(robot, resource) if call.method in _PLAYED]
        self._has_values = player.run.has_values(robot, resource)
        self._next = 0

    def info(self) -> ResourceInfo:
        """Return the recorded description, without members that the record lacks."""
        held = ({"get_value"} if self._has_values else set()) | {call.method for call in self._calls}
        return replace(
            self._recorded,
            name=self.name,
            methods=self._recorded.methods & held,
            commands=self._commands(),
            requests=(),
            configs=(),
        )

    def _commands(self) -> tuple[CommandInfo, ...]:
        """Return the recorded commands, each once, by their full texts."""
        known = {command.name: command for command in self._recorded.commands}
        texts = dict.fromkeys(call.command for call in self._calls if call.method == "send_cmd")
        return tuple(known.get(text, CommandInfo(text, description="As the record has it.")) for text in texts)

    def not_ready(self) -> str | None:
        """Return that the record has ended, after its end."""
        return self._player.over()

    def get_value(self) -> EALData:
        """Return the last recorded value, with the time since then as its age.

        Raises:
            UnavailableError: it had said nothing by now, or its values were not recorded.
        """
        if not self._has_values:
            raise self._unsupported("get_value")
        value = self._player.run.value_at(self._robot, self._resource, self._player.time_s)
        if value is None:
            raise UnavailableError(f"the record has no value of it up to {self._player.time_s:.3f} s")
        stamp_s = value.stamp_s if value.stamp_s is not None else 0.0
        return value.with_meta(stamp_s=self._player.to_clock(stamp_s))

    def send_cmd(self, cmd: str, data: EALData | None = None) -> Any:
        """Take the recorded time of the command, and return 1.

        Raises:
            ArgumentError: the resource knows no such command.
            ResourceFaultError: the record has another command next, or none; or the command failed then.
        """
        if not any(call.method == "send_cmd" for call in self._calls):
            raise self._unsupported("send_cmd")
        self.info().parse_command(cmd, data)
        return self._play("send_cmd", cmd, 1)

    def set_value(self, data: EALData) -> Any:  # noqa: ARG002
        """Take the recorded time of the next call, which must have been of this method; raises as `send_cmd`."""
        return self._play("set_value", "", 1)

    def write_comm(self, data: EALData, length: int) -> Any:  # noqa: ARG002
        """Take the recorded time of the next call, which must have been of this method; raises as `send_cmd`."""
        return self._play("write_comm", "", length)

    def _play(self, method: str, command: str, result: int) -> Activity:
        if not any(call.method == method for call in self._calls):
            raise self._unsupported(method)
        asked = repr(command or method)
        if self._next == len(self._calls):
            raise ResourceFaultError(f"the record has no command after the {self._next} that were played, not {asked}")
        call = self._calls[self._next]
        if (call.method, call.command) != (method, command):
            has = repr(call.command or call.method)
            raise ResourceFaultError(f"the record has {has} as its command {self._next + 1}, not {asked}")
        self._next += 1
        return self._played(call.end_s - call.start_s, call.error, result)

    @staticmethod
    def _played(duration_s: float, error: str, result: int) -> Activity:
        yield duration_s
        if error:
            raise ResourceFaultError(error)
        return result

    def halt(self) -> None:
        """Do nothing: nothing moves."""
