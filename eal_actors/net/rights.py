"""What a controller may do with a robot, as the robot tells, so that what it may not do is refused at once.

The robot remains the judge: what its access control does not allow is dropped there without a word, see security.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

from eal_actors.kernel.errors import AccessDeniedError, ProtocolError
from eal_actors.managers.network_model import SecurityConfig
from eal_actors.net.keys import ROBOT, STREAM
from eal_actors.net.security import BASIC_ROBOT_METHODS, READING_METHODS, READING_ROBOT_METHODS


def told_rights(security: SecurityConfig | None, robot: str) -> list[list[Any]] | None:
    """Return who may do what with a robot, as it is told: names, roles and the resources, nil for all of them.

    Args:
        security: of the robot's fleet; None where everybody may do everything, which is told by None.
        robot: the robot's name.
    """
    if security is None:
        return None
    return [
        [grant.name, grant.role, None if grant.resources is None else list(grant.resources)]
        for grant in security.grants
        if grant.robots is None or robot in grant.robots
    ]


@dataclass(frozen=True, slots=True)
class _Grant:
    role: str
    resources: frozenset[str] | None

    def allows(self, resource: str, method: str) -> bool:
        if resource == ROBOT:
            if self.role != "controller":
                return method in READING_ROBOT_METHODS
            return self.resources is None or method in BASIC_ROBOT_METHODS
        if self.resources is not None and resource not in self.resources:
            return False
        return self.role == "controller" or method in READING_METHODS or method == STREAM

    def describe(self) -> str:
        of = "" if self.resources is None else f" of {', '.join(sorted(self.resources))} alone"
        return f"{self.role}{of}"


class Rights:
    """What the holder of one certificate may do with one robot.

    Args:
        name: of the certificate.
        grants: what it was granted.

    Thread: any.
    """

    def __init__(self, name: str, grants: Sequence[_Grant]) -> None:
        self._name = name
        self._grants = tuple(grants)

    @classmethod
    def of(cls, told: object, name: str) -> Self | None:
        """Read what a robot tells; None where everybody may do everything.

        Raises:
            ProtocolError: it makes no sense.
        """
        if told is None:
            return None
        try:
            rows = [(str(holder), str(role), resources) for holder, role, resources in told]  # type: ignore[attr-defined]  # checked by trying
            grants = [
                _Grant(role, None if resources is None else frozenset(map(str, resources)))
                for holder, role, resources in rows
                if holder == name
            ]
        except (TypeError, ValueError) as error:
            raise ProtocolError(f"the rights {told!r} make no sense") from error
        return cls(name, grants)

    def allows(self, resource: str, method: str) -> bool:
        """Return whether the robot grants a call."""
        return any(grant.allows(resource, method) for grant in self._grants)

    def check(self, resource: str, method: str) -> None:
        """Let a call pass, or not.

        Raises:
            AccessDeniedError: the robot does not grant it.
        """
        if self.allows(resource, method):
            return
        what = f"{method} of the robot" if resource == ROBOT else method
        roles = " and ".join(f"the role {grant.describe()}" for grant in self._grants) or "no role"
        message = f"does not grant {what} to {self._name!r}, which has {roles} there"
        raise AccessDeniedError(message, resource=None if resource == ROBOT else resource)
