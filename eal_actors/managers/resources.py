"""EALResourceManager: numeric ids, look-up by name, and the librarian of resources that are checked out."""

from __future__ import annotations

import itertools
import threading
from collections import Counter
from collections.abc import Mapping
from typing import Generic, TypeVar

from eal_actors.device.info import unknown_name
from eal_actors.kernel.errors import ResourceInUseError, ResourceNotFoundError

T = TypeVar("T")


class EALResourceManager(Generic[T]):
    """Knows one connection's resources (Source: thesis §4.3.3).

    Ids are handed out when a resource is first asked for, so that they differ between connections (§4.4).

    Args:
        resources: what stands behind each name.

    Thread: any.
    """

    def __init__(self, resources: Mapping[str, T]) -> None:
        self._resources = dict(resources)
        self._lock = threading.Lock()
        self._numbers = itertools.count()
        self._id_by_name: dict[str, int] = {}
        self._by_id: dict[int, T] = {}
        self._lent: list[tuple[str, object]] = []

    def names(self) -> list[str]:
        """Return the resources' names."""
        return list(self._resources)

    def find(self, name: str) -> int:
        """Return the id of a resource.

        Raises:
            ResourceNotFoundError: there is none of that name.
        """
        with self._lock:
            if name not in self._resources:
                raise ResourceNotFoundError(unknown_name("resource", name, self._resources))
            if name not in self._id_by_name:
                number = self._id_by_name[name] = next(self._numbers)
                self._by_id[number] = self._resources[name]
            return self._id_by_name[name]

    def get(self, resource_id: int) -> T:
        """Return what stands behind an id that `find` gave.

        Raises:
            ResourceNotFoundError: no resource has that id in this connection.
        """
        try:
            return self._by_id[resource_id]
        except KeyError:
            raise ResourceNotFoundError(
                f"no resource has the id {resource_id!r} in this connection; find_resource gives ids"
            ) from None

    def check_out(self, name: str, lent: object) -> None:
        """Note that something of a resource is lent; each lending must be returned (Source: thesis B.2.4.1)."""
        with self._lock:
            self._lent.append((name, lent))

    def check_in(self, lent: object) -> None:
        """Take back one lending (Source: thesis B.2.4.2).

        Raises:
            ResourceInUseError: it is not lent.
        """
        with self._lock:
            for entry in self._lent:
                if entry[1] is lent:
                    self._lent.remove(entry)
                    return
        raise ResourceInUseError(f"{lent!r} is not checked out, or was returned already")

    def check_all_returned(self) -> None:
        """Raise ResourceInUseError, naming them, if resources are still lent (Source: thesis B.2.4.1)."""
        with self._lock:
            out = Counter(name for name, _ in self._lent)
        if out:
            listed = ", ".join(f"{name} ({n} times)" if n > 1 else name for name, n in sorted(out.items()))
            raise ResourceInUseError(f"cannot disconnect: {listed} still checked out; return_resource each of them")
