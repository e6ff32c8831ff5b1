"""Whom a resource actor works with: who makes its resource, and who is told of its life."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from eal_actors.info import ResourceInfo
from eal_actors.resource import Resource

if TYPE_CHECKING:
    from eal_actors.actors.resource_actor import ResourceActor


class ResourceFactory(Protocol):
    """How to make and unmake the resource: what the plugin manager hands out."""

    def create(self) -> Resource:
        """Return a new resource. Thread: the resource's actor."""
        ...

    def destroy(self, resource: Resource) -> None:
        """Let go of it. Thread: the resource's actor."""
        ...


class ResourceObserver(Protocol):
    """Whom a resource actor tells of its life: its robot. Thread: the resource's actor; none may block."""

    def resource_up(self, actor: ResourceActor, info: ResourceInfo) -> None:
        """The resource is open and serves calls."""
        ...

    def resource_ready(self, actor: ResourceActor, reason: str | None) -> None:
        """Its device can be used, or cannot for a reason."""
        ...

    def resource_down(self, actor: ResourceActor, error: BaseException | None) -> None:
        """The resource has ended: crashed with an error, or normally with None."""
        ...

    def watch(self, actor: ResourceActor, until_s: float) -> None:
        """Look at that time whether the actor is stuck in what it is doing now."""
        ...
