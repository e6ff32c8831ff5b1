"""Whether this program can listen where others are to reach it, and which program keeps it from that."""

from __future__ import annotations

import errno
import ipaddress
import socket
from collections.abc import Sequence

from eal_actors.device.port_holders import listeners
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.network_model import parse_endpoint


def require_free(endpoints: Sequence[str]) -> None:
    """Raise UnavailableError if another program listens at one of some endpoints.

    The session notices it too, but is opened when the robot has started, which takes seconds. Names of hosts and UDP
    are left to the session.
    """
    for text in endpoints:
        endpoint = parse_endpoint(text)
        try:
            version = ipaddress.ip_address(endpoint.host).version
            if endpoint.protocol in ("tcp", "tls"):
                family = socket.AF_INET6 if version == 6 else socket.AF_INET
                socket.create_server((endpoint.host, endpoint.port), family=family).close()
        except ValueError:  # a name, which a name server may take its time for
            continue
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise in_use([text]) from error


def in_use(endpoints: Sequence[str]) -> UnavailableError:
    """Return the error about endpoints at one of which another program listens."""
    programs = [str(program) for text in endpoints for program in listeners(parse_endpoint(text).port)]
    holder = ", ".join(programs) or "another program"
    return UnavailableError(f"{', '.join(endpoints)}: cannot listen there: the port is in use by {holder}")
