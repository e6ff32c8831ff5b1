"""A robot that sends strange values spoils no record of the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.recording import LiveRecord, RunFolder
from tests.plugin_files import write_plugin

CODE = """
import numpy as np
from eal_actors.plugin import *

class Probe(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE)

    def get_value(self):
        return {value}

    @request("angles")
    def angles(self):
        return "all round"

class Base(Resource):
    types = ResourceType.SENSOR

    @config("radius_m", ValueInfo(DataType.DOUBLE))
    def radius_m(self):
        return "large"
"""
HONEST = "EALData.of(1.5)"
STRANGE = {
    "a time far in the future": "EALData.of(1.5, stamp_s=1e300)",
    "a time after the year 2554, which the file cannot have": "EALData.of(1.5, stamp_s=1e12)",
    "a time long ago": "EALData.of(1.5, stamp_s=-1e300)",
    "an empty image": "EALData.of(np.zeros((0, 0, 3), np.uint8))",
    "a number that is none": "EALData.of(float('nan'))",
}


@pytest.mark.parametrize("value", STRANGE.values(), ids=STRANGE.keys())
def test_strange_values_of_one_robot_spoil_no_record_of_another(tmp_path: Path, value: str) -> None:
    write_plugin(tmp_path, "honest", CODE.format(value=HONEST), "Probe", "Base")
    write_plugin(tmp_path, "strange", CODE.format(value=value), "Probe", "Base")
    robots: dict[str, object] = {name: {"plugins": {name: {}}} for name in ("strange", "honest")}
    fleet_file = tmp_path / "f.yaml"
    fleet_file.write_text(json.dumps({"version": 1, "name": "f", "plugin_dirs": ["plugins"], "robots": robots}))
    folder = tmp_path / "record"
    folder.mkdir()
    with Fleet.load(fleet_file).connect() as fleet, LiveRecord(fleet, folder, "all"):
        REAL_TIME.sleep(1.5)
    run = RunFolder.open(folder)
    assert run.summary is not None
    messages = [message for message in run.record.messages if message.topic == "/honest/Probe"]
    assert len(messages) >= 4
    assert max(message.time_s for message in run.record.messages) <= run.summary.duration_s + 0.5
