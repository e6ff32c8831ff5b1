"""Robots of other processes: whether they answer, and run the same release as this end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import Ping, RobotState, release
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

_AREA: Final = "robots"
_SLOW_S: Final = 0.1
_PING_S: Final = 5.0


def ping_robots(config: FleetConfig, names: Iterable[str]) -> tuple[dict[str, Ping], list[Diagnostic]]:
    """Ask robots how they are; returns their answers, and what is to be said of each.

    Nothing is moved, and robots of this process are not started.

    Thread: blocks the caller for some seconds where robots do not answer.
    """
    wanted = list(names)
    answers: dict[str, Ping] = {}
    findings: list[Diagnostic] = []
    if not wanted:
        return answers, findings
    only = replace(config, robots={name: config.robots[name] for name in wanted})
    try:
        with Fleet(only).connect() as fleet:
            for name in wanted:
                try:
                    answers[name] = _ping(fleet[name])
                except EALError as error:
                    findings.append(_unreached(name, config.robots[name].address or "", error))
                else:
                    findings.extend(judge_ping(name, answers[name], release()))
    except EALError as error:  # keys that are missing, or a router that does not answer
        findings.append(problem(_AREA, f"the network cannot be entered: {error}", "Mend that first, then ask again."))
    return answers, findings


def _ping(robot: RobotHandle) -> Ping:
    robot.require_started()
    return robot.ping().get(timeout=robot.clock.of_real(_PING_S))


def _unreached(name: str, address: str, error: EALError) -> Diagnostic:
    advice = (
        f"On the robot: eal serve --fleet FLEET --robot {name}. Then see that it is switched on, that {address} is its "
        "address, that no firewall is between, and that both ends have keys of one authority."
    )
    return problem(_AREA, f"{name}: {error.message}", advice)


def judge_ping(name: str, ping: Ping, ours: str) -> Iterator[Diagnostic]:
    """Yield what a robot's answer means.

    Args:
        name: the robot's name.
        ping: its answer.
        ours: the release of this end.
    """
    if ping.state is not RobotState.READY:
        yield problem(_AREA, f"{name} answers, but is {ping.state.value}", "Its own log says why: eal serve tells it.")
    if ping.release != ours:
        what = f"{name} runs release {ping.release}, this end {ours}"
        yield warning(_AREA, what, f"Install the same on both: pip install eal-actors=={ours}")
    if ping.stopped is not None:
        yield warning(_AREA, f"{name} is held by an emergency stop: {ping.stopped}", "eal resume, once all is clear")
    for resource, reason in ping.not_ready.items():
        yield warning(_AREA, f"{name}/{resource} is not ready: {reason}", "See to its device; it is tried again.")
    if ping.round_trip_s > _SLOW_S:
        what = f"the way to {name} and back takes {ping.round_trip_s * 1000:.0f} ms"
        yield warning(_AREA, what, "Use a cable, or a radio channel that is less busy.")
    if ping.state is RobotState.READY and ping.release == ours:
        yield ok(_AREA, f"{name} answers in {ping.round_trip_s * 1000:.1f} ms, release {ping.release}")
