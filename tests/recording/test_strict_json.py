"""Every file and stream of a run is standard JSON, whatever the sensors return."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.managers.config import EALConfigManager
from eal_actors.recording import RunRecorder
from eal_actors.recording.mcap_file import McapContent, read_mcap
from eal_actors.recording.recorded_run import RecordedRun
from eal_actors.scenario import Run, load_scenario, make_plan, summary_schema
from tests.plugin_files import write_plugin

PLUGIN = """\
import math

import numpy as np

from eal_actors.plugin import DataType, EALPlugin, Resource, ResourceType, ValueInfo, request


class Scan(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "m", shape=(4,))

    def get_value(self):
        return np.array([1.0, math.inf, math.nan, -math.inf])

    @request("angles", ValueInfo(DataType.DOUBLE, "rad", shape=(4,)))
    def angles(self):
        return np.array([-0.3, -0.1, 0.1, 0.3])


class Level(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(2, 2))

    def get_value(self):
        return np.array([[math.nan, 1.0], [-math.inf, 2.0]])


class Hot(Resource):
    types = ResourceType.SENSOR

    def get_value(self):
        return math.nan

"""

SCENARIO = """\
version: 1
name: odd
roles: {all: {}}
safe_to_repeat: true
steps:
  - on: all
    do:
      - get_value: {resource: Scan}
        save_as: scan
        save: scan.json
      - get_value: {resource: Level}
        save: level.json
      - get_value: {resource: Hot}
        save_as: hot
      - let: {farthest_m: "scan[1]", all: "[scan, hot]"}
      - signal: seen
        value: "${hot}"
      - signal: scanned
        value: "${scan}"
      - log: "${hot} and ${farthest_m}"
      - expect: hot
        equals: 1
        on_failure: skip
"""


def strict(text: str) -> Any:
    """Read JSON as a reader does that knows the standard alone."""

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def odd_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("odd")
    write_plugin(folder, "odd", PLUGIN, "Scan", "Level", "Hot")
    (folder / "fleet.yaml").write_text(
        "version: 1\nname: odds\nclock: {rate: max}\nplugin_dirs: [plugins]\nrobots:\n  a: {plugins: {odd: {}}}\n"
    )
    (folder / "odd.yaml").write_text(SCENARIO)
    run = folder / "run"
    run.mkdir()
    with Fleet(EALConfigManager.load(folder / "fleet.yaml", environment={}).fleet).connect() as fleet:
        recorder = RunRecorder(fleet, fleet, run, "sensors")
        with recorder:
            plan = make_plan(load_scenario(folder / "odd.yaml"), fleet)
            report = Run(plan, fleet, run, [recorder.hear]).start().get(timeout=60)
    assert report.outcome == "done", report
    return run


def test_every_line_and_file_is_strict_json(odd_run: Path) -> None:
    events = [strict(line) for line in (odd_run / "events.jsonl").read_text(encoding="utf-8").splitlines()]
    values = {event["name"]: event["value"] for event in events if event["event"] == "signal"}
    assert values == {"seen": "NaN", "scanned": [1.0, "Infinity", "NaN", "-Infinity"]}
    jsonschema.validate(strict((odd_run / "summary.json").read_text(encoding="utf-8")), summary_schema())
    assert strict((odd_run / "a/scan.json").read_text()) == [1.0, "Infinity", "NaN", "-Infinity"]
    assert strict((odd_run / "a/level.json").read_text()) == [["NaN", 1.0], ["-Infinity", 2.0]]
    (line,) = [event["text"] for event in events if event["event"] == "log"]
    assert line == "nan and inf"


def test_infinities_and_nan_can_be_read_back(odd_run: Path) -> None:
    recorded = RecordedRun.open(odd_run / "run.mcap")
    for resource, wanted in (
        ("Scan", [1.0, math.inf, math.nan, -math.inf]),
        ("Level", [[math.nan, 1.0], [-math.inf, 2.0]]),
        ("Hot", math.nan),
    ):
        value = recorded.value_at("a", resource, 1.0)
        assert value is not None
        np.testing.assert_array_equal(value.value, wanted)


def problems_of(content: McapContent) -> Iterator[str]:
    """Yield where messages are not what the schema that the file declares for them says."""
    validators = {name: jsonschema.Draft202012Validator(schema) for name, schema in content.schemas.items()}
    for validator in validators.values():
        validator.check_schema(validator.schema)
    for entry in content.messages:
        for error in validators[entry.schema].iter_errors(entry.message):
            yield f"{entry.topic} at {entry.time_s}: {error.json_path}: {error.message}"


def every_key_declared(schema: Any, message: Any, path: str = "$") -> Iterator[str]:
    """Yield what a message has that its schema does not tell of; schemas that tell of no properties take any."""
    if isinstance(message, dict) and "properties" in schema:
        for key, item in message.items():
            if key not in schema["properties"]:
                yield f"{path}.{key}"
            else:
                yield from every_key_declared(schema["properties"][key], item, f"{path}.{key}")
    elif isinstance(message, list) and "items" in schema:
        for item in message:
            yield from every_key_declared(schema["items"], item, f"{path}[]")


def test_every_message_matches_its_schema(odd_run: Path, run: Path) -> None:
    for folder in (odd_run, run):
        content = read_mcap(folder / "run.mcap")
        assert len(content.messages) > 10
        assert list(problems_of(content)) == []
        for entry in content.messages:
            if entry.schema != "eal.Event":  # of which only the common keys are declared
                assert list(every_key_declared(content.schemas[entry.schema], entry.message)) == [], entry.topic
    assert {"foxglove.LaserScan", "foxglove.CompressedImage", "foxglove.PoseInFrame"} <= set(content.schemas)


def test_the_reader_of_the_mcap_library_reads_the_record(run: Path) -> None:
    """Another implementation than ours, which trusts the index, sees the same messages in the order of time."""
    from mcap.reader import make_reader

    with (run / "run.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        found = [
            (channel.topic, message.log_time, strict(message.data.decode()))
            for _, channel, message in reader.iter_messages()
        ]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(found)
    times = [time_ns for _, time_ns, _ in found]
    assert times == sorted(times)
    ours = read_mcap(run / "run.mcap").messages
    assert sorted(topic for topic, _, _ in found) == sorted(entry.topic for entry in ours)
