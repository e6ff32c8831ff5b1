"""EALResourceManager: numeric ids, look-up by name, and the list of checked-out resources."""

from __future__ import annotations

import itertools
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from eal_actors.device.info import unknown_name
from eal_actors.kernel.errors import ResourceInUseError, ResourceNotFoundError

T = TypeVar("T")


_numbers = itertools.count()


class _ById(dict[int, T]):
    def __missing__(self, resource_id: int) -> T:
        raise ResourceNotFoundError(
            f"no resource has the id {resource_id!r} in this connection; find_resource gives ids"
        )


class EALResourceManager(Generic[T]):
    """The resources of one connection (Source: thesis §4.3.3).

    A resource gets its id at the first look-up (§4.4). No two connections of a process have the same id: one robot's
    must not command another. `get` returns the object of an id from `find`, in every call, so without a frame of
    Python; an id that no resource has in this connection raises ResourceNotFoundError. Thread: any.
    """

    def __init__(self, resources: Mapping[str, T]) -> None:
        self._resources = dict(resources)
        self._lock = threading.Lock()
        self._id_by_name: dict[str, int] = {}
        self._by_id: dict[int, T] = _ById()
        self.get: Callable[[int], T] = self._by_id.__getitem__
        self._lent: list[tuple[str, object]] = []

    def names(self) -> list[str]:
        """Return the resources' names."""
        return list(self._resources)

    def find(self, name: str) -> int:
        """Return the id of a resource. Raises ResourceNotFoundError if there is none of that name."""
        with self._lock:
            if name not in self._resources:
                raise ResourceNotFoundError(unknown_name("resource", name, self._resources))
            if name not in self._id_by_name:
                number = self._id_by_name[name] = next(_numbers)
                self._by_id[number] = self._resources[name]
            return self._id_by_name[name]

    def check_out(self, name: str, lent: object) -> None:
        """Check out an object of a resource; each must be returned (Source: thesis B.2.4.1)."""
        with self._lock:
            self._lent.append((name, lent))

    def check_in(self, lent: object) -> None:
        """Return one checked-out object (Source: thesis B.2.4.2); ResourceInUseError if it is not checked out."""
        with self._lock:
            for entry in self._lent:
                if entry[1] is lent:
                    self._lent.remove(entry)
                    return
        raise ResourceInUseError(f"{lent!r} is not checked out, or was returned already")

    def check_all_returned(self) -> None:
        """Raise ResourceInUseError with their names if resources are still checked out (Source: thesis B.2.4.1)."""
        with self._lock:
            out = Counter(name for name, _ in self._lent)
        if out:
            listed = ", ".join(f"{name} ({n} times)" if n > 1 else name for name, n in sorted(out.items()))
            raise ResourceInUseError(f"cannot disconnect: {listed} still checked out; return_resource each of them")
