"""The pytest plugin: the fixture `simulation`, and the seed where it is needed.

pytest imports this module in every run of every project that has the framework installed, so it imports what is heavy
only where a test uses it.
"""

from __future__ import annotations

import argparse
from collections.abc import Generator, Iterator
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


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the seed."""
    parser.getgroup("eal_actors", "simulated fleets of eal_actors").addoption(
        _SEED_OPTION,
        type=_seed,
        metavar="SEED",
        help="seed of simulations to which their test gives none (0, or that of their fleet file, if left out)",
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
