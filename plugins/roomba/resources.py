"""The Roomba's sensors and its power. A sensor answers from the latest reading, if that is recent enough."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

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

_FLAG: Final = ValueInfo(DataType.BOOL)
_MODE: Final = ValueInfo(DataType.CHAR, choices=tuple(mode.value for mode in Mode))
_CHARGING: Final = ValueInfo(DataType.CHAR, choices=CHARGING_STATES)


class RoombaSensor(Resource):
    """A sensor of a Roomba."""

    types = ResourceType.SENSOR

    def __init__(self, roomba: RoombaDriver) -> None:
        self._roomba = roomba

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()

    def answer(self, read: Callable[[RoombaReading], bool | float], unit: str | None = None) -> EALData:
        """Return what is read from the latest reading, with the reading's time."""
        reading = self._roomba.latest()
        return EALData.of(read(reading), unit=unit, stamp_s=reading.stamp_s)


class RoombaBump(RoombaSensor):
    """Whether something touches the front half of the robot."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any bumper is pressed now."""
        return self.answer(lambda sees: sees.contacts.any_bump)

    @request("left", _FLAG)
    def left(self) -> EALData:
        """Return whether the left bumper is pressed; an obstacle straight ahead presses both."""
        return self.answer(lambda sees: sees.contacts.bump_left)

    @request("right", _FLAG)
    def right(self) -> EALData:
        """Return whether the right bumper is pressed; an obstacle straight ahead presses both."""
        return self.answer(lambda sees: sees.contacts.bump_right)


class RoombaCliff(RoombaSensor):
    """Whether the floor falls away under the robot's front edge."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any of the four sensors sees a drop now."""
        return self.answer(lambda sees: sees.contacts.any_cliff)

    @request("left", _FLAG)
    def left(self) -> EALData:
        """Return whether the sensor 60 degrees to the left sees a drop."""
        return self.answer(lambda sees: sees.contacts.cliff_left)

    @request("front_left", _FLAG)
    def front_left(self) -> EALData:
        """Return whether the sensor 20 degrees to the left sees a drop."""
        return self.answer(lambda sees: sees.contacts.cliff_front_left)

    @request("front_right", _FLAG)
    def front_right(self) -> EALData:
        """Return whether the sensor 20 degrees to the right sees a drop."""
        return self.answer(lambda sees: sees.contacts.cliff_front_right)

    @request("right", _FLAG)
    def right(self) -> EALData:
        """Return whether the sensor 60 degrees to the right sees a drop."""
        return self.answer(lambda sees: sees.contacts.cliff_right)


class OiWheelDrop(RoombaSensor):
    """Whether a wheel hangs over a drop; the caster of these Roombas does not tell."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any wheel has dropped."""
        return self.answer(lambda sees: sees.contacts.any_drop)

    @request("left", _FLAG)
    def left(self) -> EALData:
        """Return whether the left wheel has dropped."""
        return self.answer(lambda sees: sees.contacts.drop_left)

    @request("right", _FLAG)
    def right(self) -> EALData:
        """Return whether the right wheel has dropped."""
        return self.answer(lambda sees: sees.contacts.drop_right)


class SciWheelDrop(OiWheelDrop):
    """Whether a wheel hangs over a drop."""

    @request("caster", _FLAG)
    def caster(self) -> EALData:
        """Return whether the caster, the small wheel in front, has dropped."""
        return self.answer(lambda sees: sees.contacts.drop_caster)


class RoombaWall(RoombaSensor):
    """Whether something is within 5 cm of the hull at the right-hand side, a little ahead."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether something is near at the right-hand side."""
        return self.answer(lambda sees: sees.contacts.wall)

    @request("virtual", _FLAG)
    def virtual(self) -> EALData:
        """Return whether a virtual wall's beam is seen; a simulated world has none."""
        return self.answer(lambda sees: sees.contacts.virtual_wall)


class RoombaBattery(RoombaSensor):
    """The battery's charge, 0 to 1."""

    value = ValueInfo(DataType.DOUBLE, None, 0, 1, description="fraction of the capacity that is left")

    def get_value(self) -> EALData:
        """Return the charge as a share of the capacity."""
        return self.answer(lambda sees: sees.power.fraction)

    @request("voltage", ValueInfo(DataType.DOUBLE, "V"))
    def voltage(self) -> EALData:
        """Return the terminal voltage."""
        return self.answer(lambda sees: sees.power.voltage_mv / 1000, "V")

    @request("current", ValueInfo(DataType.DOUBLE, "A"))
    def current(self) -> EALData:
        """Return the charging current, negative while the battery is drained."""
        return self.answer(lambda sees: sees.power.current_ma / 1000, "A")

    @request("charge", ValueInfo(DataType.DOUBLE, "A h"))
    def charge(self) -> EALData:
        """Return the remaining charge."""
        return self.answer(lambda sees: sees.power.charge_mah / 1000, "A h")

    @request("capacity", ValueInfo(DataType.DOUBLE, "A h"))
    def capacity(self) -> EALData:
        """Return the full charge."""
        return self.answer(lambda sees: sees.power.capacity_mah / 1000, "A h")

    @request("temperature", ValueInfo(DataType.DOUBLE, "degC"))
    def temperature(self) -> EALData:
        """Return its temperature."""
        return self.answer(lambda sees: float(sees.power.temperature_c), "degC")


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


class RoombaPower(Resource):
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
