"""The sensors of a vehicle."""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from eal_actors.plugin import (
    DataType,
    EALData,
    Resource,
    ResourceType,
    UnavailableError,
    ValueInfo,
    request,
    wrapped_rad,
)

from .link import MavLink

_NOT_MEASURED: Final = 0xFFFF


class MavSensor(Resource):
    """A sensor of a vehicle."""

    types = ResourceType.SENSOR

    def __init__(self, link: MavLink) -> None:
        self._link = link

    @override
    def not_ready(self) -> str | None:
        return self._link.why_not_ready()


class Odometry(MavSensor):
    """The pose by the autopilot: x in m, y in m, yaw in rad."""

    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad], yaw in (-pi, pi]."""
        now = self._link.reading()
        return EALData.of([now.x_m, now.y_m, wrapped_rad(now.yaw_rad)], frame_id="odom", stamp_s=now.stamp_s)


class Altitude(MavSensor):
    """The altitude above the start."""

    value = ValueInfo(DataType.DOUBLE, "m")

    def get_value(self) -> EALData:
        """Return the altitude in m."""
        now = self._link.reading()
        return EALData.of(now.altitude_m, unit="m", stamp_s=now.stamp_s)


class Battery(MavSensor):
    """The battery's charge, 0 to 1."""

    value = ValueInfo(DataType.DOUBLE, None, 0, 1, description="fraction of the capacity that is left")

    def get_value(self) -> float:
        """Return the charge as a share of the capacity.

        Raises:
            UnavailableError: the autopilot does not measure it.
        """
        left = self._link.newest("SYS_STATUS").battery_remaining
        if left < 0:
            raise UnavailableError("the autopilot does not measure its battery's charge")
        return min(1.0, float(left) / 100.0)

    @request("voltage", ValueInfo(DataType.DOUBLE, "V"))
    def voltage(self) -> float:
        """Return the terminal voltage.

        Raises:
            UnavailableError: the autopilot does not measure it.
        """
        voltage_mv = self._link.newest("SYS_STATUS").voltage_battery
        if voltage_mv == _NOT_MEASURED:
            raise UnavailableError("the autopilot does not measure its battery's voltage")
        return float(voltage_mv) / 1000.0
