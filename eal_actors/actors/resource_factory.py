"""Who makes a resource for its actor."""

from __future__ import annotations

from typing import Protocol

from eal_actors.device.resource import Resource


class ResourceFactory(Protocol):
    """How to make and unmake the resource: what the plugin manager hands out."""

    def create(self) -> Resource:
        """Return a new resource. Thread: the resource's actor."""
        ...

    def destroy(self, resource: Resource) -> None:
        """Let go of it. Thread: the resource's actor."""
        ...
