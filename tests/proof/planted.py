"""Scenarios with a planted bug each, on fleets with more robots and settings than the bug needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

FLEET = """\
version: 1
name: yard
seed: 5
clock: {rate: 2}
python_steps: [yard_steps:drive_on]
defaults: {timeout_s: 15}
types:
  mover: {tags: [indoor], plugins: {sim: {model: roomba}}}
  helper: {tags: [spare], plugins: {sim: {model: evbot3}}}
robots:
  ann: {type: mover, plugins: {sim: {start: {x_m: -1.5, y_m: 0, yaw_deg: 90}}}}
  bob: {type: mover, plugins: {sim: {start: {x_m: 0, y_m: 0, yaw_deg: 180}}}}
  cid: {type: mover, plugins: {sim: {start: {x_m: 1.5, y_m: 0, yaw_deg: 90}}}}
  dot: {type: helper, plugins: {sim: {start: {x_m: 2.0, y_m: -1.5}}}}
"""

STEPS = '''\
"""A step with a bug: the thread that it starts outlives a failure of the step."""

import threading


def drive_on(context):
    base, over = context.robots[context.robot]["Base"], threading.Event()

    def keep_driving():
        while not over.is_set() and context.clock.now() < 60:
            base.set_value([0.05, 0.0])
            context.clock.sleep(0.25)

    context.clock.start(threading.Thread(target=keep_driving, daemon=True))
    context.clock.sleep(1.0)
    context.robots[context.robot]["Camera"].get_value().get()
    over.set()
    context.clock.sleep(0.5)
'''


@dataclass(frozen=True, slots=True)
class PlantedBug:
    """A scenario with a bug.

    Attributes:
        name: its name.
        scenario: the text of the scenario, without its first lines.
        invariant: the invariant that it violates.
        faults: the faults to try.
        robots: how many robots the least fleet file needs.
        pair: it needs two faults.
        within_s: the limit of the run.
    """

    name: str
    scenario: str
    invariant: str
    faults: tuple[str, ...]
    robots: int
    pair: bool = False
    within_s: float | None = None

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write the scenario and the fleet; return both files."""
        (folder / "yard_steps.py").write_text(STEPS, encoding="utf-8")
        scenario, fleet = folder / f"{self.name}.yaml", folder / "yard.yaml"
        scenario.write_text(f"version: 1\nname: {self.name}\n{dedent(self.scenario)}", encoding="utf-8")
        fleet.write_text(FLEET, encoding="utf-8")
        return scenario, fleet


PLANTED = (
    PlantedBug(
        "the-follower-waits-for-a-lost-leader",
        """\
        roles: {leader: {robots: [ann], on_failure: drop, min: 0}, follower: {robots: [bob]}}
        steps:
          - parallel:
              - - on: leader
                  do: [{send_cmd: {resource: Base, cmd: f0.3}, timeout_s: 10}, {signal: arrived}]
              - - on: follower
                  do: [{wait_for: arrived, timeout_s: 20}, {send_cmd: {resource: Base, cmd: l90}}]
        """,
        "barriers",
        ("lost",),
        2,
    ),
    PlantedBug(
        "a-signal-depends-on-a-step-that-may-be-skipped",
        """\
        roles: {giver: {robots: [ann]}, taker: {robots: [bob]}}
        steps:
          - parallel:
              - - on: giver
                  do:
                    - send_cmd: {resource: Base, cmd: f0.3}
                      on_failure: skip
                    - if: value('Odometry')[0] > 0.2
                      then: [{signal: ready}]
              - - on: taker
                  do: [{wait_for: ready, timeout_s: 8}, {send_cmd: {resource: Base, cmd: l45}}]
        """,
        "barriers",
        ("fails",),
        2,
    ),
    PlantedBug(
        "a-fixed-pause-stands-for-the-way-being-clear",
        """\
        roles: {first: {robots: [ann], on_failure: drop, min: 0}, second: {robots: [bob]}}
        steps:
          - parallel:
              - - on: first
                  do: [{send_cmd: {resource: Base, cmd: f0.5}, timeout_s: 12}]
              - - on: second
                  do: [{wait_s: 6}, {send_cmd: {resource: Base, cmd: f2}}]
        """,
        "contact",
        ("stuck-wheel",),
        2,
    ),
    PlantedBug(
        "finally-depends-on-how-far-the-robot-came",
        """\
        roles: {movers: {tags: [indoor]}}
        steps:
          - on: movers
            do: [{send_cmd: {resource: Base, cmd: f0.3}}]
        finally:
          - on: movers
            do:
              - if: value('Odometry')[0] > 0.2
                then: [{send_cmd: {resource: Base, cmd: s}}]
        """,
        "finally",
        ("fails",),
        1,
    ),
    PlantedBug(
        "the-delivery-is-skipped-and-reported-as-done",
        """\
        roles: {movers: {tags: [indoor]}}
        steps:
          - on: movers
            do:
              - send_cmd: {resource: Base, cmd: f0.5}
                on_failure: skip
              - get_value: {resource: Battery}
        """,
        "outcome",
        ("blocked-way",),
        1,
    ),
    PlantedBug(
        "patience-without-end",
        """\
        roles: {movers: {tags: [indoor]}}
        steps:
          - on: movers
            do:
              - send_cmd: {resource: Base, cmd: f0.3}
                on_failure: {retry: 30, back_off_s: 20, then: drop}
        """,
        "deadline",
        ("fails",),
        1,
        within_s=120,
    ),
    PlantedBug(
        "a-wait-for-days",
        """\
        roles: {movers: {tags: [indoor], on_failure: drop}}
        steps:
          - parallel:
              - - on: movers
                  do:
                    - send_cmd: {resource: Base, cmd: f0.3}
                      timeout_s: 10
                    - {signal: arrived}
              - - {wait_for: arrived, count: 3, timeout_s: 200000}
        """,
        "ends",
        ("lost",),
        3,
    ),
    PlantedBug(
        "a-thread-outlives-its-step",
        """\
        roles: {movers: {tags: [indoor], on_failure: drop}}
        steps:
          - on: movers
            do: [{python: "yard_steps:drive_on", timeout_s: 20}, {get_value: {resource: Camera}}]
        """,
        "halted",
        ("dead-camera",),
        1,
    ),
    PlantedBug(
        "a-relative-motion-is-called-safe-to-repeat",
        """\
        safe_to_repeat: true
        roles: {movers: {tags: [indoor]}}
        steps:
          - on: movers
            do: [{send_cmd: {resource: Base, cmd: f0.8}}]
        """,
        "outcome",
        ("controller-killed",),
        1,
    ),
    PlantedBug(
        "one-of-two-guides-must-live",
        """\
        roles: {guides: {robots: [ann, bob], on_failure: drop, min: 0}, guest: {robots: [cid]}}
        steps:
          - parallel:
              - - on: guides
                  do: [{send_cmd: {resource: Base, cmd: f0.3}, timeout_s: 10}, {signal: come}]
              - - on: guest
                  do: [{wait_for: come, timeout_s: 15}, {send_cmd: {resource: Base, cmd: l90}}]
        """,
        "barriers",
        ("lost",),
        3,
        pair=True,
    ),
)
