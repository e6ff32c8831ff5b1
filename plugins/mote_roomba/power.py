"""The Roomba's own power: sleep and wake, its mode, and its charger."""

from __future__ import annotations

from typing import Final

from eal_actors.plugin import Activity, DataType, Resource, ResourceType, ValueInfo, command, request

from .driver import RoombaDriver
from .groups import CHARGING_STATES
from .protocol import Mode

_MODE: Final = ValueInfo(DataType.CHAR, choices=tuple(mode.value for mode in Mode))
_CHARGING: Final = ValueInfo(DataType.CHAR, choices=CHARGING_STATES)


class Power(Resource):
    """Puts the robot to sleep and wakes it; get_status: 0 sleeps, 1 is awake."""

    types = ResourceType.OTHER

    def __init__(self, roomba: RoombaDriver) -> None:
        self._roomba = roomba

    def not_ready(self) -> str | None:
        """Return why the way to the Roomba is broken; one that sleeps or is silent can be woken."""
        return self._roomba.unreachable()

    def get_status(self) -> int:
        """Return 0 while it sleeps, 1 while it is awake."""
        return 0 if self._roomba.is_asleep else 1

    @command("sleep")
    def sleep(self) -> Activity:
        """Stop, and put it to sleep as its power button does."""
        return self._roomba.fall_asleep()

    @command("wake")
    def wake(self) -> Activity:
        """Wake it by the device detect line, and start it."""
        return self._roomba.wake_up()

    @request("mode", _MODE)
    def mode(self) -> str:
        """Return the mode of its interface, as far as is known."""
        return self._roomba.mode.value

    @request("charging", _CHARGING)
    def charging(self) -> str:
        """Tell what its charger does."""
        return CHARGING_STATES[self._roomba.latest().power.charging_state]
