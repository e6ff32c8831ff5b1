"""List the files of the project that one call enters: `python -m tests.house.entered value|command|scenario`.

`value` reads a simulated robot's TruePose by the synchronous facade, `command` drives a simulated robot a little, and
`scenario` runs a scenario of one step on the bundled fleet. Every thread is traced with `sys.setprofile`.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, Final

_entered: set[str] = set()


def _note(frame: FrameType, event: str, _: Any) -> None:
    if event == "call":
        _entered.add(frame.f_code.co_filename)


threading.setprofile(_note)  # before the framework starts its threads

from eal_actors import Fleet, connect  # noqa: E402
from eal_actors.scenario import load_scenario, run_scenario  # noqa: E402

ROOT: Final = Path(__file__).parents[2]
FLEET: Final = ROOT / "fleets/sim.yaml"
SCENARIO: Final = """
version: 1
name: one
roles:
  driver: {tags: [indoor]}
steps:
  - on: driver
    do:
      - send_cmd: {resource: Base, cmd: f0.05}
"""


def entered_by(action: Callable[[], object], runs: int = 3) -> list[str]:
    """Return the files of the project that each run of an action enters, in any thread.

    On a busy machine a timer of another actor may come due during one run, or the simulation is behind its time.
    """
    return sorted(set.intersection(*(_entered_once(action) for _ in range(runs))))


def _entered_once(action: Callable[[], object]) -> set[str]:
    _entered.clear()
    sys.setprofile(_note)
    try:
        action()
    finally:
        sys.setprofile(None)
    paths = {Path(name) for name in _entered if name.startswith(str(ROOT))}
    names = {path.relative_to(ROOT).as_posix() for path in paths if ".venv" not in path.parts}
    return {name for name in names if not name.startswith("tests/")}


def files_of(what: str) -> list[str]:
    """Return the files that a kind of call enters."""
    if what == "scenario":
        with Fleet.load(FLEET) as fleet, tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "one.yaml"
            file.write_text(SCENARIO)
            scenario = load_scenario(file)
            return entered_by(lambda: run_scenario(scenario, fleet))
    with connect("roomba-1", fleet=FLEET) as eal:
        base, pose = eal.find_resource("Base"), eal.find_resource("TruePose")
        actions: dict[str, Callable[[], object]] = {
            "value": lambda: eal.get_value(pose),
            "command": lambda: eal.send_cmd(base, "f0.05"),
        }
        actions[what]()  # the first call may load modules
        return entered_by(actions[what], runs=20 if what == "value" else 3)


if __name__ == "__main__":
    sys.stdout.write("\n".join(files_of(sys.argv[1])) + "\n")
