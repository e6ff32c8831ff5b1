"""The soak itself: robots and controllers in their own processes, and the faults that come over them."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import json
import os
import random
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from eal_actors.kernel.clock import REAL_TIME
from tests.net.links import free_port
from tests.soak.history import RELAYS, Fault, History
from tests.soak.hunger import watching
from tests.soak.programs import Program, Sample
from tests.soak.proxy import Cables

PLUGINS: Final = Path(__file__).parent / "plugins"
LEASE_S: Final = 1.0
DEAD_MAN_S: Final = 1.0
SAMPLE_EACH_S: Final = 2.0
START_S: Final = 240.0
"""How long all processes together may take to start and connect; growth is counted from then on."""
RECOVERY_S: Final = 60.0
COMMANDS_A_LIFE: Final = 1_000_000
DELAYS_S: Final = (0.02, 0.1, 0.3, 0.6)
"""One-way delays of a slowed link, below and above the shortest deadline, and below the dead-man's time."""
KINDS: Final = {"kill": 15, "freeze": 30, "cut": 20, "stall": 20, "slow": 30, "garbage": 15}
"""The kinds of faults, and how often each comes in comparison."""
CONTROLLERS: Final = ("warden", "rival-1", "rival-2")
"""The first is never killed; it is the one whose growth is judged."""
_LOOK_EACH_S: Final = 0.1


def now_s() -> float:
    """Return the machine's monotonic time, which all processes share."""
    return time.clock_gettime(time.CLOCK_MONOTONIC)


@dataclass(frozen=True)
class Plan:
    """How much to do.

    Attributes:
        robots: how many.
        duration_s: for how long faults come.
        seed: of all of them.
        fault_each_s: seconds between two faults, on average.
    """

    robots: int = 20
    duration_s: float = 1200.0
    seed: int = 1
    fault_each_s: float = 1.0


@dataclass
class Outcome:
    """The output of a soak.

    Attributes:
        plan: what was to be done.
        history: what everybody wrote down.
        samples: what each process that was never killed took, over time.
        logs: what robots and controllers said.
        is_started: whether everybody had found together before the first fault.
        exits: processes that ended otherwise than they should.
        shared_left: segments of shared memory that nobody removed.
    """

    plan: Plan
    history: History
    samples: dict[str, list[Sample]] = field(default_factory=dict)
    logs: list[Path] = field(default_factory=list)
    is_started: bool = True
    exits: list[str] = field(default_factory=list)
    shared_left: list[str] = field(default_factory=list)


