"""The Roomba's sensors and its power. A sensor answers from the latest reading, if that is recent enough."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    DataType,
    EALData,
    Resource,
    ResourceType,
    ValueInfo,
    command,
    finite_pose,
    request,
)

from .driver import RoombaDriver
from .groups import CHARGING_STATES
from .reading import RoombaReading
from .sci import Mode
from .senses import (
    BatteryReading,
    BumpSensor,
    CasterDropSensor,
    CliffSensor,
    PowerSensor,
    WallSensor,
    WheelDropSensor,
)

_V = TypeVar("_V")

_MODE: Final = ValueInfo(DataType.CHAR, choices=tuple(mode.value for mode in Mode))
_CHARGING: Final = ValueInfo(DataType.CHAR, choices=CHARGING_STATES)


class RoombaResource(Resource):
    """A resource of a Roomba."""

    def __init__(self, roomba: RoombaDriver) -> None:
        self._roomba = roomba

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()


class RoombaSensor(RoombaResource):
    """A sensor of a Roomba."""

    types = ResourceType.SENSOR

    def read(self, sense: Callable[[RoombaReading], _V]) -> tuple[_V, float]:
        """Return what is read from the latest reading, and the reading's time."""
        reading = self._roomba.latest()
        return sense(reading), reading.stamp_s


class RoombaBump(RoombaSensor, BumpSensor):
    """Whether something touches the front half of the robot."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self.read(lambda sees: (sees.contacts.bump_left, sees.contacts.bump_right))


class RoombaCliff(RoombaSensor, CliffSensor):
    """Whether the floor falls away under the robot's front edge."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self.read(lambda sees: sees.contacts.cliffs)


class OiWheelDrop(RoombaSensor, WheelDropSensor):
    """Whether a wheel hangs over a drop; the caster of these Roombas does not tell."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self.read(lambda sees: sees.contacts.drops[:2])


class SciWheelDrop(RoombaSensor, CasterDropSensor):
    """Whether a wheel hangs over a drop."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self.read(lambda sees: sees.contacts.drops)


class RoombaWall(RoombaSensor, WallSensor):
    """Whether something is within 5 cm of the hull at the right-hand side, a little ahead."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self.read(lambda sees: (sees.contacts.wall, sees.contacts.virtual_wall))


class RoombaBattery(RoombaSensor, PowerSensor):
    """The battery's charge, 0 to 1."""

    @override
    def read_battery(self) -> tuple[BatteryReading, float]:
        return self.read(_battery_reading)


def _battery_reading(sees: RoombaReading) -> BatteryReading:
    power = sees.power
    electric = power.voltage_mv / 1000, power.current_ma / 1000, power.charge_mah / 1000, power.capacity_mah / 1000
    return BatteryReading(power.fraction, *electric, power.temperature_c)


class RoombaOdometry(RoombaSensor):
    """Pose by dead reckoning from the wheel encoders: x in m, y in m, yaw in rad, from (0, 0, 0) at first."""

    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad], yaw in (-pi, pi]."""
        stamp_s, pose = self._roomba.located()
        return EALData.of(pose, frame_id=f"{self._roomba.name}/odom", stamp_s=stamp_s)

    def set_value(self, data: EALData) -> None:
        """Set the current pose.

        Raises:
            ArgumentError: a number is not finite.
        """
        self._roomba.place(*finite_pose(data))

    @request("travel", ValueInfo(DataType.DOUBLE, "m", shape=(2,)))
    def travel(self) -> EALData:
        """Return the totals of the left and the right encoder since the start."""
        reading = self._roomba.latest()
        return EALData.of([reading.left_m, reading.right_m], unit="m", stamp_s=reading.stamp_s)


class RoombaPower(RoombaResource):
    """Puts the robot to sleep and wakes it; get_status: 0 sleeps, 1 is awake."""

    types = ResourceType.OTHER

    def not_ready(self) -> str | None:
        """Return why the way to the Roomba is broken; one that sleeps or is silent can be woken."""
        return self._roomba.unreachable()

    def get_status(self) -> int:
        """Return 0 while it sleeps, 1 while it is awake."""
        return 0 if self._roomba.is_asleep else 1

    @command("sleep", repeatable=True)
    def sleep(self) -> Activity:
        """Stop, and put it to sleep as its power button does."""
        return self._roomba.fall_asleep()

    @command("wake", repeatable=True)
    def wake(self) -> Activity:
        """Wake it by the device detect line, and start it."""
        return self._roomba.wake_up()

    @request("mode", _MODE)
    def mode(self) -> str:
        """Return the mode of its interface, as far as is known."""
        return self._roomba.mode.value

    @request("charging", _CHARGING)
    def charging(self) -> str:
        """Return the state of its charger."""
        return CHARGING_STATES[self._roomba.latest().power.charging_state]
