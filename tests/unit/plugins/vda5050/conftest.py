"""A broker for the tests of a module."""

from tests.unit.plugins.mqtt.conftest import broker

__all__ = ["broker"]
