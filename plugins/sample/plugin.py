"""The sample plugin (Source: thesis §4.7.1-4.7.3)."""

from eal_actors.plugin import DataType, EALData, EALPlugin, Resource, ResourceType, ValueInfo


class SampleResource(Resource):
    """An int that can be read and written."""

    types = ResourceType.SENSOR | ResourceType.ACTUATOR
    value = ValueInfo(DataType.INT)  # so the framework answers anything but an int with an ArgumentError
    _number = 0

    def get_value(self) -> int:
        """Return the int; 0 at first."""
        return self._number

    def set_value(self, data: EALData) -> None:
        """Keep the int; the call returns 1 (success)."""
        self._number = data.value

    def halt(self) -> None:
        """Do nothing: an int does not move."""


def connect() -> EALPlugin:
    """Name the plugin's resources."""
    return EALPlugin("SampleResource")


def disconnect(plugin: EALPlugin) -> None:
    """Release what `connect` acquired: nothing here."""


def create_SampleResource() -> SampleResource:  # noqa: N802
    """Make the resource."""
    return SampleResource()


def destroy_SampleResource(resource: SampleResource) -> None:  # noqa: N802
    """Release what `create_SampleResource` acquired: nothing here."""
