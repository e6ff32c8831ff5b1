"""Sampling ends although the code of a plugin does not."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest

from eal_actors import EALData, Fleet, ResourceHandle
from eal_actors.recording import sampler
from eal_actors.recording.sampler import Sampler, SampleSpec
from tests.plugin_files import write_plugin

CODE = """
import threading
from eal_actors.plugin import *

class Probe(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE)
    any_thread = True

    def __init__(self, gate):
        self._gate = gate

    def get_value(self):
        self._gate.wait()
        return 1.5

def create_Probe(context):
    return Probe(context.services.shared("gate", threading.Event))
"""


def test_a_resource_that_is_stuck_in_the_samplers_thread_delays_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sampler, "_END_S", 0.1)
    write_plugin(tmp_path, "probe", CODE, "Probe")
    robots: dict[str, object] = {"r": {"plugins": {"probe": {}}}}
    content = {"version": 1, "clock": {"rate": "max"}, "plugin_dirs": ["plugins"], "robots": robots}
    (tmp_path / "f.yaml").write_text(json.dumps(content))
    values: list[EALData] = []

    def keep(_resource: ResourceHandle, value: EALData) -> bool:
        values.append(value)
        return True

    with Fleet.load(tmp_path / "f.yaml") as fleet:
        gate = fleet.services.shared("gate", threading.Event)
        sampling = Sampler(fleet.clock, [SampleSpec(fleet["r"]["Probe"], 0.1)], keep)
        with sampling:
            pass
        gate.set()
        sampling._thread.join()
    assert values == []  # what comes later would go into a closed file
    assert "while it is sampled" in capfd.readouterr().err


CLOCK = """
from eal_actors.plugin import *

class Probe(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE)

    def __init__(self, clock):
        self._clock = clock

    def get_value(self):
        return self._clock.now()

def create_Probe(context):
    return Probe(context.clock)
"""


def test_a_value_without_a_time_stamp_has_the_time_at_which_it_was_asked_for(tmp_path: Path) -> None:
    """It is collected when the next one is due."""
    write_plugin(tmp_path, "probe", CLOCK, "Probe")
    robots: dict[str, object] = {"r": {"plugins": {"probe": {}}}}
    content = {"version": 1, "clock": {"rate": "max"}, "plugin_dirs": ["plugins"], "robots": robots}
    (tmp_path / "f.yaml").write_text(json.dumps(content))
    values: list[EALData] = []

    def keep(_resource: ResourceHandle, value: EALData) -> bool:
        values.append(value)
        return True

    fleet = Fleet.load(tmp_path / "f.yaml").connect()
    with fleet, Sampler(fleet.clock, [SampleSpec(fleet["r"]["Probe"], 0.2)], keep):
        fleet.clock.sleep(1.0)
    assert len(values) > 4
    assert [value.stamp_s for value in values] == [value.value for value in values]
