"""Time-outs of the thesis's programs, on a robot whose resource uses the thesis's data."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.classic import EAL, FLOAT, EALconnect, EALDataInfo_t, EALdisconnect
from tests.plugin_files import write_plugin

STUCK = '''
from eal_actors.plugin import *

class Slow(Resource):
    """Takes long."""
    @command("wait")
    def wait(self):
        yield 1e9
    @request("data")
    def data(self):
        from eal_actors.classic import FLOAT, EALDataInfo_t
        return EALDataInfo_t(FLOAT, 0.5)
'''


@pytest.fixture
def slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[EAL]:
    """A connection to a robot whose command never ends, on a clock that runs fast."""
    write_plugin(tmp_path, "slow", STUCK, "Slow")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "version: 1\nplugin_dirs: [plugins]\nclock: {rate: max}\ndefaults: {timeout_s: 1e6}\n"
        "robots:\n  one: {plugins: {slow: {}}}\n"
    )
    monkeypatch.setenv("EAL_FLEET", str(fleet))
    client = EALconnect()
    assert client is not None
    yield client
    EALdisconnect(client)


def test_a_program_sets_the_time_out_of_its_calls(slow: EAL) -> None:
    clock = slow._eal._robot.clock
    began_s = clock.now()
    slow.timeout_s = 60
    assert slow.sendCmd(slow.findResource("Slow"), "wait", None) == -1
    assert clock.now() - began_s == pytest.approx(60, abs=1)


def test_any_resource_may_return_the_data_of_the_thesis(slow: EAL) -> None:
    assert slow.sendReq(slow.findResource("Slow"), "data") == EALDataInfo_t(FLOAT, 0.5, 4)