class Soak:
    """One soak.

    Args:
        plan: how much to do.
        folder: where all its files go; empty.

    Thread: one.
    """

    def __init__(self, plan: Plan, folder: Path) -> None:
        self._plan = plan
        self._folder = folder
        self._random = random.Random(plan.seed)  # noqa: S311  # a test
        self._not_yet = self._random.sample(list(KINDS), len(KINDS))  # the first faults: one of each kind
        self._robots = [f"robot-{number}" for number in range(1, plan.robots + 1)]
        self._ports = {robot: (free_port(), free_port()) for robot in self._robots}
        self._veterans = {*self._robots[:: max(2, plan.robots // 5)], CONTROLLERS[0]}
        self._fleet = folder / "fleet.yaml"
        self._running: dict[str, Program] = {}
        self._lives: dict[str, int] = dict.fromkeys(CONTROLLERS, 0)
        self._busy: set[str] = set()
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._shared: set[str] = set()
        self.outcome = Outcome(plan, History(0.0, DEAD_MAN_S, LEASE_S))

    def run(self) -> Outcome:
        """Go through all of it. Thread: blocks for the plan's duration, and up to two minutes more."""
        self._write_fleet()
        with ExitStack() as stack:
            stack.callback(self._kill_all)
            self._cables = stack.enter_context(Cables(self._ports))
            stack.enter_context(watching(self._pids, self.outcome.history))
            for robot in self._robots:
                self._start_robot(robot)
            self._wait(lambda: all(self._is_listening(robot) for robot in self._robots), START_S)
            for controller in CONTROLLERS:
                self._start_controller(controller)
            self.outcome.is_started = self._wait(self._all_are_ready, START_S)
            self._suffer()
            self._wait(self._all_are_ready, RECOVERY_S)  # that it did not happen shows in the checks
            self.outcome.history.end_s = now_s()
            self._end_all()
        self._read()
        return self.outcome

    def _pids(self) -> dict[str, int]:
        """Return all processes, by the names under which a history knows them. Thread: any."""
        pids = {self._life(target): program.pid for target, program in self._running.copy().items()}
        return {**pids, RELAYS: os.getpid()}

    # Processes.

    def _write_fleet(self) -> None:
        robots = {
            robot: {
                "address": f"tcp/127.0.0.1:{port}",
                "listen": f"tcp/127.0.0.1:{robot_port}",
                "plugins": {"ward": {"folder": str(self._folder)}},
            }
            for robot, (port, robot_port) in self._ports.items()
        }
        network = {"lease_s": LEASE_S, "dead_man_s": DEAD_MAN_S, "discovery": False}
        content = {"version": 1, "name": "soak", "plugin_dirs": [str(PLUGINS)], "network": network, "robots": robots}
        self._fleet.write_text(json.dumps(content), encoding="utf-8")

    def _start(self, name: str, arguments: Sequence[str]) -> None:
        self._running[name] = program = Program(name.partition("#")[0], arguments, self._folder)
        if program.log not in self.outcome.logs:
            self.outcome.logs.append(program.log)

    def _start_robot(self, robot: str) -> None:
        self._start(robot, ["-m", "eal_actors", "serve", "--fleet", str(self._fleet), "--robot", robot])

    def _start_controller(self, controller: str) -> None:
        self._lives[controller] += 1
        life = f"{controller}#{self._lives[controller]}"
        first = (CONTROLLERS.index(controller) * 1000 + self._lives[controller]) * COMMANDS_A_LIFE
        home = self._robots[CONTROLLERS.index(controller) :: len(CONTROLLERS)]
        arguments = [self._fleet, self._journal(life), self._random.randrange(2**32), first, *home]
        self._start(controller, ["-m", "tests.soak.controller", *map(str, arguments)])

    def _journal(self, life: str) -> Path:
        return self._folder / f"{life}.journal"

    def _life(self, target: str) -> str:
        """Return the name by which a history knows the process of a target."""
        return f"{target}#{self._lives[target]}" if target in self._lives else target

    def _is_listening(self, robot: str) -> bool:
        return "listening at" in self._running[robot].log.read_text(encoding="utf-8")

    def _all_are_ready(self) -> bool:
        """Return whether the warden has all robots, by the last that it wrote of each."""
        states: dict[str, str] = {}
        journal = self._journal(self._life(CONTROLLERS[0]))
        lines = journal.read_text(encoding="utf-8").splitlines() if journal.exists() else []
        for line in lines:
            words = line.split()
            if words[1] == "state":
                states[words[2]] = words[3]
            elif words[1] == "leaving":
                states.clear()
        return [states.get(robot) for robot in self._robots] == ["ready"] * len(self._robots)

    def _wait(self, happens: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for something; return whether it happens in time."""
        end_s = now_s() + timeout_s
        while not (has_happened := happens()) and now_s() < end_s:
            REAL_TIME.sleep(_LOOK_EACH_S)
        return has_happened

    def _end_all(self) -> None:
        for name in [*CONTROLLERS, *self._robots]:
            code = self._running[name].end(by_signal=name in self._ports)
            expected = {0, 143} if name in self._ports else {0}
            if code not in expected:
                self.outcome.exits.append(f"{name} ended with {code}")

    def _kill_all(self) -> None:
        for program in self._running.values():
            if program.exit_code is None:
                program.kill()

    # Faults.

    def _suffer(self) -> None:
        """Let faults come, each on a target that has no other one, and look at the processes meanwhile."""
        end_s = now_s() + self._plan.duration_s
        self._later(0.0, self._look)
        self._later(self._pause_s(), lambda: self._strike(end_s))
        while self._due:
            due_s, _, action = heapq.heappop(self._due)
            REAL_TIME.sleep(max(0.0, due_s - now_s()))
            action()

    def _later(self, delay_s: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._due, (now_s() + delay_s, next(self._order), action))

    def _pause_s(self) -> float:
        return self._random.expovariate(1 / self._plan.fault_each_s)

    def _strike(self, end_s: float) -> None:
        """Make one fault, and plan the next."""
        if now_s() >= end_s:
            return
        kind = self._not_yet[0] if self._not_yet else self._random.choices(list(KINDS), list(KINDS.values()))[0]
        targets = [*self._robots, *(CONTROLLERS if kind in ("kill", "freeze") else ())]
        target = self._random.choice(targets)
        duration_s = self._random.choice((0.2, 0.7, 2.0, 5.0))
        if target not in self._busy and not (kind == "kill" and target in self._veterans):
            self._busy.add(target)
            self._not_yet = [other for other in self._not_yet if other != kind]
            mend = getattr(self, f"_{kind}")(target)
            self._later(duration_s, lambda: self._mend(kind, target, now, mend))
            now = now_s()
        self._later(self._pause_s(), lambda: self._strike(end_s))

    def _mend(self, kind: str, target: str, begin_s: float, mend: Callable[[], None]) -> None:
        victim = self._life(target)
        mend()
        self.outcome.history.faults.append(Fault(kind, victim, begin_s, now_s()))
        self._busy.discard(target)

    def _kill(self, target: str) -> Callable[[], None]:
        self._running[target].kill()
        start = self._start_robot if target in self._ports else self._start_controller
        return lambda: start(target)

    def _freeze(self, target: str) -> Callable[[], None]:
        program = self._running[target]
        program.freeze()
        return program.thaw

    def _cut(self, robot: str) -> Callable[[], None]:
        self._cables.cut(robot)
        return lambda: self._cables.mend(robot)

    def _stall(self, robot: str) -> Callable[[], None]:
        self._cables.stall(robot)
        return lambda: self._cables.mend(robot)

    def _slow(self, robot: str) -> Callable[[], None]:
        """Delay each way by less or more than the shortest deadline."""
        self._cables.slow(robot, *(self._random.choice(DELAYS_S) for _ in range(2)))
        return lambda: self._cables.mend(robot)

    def _garbage(self, robot: str) -> Callable[[], None]:
        """Let strangers speak nonsense to the robot's own port, and others say nothing."""
        peers = []
        for _ in range(20):
            with contextlib.suppress(OSError):  # the robot is being restarted, or sees through it
                peer = socket.create_connection(("127.0.0.1", self._ports[robot][1]), 1.0)
                peers.append(peer)
                peer.sendall(self._random.randbytes(self._random.choice((0, 1, 100, 10_000))))

        def go() -> None:
            for peer in peers:
                peer.close()

        return go

    # What is left.

    def _look(self) -> None:
        """Take samples, as long as anything else is planned."""
        for name in self._veterans:
            sample = self._running[name].sample(now_s())
            self.outcome.samples.setdefault(name, []).append(sample)
        for program in self._running.values():
            with contextlib.suppress(OSError):  # it was killed meanwhile
                self._shared |= program.sample(now_s()).shared
        if self._due:
            self._later(SAMPLE_EACH_S, self._look)

    def _read(self) -> None:
        history = self.outcome.history
        for controller, lives in self._lives.items():
            for number in range(1, lives + 1):
                life = f"{controller}#{number}"
                journal = self._journal(life)
                text = journal.read_text(encoding="utf-8") if journal.exists() else ""
                history.read_controller(life, text.splitlines())
        for robot in self._robots:
            notes = (self._folder / f"{robot}.notes").read_text(encoding="utf-8")
            history.read_robot(robot, notes.splitlines())
        self.outcome.shared_left = sorted(path for path in self._shared if Path(path).exists())
