"""The outline of a scenario, as text, as JSON and as a picture."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

from eal_actors.kernel.bundled import bundled_path
from eal_actors.recording.outline_picture import draw_outline
from eal_actors.scenario import load_scenario, parse_scenario
from eal_actors.scenario.report.outline import outline

TEXT = """\
version: 1
name: fetch
parameters: {way_m: {type: double, default: 0.5}}
roles: {scouts: {tags: [indoor], min: 2}}
steps:
  - on: scouts
    do:
      - if: value('Bump')
        then: [{send_cmd: {resource: Base, cmd: b0.1}}]
        else: [{send_cmd: {resource: Base, cmd: "f${way_m}"}}]
finally:
  - on: scouts
    do: [{send_cmd: {resource: Base, cmd: s}}]
"""


def test_each_step_is_a_line_below_its_block() -> None:
    lines = [(one.depth, one.text, one.line) for one in outline(parse_scenario(TEXT, "fetch.yaml"))]
    assert lines == [
        (0, "role scouts: indoor, at least 2", 4),
        (0, "steps", 5),
        (1, "on scouts", 6),
        (2, "if value('Bump')", 8),
        (3, "then", 9),
        (4, "send_cmd Base b0.1", 9),
        (3, "else", 10),
        (4, "send_cmd Base f0.5", 10),
        (0, "finally", 11),
        (1, "on scouts", 12),
        (2, "send_cmd Base s", 13),
    ]


def test_every_shipped_scenario_has_a_picture_of_all_its_lines() -> None:
    for file in sorted(Path(bundled_path("scenarios")).glob("*.yaml")):
        lines = list(outline(load_scenario(file)))
        picture = Xml.fromstring(draw_outline(lines))  # noqa: S314  # our own
        texts = {"".join(node.itertext()) for node in picture.iter("{http://www.w3.org/2000/svg}text")}
        assert {line.text for line in lines} <= texts, file.name
