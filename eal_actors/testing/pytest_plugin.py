"""The pytest plugin: the fixture `simulation`, scenario files as test cases, and the seed where it is needed.

pytest imports this module in every run of every project that has the framework installed, so it imports what is heavy
only where a test uses it.
"""

from __future__ import annotations

import argparse
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest

if TYPE_CHECKING:
    from eal_actors.testing.factory import SimulationFactory

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
        help="seed of simulations to which their test gives none (0, or that of their fleet file, if left out)",
    )
    group.addoption(
        "--eal",
        action="store_true",
        help="run scenario files (.yaml) that hold an `expect`, or are named themselves, as test cases in simulation",
    )
    group.addoption("--eal-all", action="store_true", help="run scenario files without any `expect` as well")
    group.addoption(
        "--eal-fleet",
        type=Path,
        metavar="FILE",
        help="fleet file for all scenarios, in place of SCENARIO.fleet.yaml or fleet.yaml beside each",
    )
    group.addoption(
        "--eal-set",
        action="append",
        default=[],
        type=_setting,
        metavar="NAME=VALUE",
        help="the value of a parameter, for all scenarios that have it; may be repeated",
    )
    group.addoption(
        "--eal-keep",
        action="append",
        default=[],
        metavar="PLUGIN",
        help="a plugin that moves nothing real, and runs as it is; may be repeated",
    )


@pytest.fixture
def simulation(request: pytest.FixtureRequest) -> Iterator[SimulationFactory]:
    """Return a function that makes simulated fleets: `simulation({"scout": "roomba"}, world="lab")`.

    They are closed when the test is over; a test that leaves threads of theirs behind fails.
    """
    from eal_actors.testing.factory import SimulationFactory

    factory = SimulationFactory(request.config.getoption(_SEED_OPTION))
    request.node.stash[_FACTORY] = factory
    yield factory
    del request.node.stash[_FACTORY]  # pytest keeps its items to the end
    made = factory.describe()
    if left := factory.close():
        pytest.fail(f"threads of the fleet outlive the test: {', '.join(left)}\n{made}", pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Say with a failure which seed repeats it."""
    report = yield
    factory = item.stash.get(_FACTORY, None)
    if factory is not None and report.failed:
        report.sections.append(("eal_actors simulations", factory.describe()))
    return report


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Take scenario files for test cases, if that is wanted."""
    if not parent.config.getoption("--eal") or file_path.suffix not in (".yaml", ".yml"):
        return None
    from eal_actors.testing.scenario_cases import collect_scenario

    return collect_scenario(file_path, parent)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Refuse values for parameters that no scenario has: they are misspelt."""
    if config.getoption("--eal") and config.getoption("--eal-set"):
        from eal_actors.testing.scenario_cases import check_settings

        check_settings(config, items)
