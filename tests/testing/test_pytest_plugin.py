"""The pytest plugin in test files that a separate pytest runs."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

PLUGIN = "eal_actors.testing.pytest_plugin"
ROOT = Path(__file__).parents[2]
LIMIT_S = 60.0
PYTHON_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def run(pytester: pytest.Pytester, text: str, *options: str) -> pytest.RunResult:
    """Run a file of tests in a process of its own."""
    pytester.makepyfile(text)
    return run_all(pytester, *options)


def run_all(pytester: pytest.Pytester, *options: str) -> pytest.RunResult:
    """Run the folder's tests; name the plugin if the installed metadata lacks it."""
    is_installed = any(point.value == PLUGIN for point in entry_points(group="pytest11"))
    named = [] if is_installed else ["-p", PLUGIN]
    return pytester.runpytest_subprocess("-p", "no:cacheprovider", *named, *options, timeout=LIMIT_S)


def test_a_users_tests_pass(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
        def test_a_robot_drives(simulation):
            world = simulation({"scout": {"model": "roomba", "start": (0, 0), "noise": False}})
            world["scout"]["Base"].send_cmd("f0.5")
            world.advance(20)
            assert 0.45 < world.pose("scout").x_m < 0.55

        def test_two_worlds_one_after_the_other(simulation):
            for seed in (1, 2):
                world = simulation({"scout": "roomba"}, "lab", seed=seed)
                world.advance(1.0)
                assert (world.seed, world.now_s) == (seed, 1.0)

        def test_a_fixture_nobody_calls(simulation):
            pass
        """,
        "-W",
        "error",
        "--strict-markers",
    )
    result.assert_outcomes(passed=3)
    assert result.stderr.str() == ""
    result.stdout.no_fnmatch_line("*--eal-seed*")


def test_a_failure_tells_the_seed_that_repeats_it(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
        def test_fails(simulation):
            world = simulation({"scout": "roomba", "mate": "evbot2"})
            other = simulation({"scout": "roomba"}, seed=3)
            world.advance(2.5)
            assert world.seed == 0 and other.seed == 0

        def test_fails_without():
            assert False
        """,
        "--eal-seed=12",
    )
    result.assert_outcomes(failed=2)
    result.stdout.fnmatch_lines(
        [
            "*- eal_actors simulations -*",
            "<Simulation of scout, mate: open>, 2.5 s since the start, --eal-seed=12",
            "<Simulation of scout: open>, 0 s since the start, --eal-seed=3",
        ]
    )
    assert result.stdout.str().count("eal_actors simulations") == 1


def test_what_cannot_be_made_fails_the_test_with_the_reason(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
        def test_fails(simulation):
            simulation({"scout": "roomba"}, "labb")
        """,
    )
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["E *simulation: world: there is no bundled world 'labb'*; did you mean 'lab'?"])


def test_threads_that_outlive_a_test_fail_it(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
        import threading

        FOREVER = threading.Event()

        def test_leaves_a_thread_behind(simulation):
            world = simulation({"scout": "roomba"})
            world.fleet.clock.start(threading.Thread(target=FOREVER.wait, name="my controller", daemon=True))

        def test_is_not_blamed(simulation):
            simulation({"scout": "roomba"}).advance(1.0)
        """,
    )
    result.assert_outcomes(passed=2, errors=1)
    result.stdout.fnmatch_lines(["*threads of the fleet outlive the test: my controller*", "*--eal-seed=0*"])


def test_robots_are_halted_and_gone_when_the_test_is_over(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
        import threading

        KEPT = []

        def test_leaves_a_robot_driving(simulation):
            KEPT.append(simulation({"scout": "roomba"}))
            KEPT.append(KEPT[0]["scout"]["Base"].send_cmd("f2"))
            KEPT[0].advance(0.5)

        def test_nothing_is_left():
            drive, world = KEPT.pop(), KEPT.pop()
            assert repr(world) == "<Simulation of scout: closed>"
            assert drive.done()
            assert drive.exception() is not None
            assert not [thread for thread in threading.enumerate() if "scout" in thread.name]
        """,
    )
    result.assert_outcomes(passed=2)


@pytest.mark.slow
def test_the_tests_of_the_documentation_pass(pytester: pytest.Pytester) -> None:
    page = (ROOT / "docs/testing.md").read_text()
    blocks = [block for block in PYTHON_BLOCK.findall(page) if "def test_" in block]
    for number, block in enumerate(blocks):
        (pytester.path / f"test_block_{number}.py").write_text(block)
    for folder in ("fleets", "scenarios"):
        (pytester.path / folder).symlink_to(ROOT / folder)

    run_all(pytester).assert_outcomes(passed=6)

    assert len(blocks) == 4


@pytest.mark.parametrize("seed", ["-1", "many", "1.5"])
def test_a_seed_is_a_whole_number(pytester: pytest.Pytester, seed: str) -> None:
    result = run(pytester, "", f"--eal-seed={seed}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([f"*argument --eal-seed: must be a whole number of at least 0, not '{seed}'"])


def test_each_plugin_is_declared_under_the_name_of_its_module() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = project["entry-points"]["pytest11"]
    assert PLUGIN in declared
    assert all(name == module for name, module in declared.items())


def test_runs_that_do_not_use_it_import_nothing_heavy() -> None:
    heavy = (
        "eal_actors.testing.simulation",
        "eal_actors.scenario",
        "numpy",
        "pymunk",
        "matplotlib",
        "zenoh",
        "pykka",
        "pydantic",
        "structlog",
    )
    program = f"import sys, {PLUGIN}; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=LIMIT_S
    )
    assert done.stdout == "[]\n"
