"""Each check of a soak finds what it is there for, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.soak.checks import CHECKS
from tests.soak.history import RELAYS, Fault, History, merged, overlap_s
from tests.soak.programs import Sample
from tests.soak.report import Growth, Report, tables
from tests.soak.run import Outcome, Plan

WARDEN = """\
1.0 up 7
1.5 state r1 ready
10.0 sent 1 r1 Wheels 2.0
12.1 done 1 ok
20.0 sent 2 r1 Pen 2.0
20.1 done 2 ok
30.0 read ok
60.0 state r1 lost
63.0 state r1 ready
90.0 leaving
90.5 left
"""
RIVAL = """\
1.0 up 8
40.0 sent 9 r1 Wheels 6.0
"""
R1 = """\
10.1 begin 1
12.0 end 1
12.0 rest 1
20.05 mark 2
40.1 begin 9
42.5 rest 9
42.5 halt 0
"""


def good() -> History:
    """Return a history in which a rival is killed while it moves a robot, and a link is stalled."""
    history = History(end_s=80.0, dead_man_s=1.0, lease_s=1.0)
    history.faults += [Fault("kill", "rival#1", 41.0, 45.0), Fault("stall", "r1", 58.0, 62.0)]
    history.faults += [Fault("freeze", "warden#1", 25.0, 39.9)]  # after which the rival may command
    history.read_controller("warden#1", WARDEN.splitlines())
    history.read_controller("rival#1", RIVAL.splitlines())
    history.read_robot("r1", R1.splitlines())
    return history


def findings(history: History) -> dict[str, list[str]]:
    return {name: found for name, check in CHECKS.items() if (found := list(check(history)))}


def test_a_good_history_is_found_good() -> None:
    assert findings(good()) == {}


@pytest.mark.parametrize(
    ("check", "line", "instead"),
    [
        ("no command runs twice", "20.05 mark 2", "20.05 mark 2\n21.0 mark 2"),
        ("no command runs late", "20.05 mark 2", "23.1 mark 2"),
        ("no command runs late", "20.05 mark 2", "22.3 mark 2"),
        ("no motion outlives its deadline", "12.0 rest 1", "12.4 rest 1"),
        ("no robot moves without a live controller", "42.5 rest 9", "44.5 rest 9"),
        ("no robot moves without a live controller", "42.5 rest 9", "55.0 halt 0"),
        ("commands keep their order", "20.05 mark 2", "20.05 mark 2\n20.06 mark 1"),
        ("one motion at a time", "12.0 rest 1", "40.2 rest 1"),
        ("reported commands are done", "12.0 end 1", "12.0 halt 0"),
        ("reported commands are done", "20.05 mark 2", "20.05 halt 0"),
    ],
)
def test_what_a_robot_may_not_do_is_found(check: str, line: str, instead: str) -> None:
    history = good()
    history.read_robot("r1", R1.replace(line, instead).splitlines())
    assert check in findings(history)


@pytest.mark.parametrize(
    ("check", "line", "instead"),
    [
        ("every command has its outcome in time", "20.1 done 2 ok", "24.1 done 2 deadline"),
        ("every command has its outcome in time", "20.1 done 2 ok", "30.0 read ok"),
        ("every command has its outcome in time", "90.0 leaving", "89.0 unsettled 3\n90.0 leaving"),
        ("every lasting fault is in the record", "60.0 state r1 lost", "60.0 read ok"),
        ("every lasting fault is in the record", "60.0 state r1 lost", "61.5 state r1 lost"),
        ("everybody finds together again", "63.0 state r1 ready", "63.0 read ok"),
    ],
)
def test_what_a_controller_may_not_see_is_found(check: str, line: str, instead: str) -> None:
    history = good()
    for command in history.commands.values():
        command.outcome = None
    history.read_controller("warden#1", WARDEN.replace(line, instead).splitlines())
    assert check in findings(history)


def test_a_second_master_is_found() -> None:
    history = good()
    history.faults.pop()
    assert list(findings(history)) == ["one controller at a time"]


@pytest.mark.parametrize(("line", "instead"), [("20.05 mark 2", "22.4 mark 2"), ("12.0 rest 1", "12.4 rest 1")])
def test_short_waits_for_a_processor_are_summed(line: str, instead: str) -> None:
    history = good()
    history.read_robot("r1", R1.replace(line, instead).splitlines())
    assert findings(history)
    after_s = float(instead.split()[0])
    history.waits["r1"] = [((after_s - 0.3, after_s - 0.2), 0.1)]
    assert findings(history)
    history.waits["r1"].append(((after_s - 0.1, after_s), 0.1))
    assert findings(history) == {}


@pytest.mark.parametrize("who", ["warden#1", "r1", RELAYS])
def test_who_has_no_processor_is_as_silent_as_who_is_frozen(who: str) -> None:
    history = good()
    history.faults.pop()
    history.hungry[who] = [(35.0, 36.5)]
    assert findings(history) == {}
    history.hungry[who] = [(41.0, 42.5)]
    assert list(findings(history)) == ["one controller at a time"]


def test_an_outcome_may_wait_for_a_processor() -> None:
    history = good()
    history.commands[2].done_s = 25.0
    assert list(findings(history)) == ["every command has its outcome in time"]
    history.hungry["warden#1"] = [(22.0, 24.0)]
    assert findings(history) == {}


def test_a_freeze_may_catch_one_command_in_the_act_and_no_more() -> None:
    late = R1.replace("20.05 mark 2", "24.0 mark 2")
    history = good()
    history.commands[2].done_s = 24.1
    history.commands[2].timeout_s = 2.0
    history.faults.append(Fault("freeze", "r1", 20.01, 23.99))
    history.read_robot("r1", late.splitlines())
    assert "no command runs late" not in findings(history)
    history.commands[3] = replace(history.commands[2], number=3)
    history.read_robot("r1", late.replace("24.0 mark 2", "24.0 mark 2\n24.0 mark 3").splitlines())
    assert "no command runs late" in findings(history)


def test_a_frozen_robot_halts_when_it_wakes() -> None:
    history = good()
    history.faults.append(Fault("freeze", "r1", 41.5, 50.0))
    history.read_robot("r1", R1.replace("42.5 rest 9", "50.2 rest 9").splitlines())
    assert "no robot moves without a live controller" not in findings(history)
    history.read_robot("r1", R1.replace("42.5 rest 9", "53.2 rest 9").splitlines())
    assert "no robot moves without a live controller" in findings(history)


def test_a_motion_ends_with_its_process() -> None:
    history = good()
    history.faults.append(Fault("kill", "r1", 41.5, 50.0))
    history.read_robot("r1", R1.replace("42.5 rest 9", "51.0 halt 0").splitlines())
    assert [motion.rest_s for motion in history.motions("r1")] == [12.0, 41.5]


def test_intervals() -> None:
    assert merged([(3, 4), (1, 2), (1.5, 2.5), (2.5, 2.6)]) == [(1, 2.6), (3, 4)]
    assert overlap_s((1, 10), [(0, 2), (3, 4), (9, 20)]) == 3


@pytest.mark.parametrize(
    ("memory_bytes", "threads", "engine_threads", "files", "problems"),
    [
        (0, 0, 0, 0, 0),
        (100_000, 0, 0, 0, 1),
        (0, 1, 0, 0, 1),
        (0, 0, 1, 0, 1),
        (0, 0, 0, 1, 1),
    ],
)
def test_what_grows_is_found(memory_bytes: int, threads: int, engine_threads: int, files: int, problems: int) -> None:
    """Of something that grows by so much in each of three hundred samples."""
    samples = [
        Sample(n, 50_000_000 + n * memory_bytes, 7 + n * threads, 9 + n * engine_threads, 20 + n * files, frozenset())
        for n in range(300)
    ]
    assert len(list(Growth.of("warden", samples).problems())) == problems


def test_a_report_tells_every_finding() -> None:
    history = good()
    history.read_robot("r1", R1.replace("20.05 mark 2", "20.05 mark 2\n21.0 mark 2").splitlines())
    outcome = Outcome(Plan(robots=1, duration_s=80.0), history, is_started=False, exits=["r1 ended with 1"])
    outcome.samples["warden"] = [Sample(n, 50_000_000, 7, 9, 20, frozenset()) for n in range(10)]
    report = Report.of(outcome)
    assert not report.holds
    assert report.to_dict()["findings"]["no command runs twice"] == ["r1: command 2 ran 2 times"]
    for text in (tables(report.to_dict()), "\n".join(report.lines())):
        assert "r1: command 2 ran 2 times" in text
        assert "r1 ended with 1" in text
        assert "not all robots were ready" in text
    assert "| fault | times |\n| --- | --- |\n| freeze | 1 |\n| kill | 1 |" in tables(report.to_dict())
    assert "| warden | +0.0 MB | 50 MB | +0 | +0 | +0 |" in tables(report.to_dict())
