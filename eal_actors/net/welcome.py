"""What a robot answers to a controller's greeting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.errors import EALError, ProtocolError, error_text
from eal_actors.net.pinging import texts
from eal_actors.net.resource_info import info_from
from eal_actors.net.rights import Rights
from eal_actors.net.wire import Answer


@dataclass(frozen=True, slots=True)
class Welcome:
    """How a robot is.

    Attributes:
        infos: what its resources say of themselves.
        stopped: why an emergency stop holds it; None if none does.
        problems: what kept plugins out.
        not_ready: why resources are not ready, by their names.
        rights: what we may do with it; None for everything.
        running: the commands under way; see RunBoard.
    """

    infos: tuple[ResourceInfo, ...]
    stopped: str | None
    problems: tuple[str, ...]
    not_ready: Mapping[str, str]
    rights: Rights | None
    running: object

    @classmethod
    def of(cls, answer: Answer, certificate: str | None) -> Self:
        """Read an answer.

        Args:
            answer: what was answered.
            certificate: the name of our certificate; None if we show none.

        Raises:
            ProtocolError: it makes no sense, or the robot does not let us in; the message goes on from its name.
        """
        if not isinstance(answer, dict):
            reason = answer.message if isinstance(answer, EALError) else f"answered {answer!r}"
            raise ProtocolError(f"does not let us in: {reason}")
        try:
            stopped = answer["stopped"]
            return cls(
                tuple(info_from(fields) for fields in answer["resources"]),
                None if stopped is None else str(stopped),
                tuple(str(problem) for problem in answer["problems"]),
                texts(answer.get("not_ready", {})),
                None if certificate is None else Rights.of(answer.get("rights"), certificate),
                answer.get("running", ()),
            )
        except (ProtocolError, AttributeError, KeyError, TypeError) as error:
            raise ProtocolError(f"greets in a way that makes no sense: {error_text(error)}") from error
