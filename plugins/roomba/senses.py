"""The sensors of a Roomba: the interface of a real and of a simulated one, and partly that of an EvBot III."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from eal_actors.plugin import DataType, EALData, Resource, ResourceFaultError, ResourceType, ValueInfo, request

_FLAG: Final = ValueInfo(DataType.BOOL)
_WHEELS: Final = ("left wheel", "right wheel", "caster")
_CLIFFS: Final = ("left", "front left", "front right", "right")


def flag(name: str, place: int, description: str) -> Callable[[Any], EALData]:
    """Return the request for one flag of a FlagSensor, at a place from 0."""

    @request(name, _FLAG, description=description)
    def read(self: FlagSensor) -> EALData:
        return self.answer(place)

    return read


class FlagSensor(Resource):
    """Whether any of several sensors is active; a request for each."""

    types = ResourceType.SENSOR
    value = _FLAG

    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        """Return whether each of the sensors is active, and the time of that in seconds of the fleet's clock."""
        raise NotImplementedError

    def get_value(self) -> EALData:
        """Return whether any of them is active now."""
        flags, stamp_s = self.read_flags()
        return EALData.of(any(flags), stamp_s=stamp_s)

    def answer(self, place: int) -> EALData:
        """Return whether one of them is active now."""
        flags, stamp_s = self.read_flags()
        return EALData.of(flags[place], stamp_s=stamp_s)


class BumpSensor(FlagSensor):
    """Whether something touches the front half of the robot."""

    left = flag("left", 0, "Return whether the left bumper is pressed; an obstacle straight ahead presses both.")
    right = flag("right", 1, "Return whether the right bumper is pressed; an obstacle straight ahead presses both.")


class CliffSensor(FlagSensor):
    """Whether the floor falls away under the robot's front edge."""

    left = flag("left", 0, "Return whether the sensor 60 degrees to the left sees a drop.")
    front_left = flag("front_left", 1, "Return whether the sensor 20 degrees to the left sees a drop.")
    front_right = flag("front_right", 2, "Return whether the sensor 20 degrees to the right sees a drop.")
    right = flag("right", 3, "Return whether the sensor 60 degrees to the right sees a drop.")


def ground_fault(drops: Sequence[bool], cliffs: Sequence[bool], *, forward: bool) -> ResourceFaultError | None:
    """Return why a motion must be halted: a wheel has dropped, or a forward motion meets a cliff; None if it need not.

    The drops are of the left wheel, the right wheel and the caster, the cliffs from the left to the right.
    """
    for what, names, seen in (("wheel drop", _WHEELS, drops), ("cliff", _CLIFFS, cliffs if forward else ())):
        if any(seen):
            found = ", ".join(name for name, is_so in zip(names, seen, strict=True) if is_so)
            return ResourceFaultError(f"halted: {what} ({found})")
    return None


class WheelDropSensor(FlagSensor):
    """Whether a wheel hangs over a drop."""

    left = flag("left", 0, "Return whether the left wheel has dropped.")
    right = flag("right", 1, "Return whether the right wheel has dropped.")


class CasterDropSensor(WheelDropSensor):
    """Whether a wheel hangs over a drop."""

    caster = flag("caster", 2, "Return whether the caster, the small wheel in front, has dropped.")


class WallSensor(FlagSensor):
    """Whether something is within 5 cm of the hull at the right-hand side, a little ahead."""

    virtual = flag("virtual", 1, "Return whether a virtual wall's beam is seen; a simulated world has none.")

    def get_value(self) -> EALData:
        """Return whether something is near at the right-hand side."""
        return self.answer(0)


def pressed(name: str, place: int) -> Callable[[Any], EALData]:
    """Return the request for the state of a button."""
    return flag(name, place, f"Return whether {name.upper()} is pressed.")


class SciButtonSensor(FlagSensor):
    """Whether any button on the robot is pressed."""

    buttons: tuple[str, ...] = "max", "clean", "spot", "power"
    max, clean, spot, power = map(pressed, buttons, range(4))


class BatteryReading(NamedTuple):
    """The state of a battery. The current is negative while it is drained."""

    fraction: float
    voltage_v: float
    current_a: float
    charge_ah: float
    capacity_ah: float
    temperature_c: float


def _quantity(name: str, field: str, unit: str, description: str) -> Callable[[Any], EALData]:
    """Return the request for a number of a BatteryReading."""

    @request(name, ValueInfo(DataType.DOUBLE, unit), description=description)
    def read(self: PowerSensor) -> EALData:
        reading, stamp_s = self.read_battery()
        return EALData.of(float(getattr(reading, field)), unit=unit, stamp_s=stamp_s)

    return read


class PowerSensor(Resource):
    """The battery's charge, 0 to 1."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, None, 0, 1, description="fraction of the capacity that is left")

    def read_battery(self) -> tuple[BatteryReading, float]:
        """Return the battery's state, and its time in seconds of the fleet's clock."""
        raise NotImplementedError

    def get_value(self) -> EALData:
        """Return the charge as a share of the capacity."""
        reading, stamp_s = self.read_battery()
        return EALData.of(float(reading.fraction), stamp_s=stamp_s)

    voltage = _quantity("voltage", "voltage_v", "V", "Return the terminal voltage.")
    current = _quantity(
        "current", "current_a", "A", "Return the charging current, negative while the battery is drained."
    )
    charge = _quantity("charge", "charge_ah", "A h", "Return the remaining charge.")
    capacity = _quantity("capacity", "capacity_ah", "A h", "Return the full charge.")
    temperature = _quantity("temperature", "temperature_c", "degC", "Return its temperature.")
