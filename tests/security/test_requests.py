"""Calls that look like readings and are none: requests in free text may do anything, and bytes are read once."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import AccessDeniedError
from tests.net.rig import WAIT_S, ready
from tests.security.forging import as_seen_by, make_keys, secure_rig


def test_an_observer_sends_declared_requests_alone(tmp_path: Path) -> None:
    """Its requests in free text were carried out: calls of services and instant actions, for robots that have them."""
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), dead_man_s=60.0)
    with rig.served_here(), ready(Fleet(as_seen_by(rig.config, "display"))) as display:
        robot = display["r1"]
        assert robot["Watch"].send_req("age", timeout_s=WAIT_S).get().value == -1.0
        with pytest.raises(AccessDeniedError, match="r1/Line: does not grant a request in free text to 'display'"):
            robot["Line"].send_req("fetch the cup", timeout_s=WAIT_S).get()
        with ready(Fleet(rig.config)) as controller:
            line = controller["r1"]["Line"]
            line.send_req("of the controller", timeout_s=WAIT_S).get()
            written = line.read_comm(100, timeout_s=WAIT_S).get()
    assert bytes(written.payload) == b"of the controller"


def test_an_observer_takes_no_bytes_from_a_controller(tmp_path: Path) -> None:
    """It got the answer of a device, and the controller waited for it in vain."""
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), dead_man_s=60.0)
    with (
        rig.served_here(),
        ready(Fleet(as_seen_by(rig.config, "display"))) as display,
        ready(Fleet(rig.config)) as fleet,
    ):
        line = fleet["r1"]["Line"]
        line.write_comm("of the device", timeout_s=WAIT_S).get()
        with pytest.raises(AccessDeniedError, match="r1/Line: does not grant read_comm to 'display'"):
            display["r1"]["Line"].read_comm(100, timeout_s=WAIT_S).get()
        assert bytes(line.read_comm(100, timeout_s=WAIT_S).get().payload) == b"of the device"
