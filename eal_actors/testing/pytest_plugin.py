"""The pytest plugin: the fixture `simulation`, scenario files as test cases, and the seed in failure reports.

pytest imports this module in every run of every project with the framework installed. So heavy modules are imported
lazily.
"""

from __future__ import annotations

import argparse
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest

if TYPE_CHECKING:
    from eal_actors.testing.simulation import SimulationFactory

_SEED_OPTION: Final = "--eal-seed"
_FACTORY: Final = pytest.StashKey["SimulationFactory"]()


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 0, not {text!r}")
    return int(text)


def _setting(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, not {text!r}")
    return name.strip(), value


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("eal_actors", "simulated fleets of eal_actors")
    group.addoption(
        _SEED_OPTION,
        type=_seed,
        metavar="SEED",
        help="seed of simulations whose test gives none (default: that of their fleet file, or 0)",
    )
    group.addoption(
        "--eal",
        action="store_true",
        help="run scenario files (.yaml) as test cases in simulation, if they have an `expect` or are named explicitly",
    )
    group.addoption("--eal-all", action="store_true", help="also run scenario files without an `expect`")
    group.addoption(
        "--eal-fleet",
        type=Path,
        metavar="FILE",
        help="fleet file for all scenarios, instead of SCENARIO.fleet.yaml or fleet.yaml beside each",
    )
    group.addoption(
        "--eal-set",
        action="append",
        default=[],
        type=_setting,
        metavar="NAME=VALUE",
        help="value of a parameter, for all scenarios that have it; repeatable",
    )
    group.addoption(
        "--eal-keep",
        action="append",
        default=[],
        metavar="PLUGIN",
        help="use this plugin itself, not a simulated one: it must not move anything real; repeatable",
    )


@pytest.fixture
def simulation(request: pytest.FixtureRequest) -> Iterator[SimulationFactory]:
    """Return a function that makes simulated fleets: `simulation({"scout": "roomba"}, world="lab")`.

    They are closed at the end of the test. The test fails if it leaves threads of theirs behind.
    """
    from eal_actors.testing.simulation import SimulationFactory

    factory = SimulationFactory(request.config.getoption(_SEED_OPTION))
    request.node.stash[_FACTORY] = factory
    yield factory
    del request.node.stash[_FACTORY]  # pytest keeps its items to the end
    made = factory.describe()
    if left := factory.close():
        pytest.fail(f"threads of the fleet outlive the test: {', '.join(left)}\n{made}", pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the seed that repeats a failure to its report."""
    report = yield
    factory = item.stash.get(_FACTORY, None)
    if factory is not None and report.failed:
        report.sections.append(("eal_actors simulations", factory.describe()))
    return report


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect scenario files as test cases, with --eal."""
    if not parent.config.getoption("--eal") or file_path.suffix not in (".yaml", ".yml"):
        return None
    from eal_actors.testing.scenario_cases import collect_scenario

    return collect_scenario(file_path, parent)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Refuse values for parameters that no scenario has."""
    if config.getoption("--eal") and config.getoption("--eal-set"):
        from eal_actors.testing.scenario_cases import check_settings

        check_settings(config, items)
