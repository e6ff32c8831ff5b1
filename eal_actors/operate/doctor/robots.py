"""Checks of robots in other processes: whether they answer and run the same release."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

from eal_actors.actors.robot_view import Ping, RobotState, release
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import BEHIND_ROUTER, parse_endpoint
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

_AREA: Final = "robots"
_SLOW_S: Final = 0.1
_PING_S: Final = 5.0


def ping_robots(config: FleetConfig, names: Iterable[str]) -> tuple[dict[str, Ping], list[Diagnostic]]:
    """Ping robots; return their answers and the diagnostics.

    No robot moves, and robots of this process are not started. Thread: blocks the caller for some seconds if robots do
    not answer.
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
                    fleet[name].require_started()
                    answers[name] = fleet[name].ping().get(timeout=fleet.clock.of_real(_PING_S))
                except EALError as error:
                    findings.append(_unreached(name, config.robots[name].address or "", error))
                else:
                    findings.extend(judge_ping(name, answers[name], release()))
    except EALError as error:  # missing keys, or a router that does not answer
        advice = "Correct this first, then run eal doctor again."
        findings.append(problem(_AREA, f"cannot connect to the network: {error}", advice))
    return answers, findings


def _unreached(name: str, address: str, error: EALError) -> Diagnostic:
    serve = f"On the robot, run: eal serve --fleet FLEET --robot {name}."
    if address == BEHIND_ROUTER:
        advice = (
            f"{serve} Check that eal router runs, that the robot and this machine reach it, and that all have keys of "
            "the same authority."
        )
    elif reason := _unknown_host(address):
        advice = f"{reason}. Check the name and that the robot is on, or write its IP address into the fleet file."
    else:
        advice = (
            f"{serve} Check that the robot is on, that {address} is its address, that no firewall blocks it, and that "
            "both ends have keys of the same authority."
        )
    return problem(_AREA, f"{name}: {error.message}", advice)


def _unknown_host(address: str) -> str | None:
    """Return why a host name has no address here; None if it has one. Thread: blocks the caller for some seconds."""
    endpoint = parse_endpoint(address)
    try:
        socket.getaddrinfo(endpoint.host, endpoint.port)
    except (OSError, UnicodeError) as error:  # the second for names that no host can have
        reason = getattr(error, "strerror", None) or str(error)
        return f"No address is known here for {endpoint.host}: {reason.lower()}"
    return None


def judge_ping(name: str, ping: Ping, ours: str) -> Iterator[Diagnostic]:
    """Yield the diagnostics of a robot's answer, where `ours` is the release on this machine."""
    if ping.state is not RobotState.READY:
        yield problem(_AREA, f"{name} answers, but is {ping.state.value}", "The log of its eal serve has the reason.")
    if ping.release != ours:
        what = f"{name} runs release {ping.release}, this machine {ours}"
        yield warning(_AREA, what, f"Install the same on both: pip install eal-actors=={ours}")
    if ping.stopped is not None:
        yield warning(_AREA, f"{name} is held by an emergency stop: {ping.stopped}", "When it is safe: eal resume")
    for resource, reason in ping.not_ready.items():
        yield warning(_AREA, f"{name}/{resource} is not ready: {reason}", "Check its device; it is retried.")
    for text in ping.warnings:
        yield warning(_AREA, f"{name}: {text}", "On the machine with the authority, run that command; copy the files.")
    if ping.round_trip_s > _SLOW_S:
        what = f"the round trip to {name} takes {ping.round_trip_s * 1000:.0f} ms"
        yield warning(_AREA, what, "Use a cable, or a less busy radio channel.")
    if ping.state is RobotState.READY and ping.release == ours:
        yield ok(_AREA, f"{name} answers in {ping.round_trip_s * 1000:.1f} ms, release {ping.release}")
