"""The controller of a scenario is killed at random moments; another one continues with a copy of the record."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path

import pytest
import zenoh

from eal_actors import Fleet
from tests.net.links import eventually
from tests.net.rig import Rig, ready

PASSES = 12
SCENARIO = f"""
version: 1
name: chores
roles: {{all: {{min: 2}}}}
timeout_s: 60
steps:
- on: all
  do:
  - let: {{first: "1 if value('Arm') > -1 else 2"}}
  - for: {{n: "${{range(first, first + {PASSES})}}"}}
    do:
    - send_cmd: {{resource: Arm, cmd: "step${{n}}"}}
    - if: value('Arm') > -1
      then:
      - send_cmd: {{resource: Arm, cmd: "to${{n}}"}}
    - {{barrier: together, timeout_s: 60}}
"""
"""A step must never be carried out twice; driving to a place may."""
CONTROLLER = """
import sys
from pathlib import Path

from eal_actors import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Run, load_scenario, make_plan, read_run
from tests.net.rig import ready

fleet_file, run_folder, is_resumed = sys.argv[1], Path(sys.argv[2]), len(sys.argv) > 3
scenario = load_scenario(run_folder.parent / "chores.yaml")
with ready(Fleet(EALConfigManager.load(fleet_file).fleet)) as fleet:
    plan = make_plan(scenario, fleet)
    try:
        resumption = read_run(run_folder) if is_resumed else None
        run = Run(plan, fleet, run_folder, [lambda event: print(event.kind, flush=True)], resumption)
    except ScenarioError as error:
        print("refused:", error, flush=True)
        sys.exit(3)
    report = run.start().get()
    print("outcome", report.outcome, report.error, flush=True)
"""


@dataclass
class Tally:
    """Counts of kills and of their consequences.

    Attributes:
        kills: the controllers that were killed during their run.
        resumed: those whose run another one continued.
        refused: those after which a command was under way that is not safe to repeat.
        done: the runs that came to their end.
        repeated: commands that were carried out twice, and must not be.
        late: commands that came after later ones.
    """

    kills: int = 0
    resumed: int = 0
    refused: int = 0
    done: int = 0
    repeated: int = 0
    late: int = 0


def controller(rig: Rig, folder: Path, *, kill_after: int, is_resumed: bool) -> Iterator[str]:
    """Yield the lines of a controller, which is killed after so many events."""
    words = [str(rig.file), str(folder / "run"), *(["resume"] if is_resumed else [])]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    with subprocess.Popen(
        [sys.executable, "-c", CONTROLLER, *words], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        for number, line in enumerate(process.stdout):
            if number == kill_after:
                process.kill()
            yield line.strip()
    assert process.returncode in (0, 3, -signal.SIGKILL), "a controller ended by an error of its own; see its traceback"


def is_free(rig: Rig) -> bool:
    """Return whether no controller holds a resource."""
    with ready(Fleet(rig.config)) as fleet:
        return not any(robot.ping().get().holders for robot in fleet.values())


def judge(rig: Rig, tally: Tally, *, is_done: bool) -> None:
    """Count, by the robots' own notes, what was carried out twice or late, and start new notes."""
    for robot in ("r1", "r2"):
        notes = rig.notes("step", "begin", robot=robot)
        steps = [int(note.what) for note in notes if note.event == "step"]
        order = [int(note.what.removeprefix("to")) for note in notes]
        tally.repeated += len(steps) - len(set(steps))
        tally.late += sum(later < earlier for earlier, later in pairwise(order))
        assert not is_done or sorted(set(steps)) == list(range(1, PASSES + 1))
    rig.notes_file.write_text("", encoding="utf-8")


def live(folder: Path, kills: int, seed: int) -> Tally:
    """Run the scenario again and again, until so many of its controllers were killed."""
    rig = Rig(folder, ["r1", "r2"], network={"lease_s": 1.5})  # less than the dead man's time
    chance, tally = random.Random(seed), Tally()  # noqa: S311
    with rig.served_here():
        for number in count():
            assert eventually(lambda: is_free(rig))  # a new run does not wait for what a dead controller holds
            place = folder / f"machine-{number}"
            place.mkdir()
            (place / "chores.yaml").write_text(SCENARIO, encoding="utf-8")
            is_resumed = False
            while True:
                kill_after = chance.randrange(1, 5 * PASSES) if tally.kills < kills else 10**6
                lines = list(controller(rig, place, kill_after=kill_after, is_resumed=is_resumed))
                last = lines[-1] if lines else ""
                if last.startswith(("outcome", "refused")):
                    break
                tally.kills += 1
                tally.resumed += is_resumed
                place = Path(shutil.copytree(place, f"{place}x"))  # another machine
                is_resumed = True
            # A controller that was killed between the last line of its record and its answer has nothing left to do.
            is_done = last == "outcome done None" or "has ended; only an interrupted run can be resumed" in last
            tally.refused += not is_done
            tally.done += is_done
            assert is_done or "was under way, and is not safe to repeat" in last, last
            judge(rig, tally, is_done=is_done)
            if tally.kills >= kills:
                return tally
    raise AssertionError


@pytest.mark.parametrize("kills", [2, pytest.param(100, marks=[pytest.mark.slow, pytest.mark.timeout(3000)])])
def test_no_command_is_carried_out_twice_or_late(kills: int, tmp_path: Path) -> None:
    """Runs that ended inside an `on` were refused, or repeated all of it."""
    seed = random.SystemRandom().randrange(1000)
    print(f"seed {seed}")  # noqa: T201  # shown on failure
    tally = live(tmp_path, kills, seed)
    print(tally)  # noqa: T201  # shown with -rP
    assert (tally.repeated, tally.late) == (0, 0)
    assert tally.done > 0 or kills < 10  # a kill in the middle of a `step` is refused, and both may be such ones


@pytest.mark.slow
def test_the_engine_has_no_storage_for_the_record() -> None:
    """Why the record is on a folder. When this fails, the engine has learned it, and the record can be streamed."""
    config = zenoh.Config.from_json5(
        """{mode: "router", listen: {endpoints: ["tcp/127.0.0.1:0"]}, scouting: {multicast: {enabled: false}},
            plugins_loading: {enabled: true}, plugins: {storage_manager: {
                storages: {journal: {key_expr: "journal/**", volume: "memory"}}}}}"""
    )
    with zenoh.open(config) as session:
        session.put("journal/events", "a line")
        assert list(session.get("journal/events", timeout=5.0)) == []
