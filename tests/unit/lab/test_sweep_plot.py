"""The picture of a sweep: quantities, units and robots in words."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest

from eal_actors.lab.sweeping import plot
from eal_actors.lab.sweeping.results import SweepResult, write_junit
from eal_actors.lab.sweeping.sweep import SweepJob
from eal_actors.scenario import load_scenario
from tests.figures import keep_figures

SCENARIO = """\
version: 1
name: drive
parameters:
  way_m: {type: double, default: 1.0, unit: m}
  speed_m_s: {type: double, default: 0.1, unit: m/s}
roles: {all: {}}
steps:
  - log: nothing
"""


def test_panels_and_lines_are_named_for_people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = keep_figures(monkeypatch, plot)
    file = tmp_path / "drive.yaml"
    file.write_text(SCENARIO)
    results = [
        SweepResult(
            SweepJob(f"{way_m}-{speed_m_s}-{seed}", {"way_m": way_m, "speed_m_s": speed_m_s}, {}, seed),
            "done",
            way_m / speed_m_s + seed,
            variables={"evbot2-1.left": way_m, "gap_mm": seed * way_m, "name": "text"},
        )
        for way_m in (1.0, 2.0, 3.0)
        for speed_m_s in (0.1, 0.3)
        for seed in (1, 2, 3)
    ]
    picture = tmp_path / "sweep.png"
    assert plot.draw_sweep(results, load_scenario(file), picture) == picture
    panels = [axes for axes in figures[0].axes if axes.get_visible()]
    assert [axes.get_title() for axes in panels] == ["duration", "left of evbot2-1", "gap"]
    assert [axes.get_xlabel() for axes in panels] == ["way [m]"] * 3
    assert [axes.get_ylabel() for axes in panels] == ["duration [s]", "left", "gap [mm]"]
    legend = [text.get_text() for text in figures[0].legends[0].get_texts()]
    assert legend == ["speed 0.1 m/s", "speed 0.3 m/s"]


def test_a_run_that_is_not_done_is_marked_on_the_axis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its place was missing, so a sweep that failed at one end looked whole."""
    figures = keep_figures(monkeypatch, plot)
    file = tmp_path / "drive.yaml"
    file.write_text(SCENARIO)
    outcomes = {1.0: "done", 2.0: "done", 3.0: "failed", 4.0: "crashed"}
    results = [
        SweepResult(SweepJob(f"{way_m}", {"way_m": way_m}, {}, 0), outcome, way_m)
        for way_m, outcome in outcomes.items()
    ]
    plot.draw_sweep(results, load_scenario(file), tmp_path / "sweep.png")
    (axes,) = figures[0].axes
    measured, crosses = axes.get_lines()
    assert list(np.asarray(measured.get_xdata())) == [1.0, 2.0]
    assert list(np.asarray(crosses.get_xdata())) == [3.0, 4.0]
    assert axes.get_xlim()[1] > 4.0
    assert axes.get_ylim()[0] > 0.0
    assert [text.get_text() for text in figures[0].legends[0].get_texts()] == ["a run is not done"]


def test_lists_are_shown_as_they_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = keep_figures(monkeypatch, plot)
    file = tmp_path / "drive.yaml"
    file.write_text(SCENARIO.replace("way_m: {type: double, default: 1.0, unit: m}", "beds: {type: list, default: []}"))
    results = [
        SweepResult(SweepJob(f"{number}", {"beds": beds}, {}, 0), "done", 1.0, variables={})
        for number, beds in enumerate([("south",), ("south", "east")])
    ]
    plot.draw_sweep(results, load_scenario(file), tmp_path / "sweep.png")
    assert [label.get_text() for label in figures[0].axes[0].get_xticklabels()] == ['["south"]', '["south", "east"]']


def test_characters_that_xml_lacks_are_written_out(tmp_path: Path) -> None:
    """A robot's message may have any."""
    job = SweepJob("run", {"name": "x\x0b"}, {"name": "x\x0b"}, 1)
    write_junit(
        [SweepResult(job, "failed", 1.0, "said \x1b[31m \ud800 \x00 ü\nand more")], "sweep", tmp_path / "junit.xml"
    )
    case = Xml.parse(tmp_path / "junit.xml").find("testsuite/testcase")  # noqa: S314  # written here
    assert case is not None
    assert case.get("name") == "name=x\\x0b seed=1"
    failure = case.find("failure")
    assert failure is not None
    assert failure.get("message") == "said \\x1b[31m \\ud800 \\x00 ü\nand more"
