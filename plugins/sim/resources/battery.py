"""The battery of a simulated robot."""

from __future__ import annotations

from eal_actors.plugin import DataType, EALData, ResourceType, ValueInfo, request

from .on_robot import OnRobot


class Battery(OnRobot):
    """How full the battery is, 0 to 1."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, None, 0, 1, description="fraction of the capacity that is left")

    def get_value(self) -> EALData:
        """Return the charge as a part of the capacity."""
        return self._now("fraction")

    @request("voltage", ValueInfo(DataType.DOUBLE, "V"))
    def voltage(self) -> EALData:
        """Return the voltage between its poles."""
        return self._now("voltage_v", "V")

    @request("current", ValueInfo(DataType.DOUBLE, "A"))
    def current(self) -> EALData:
        """Return the current into it, negative while it is drained."""
        return self._now("current_a", "A")

    @request("charge", ValueInfo(DataType.DOUBLE, "A h"))
    def charge(self) -> EALData:
        """Return what it holds."""
        return self._now("charge_ah", "A h")

    @request("capacity", ValueInfo(DataType.DOUBLE, "A h"))
    def capacity(self) -> EALData:
        """Return what it holds when full."""
        return self._now("capacity_ah", "A h")

    @request("temperature", ValueInfo(DataType.DOUBLE, "degC"))
    def temperature(self) -> EALData:
        """Return its temperature."""
        return self._now("temperature_c", "degC")

    def _now(self, figure: str, unit: str | None = None) -> EALData:
        with self._world.caught_up() as now_s:
            value = float(getattr(self._robot.battery, figure))
        return EALData.of(value, unit=unit, stamp_s=now_s)
