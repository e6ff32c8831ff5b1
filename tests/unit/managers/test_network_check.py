"""Checks of the whole fleet: clocks and plugins of remote robots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.lock_step import MAX
from eal_actors.managers.config import EALConfigManager
from tests.problems import problem_texts

FLEET = """\
version: 1
clock:
  rate: max
robots:
  here: {plugins: {sample: {}}}
  there: {address: "tcp/127.0.0.1:50000"}
"""
REASON = "rate max is for robots of one process, for processes cannot share its clock: 'there' has an address"


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("f.yaml").write_text(FLEET, encoding="utf-8")
    return Path("f.yaml")


def problems(file: Path) -> list[str]:
    return problem_texts(lambda: EALConfigManager.load(file))


def test_rate_max_with_a_robot_of_another_process_is_refused_where_it_is_written(file: Path) -> None:
    assert problems(file) == [f"f.yaml:3:9: clock.rate: {REASON}"]


def test_also_where_an_included_file_says_so(file: Path) -> None:
    Path("clock.yaml").write_text("version: 1\nclock: {rate: max}\n", encoding="utf-8")
    file.write_text(FLEET.replace("clock:\n  rate: max\n", "include: [clock.yaml]\n"), encoding="utf-8")
    assert problems(file) == [f"clock.yaml:2:15: clock.rate: {REASON}"]


def test_it_is_refused_when_the_rate_comes_later(file: Path) -> None:
    file.write_text(FLEET.replace("rate: max", "rate: 1"), encoding="utf-8")
    fleet = Fleet(replace(EALConfigManager.load(file).fleet, rate=MAX))
    with pytest.raises(ConfigError, match=f"^f.yaml:3:9: clock.rate: {REASON}$"):
        fleet.connect()
    assert len(fleet) == 0
    with fleet.connect(["here"]):
        assert list(fleet) == ["here"]


def test_rate_max_is_fine_within_one_process(file: Path) -> None:
    file.write_text(FLEET.replace('{address: "tcp/127.0.0.1:50000"}', "{plugins: {sample: {}}}"), encoding="utf-8")
    assert EALConfigManager.load(file).fleet.rate == MAX


def test_a_robot_with_an_address_needs_no_plugins_but_to_be_served(file: Path) -> None:
    file.write_text(FLEET.replace("rate: max", "rate: 1"), encoding="utf-8")
    config = EALConfigManager.load(file).fleet
    assert config.robots["there"].plugins == {}
    with pytest.raises(ConfigError, match=r"f.yaml: robots.there: robot 'there' has no plugins here"):
        RobotService(config, "there")


def test_a_robot_without_an_address_needs_plugins(file: Path) -> None:
    file.write_text("version: 1\nrobots: {r: {tags: [a]}}\n", encoding="utf-8")
    (problem,) = problems(file)
    assert "the robot has no plugins" in problem
