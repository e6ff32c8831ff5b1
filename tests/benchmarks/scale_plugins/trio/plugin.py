"""A base, a gauge and a lamp, whose methods return at once: what is left is the framework's own cost."""

# ruff: noqa: N802  # the plugin API names the functions after the resources
from __future__ import annotations

from eal_actors.plugin import EALPlugin, Resource, ResourceType, command


class Base(Resource):
    """An actuator."""

    types = ResourceType.ACTUATOR

    @command("go")
    def go(self) -> int:
        """Go nowhere."""
        return 1

    def halt(self) -> None:
        """It never moves."""


class Gauge(Resource):
    """A sensor."""

    types = ResourceType.SENSOR

    def get_value(self) -> float:
        return 1.0


class Lamp(Base):
    """Another actuator."""


def connect() -> EALPlugin:
    """Name the resources."""
    return EALPlugin("Base", "Gauge", "Lamp")


def disconnect(plugin: EALPlugin) -> None: ...


def create_Base() -> Base:
    return Base()


def create_Gauge() -> Gauge:
    return Gauge()


def create_Lamp() -> Lamp:
    return Lamp()


def destroy_Base(resource: Resource) -> None: ...


def destroy_Gauge(resource: Resource) -> None: ...


def destroy_Lamp(resource: Resource) -> None: ...
