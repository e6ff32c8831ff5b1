"""The diagnosis: all checks, causes before their effects."""

from __future__ import annotations

from collections.abc import Iterator

from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.manifest import discover
from eal_actors.managers.shared_ports import shared_ports
from eal_actors.operate.doctor.certificates import check_certificates
from eal_actors.operate.doctor.clocks import StepWatch, check_clock
from eal_actors.operate.doctor.devices import check_devices, named_devices
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem
from eal_actors.operate.doctor.packages import check_packages
from eal_actors.operate.doctor.plugins import check_plugins
from eal_actors.operate.doctor.ports import check_ports, is_here
from eal_actors.operate.doctor.robots import ping_robots


def diagnose_machine() -> Iterator[Diagnostic]:
    """Yield diagnostics of this machine, independent of any fleet."""
    yield from check_packages()
    yield from check_clock()


def diagnose_fleet(config: FleetConfig) -> Iterator[Diagnostic]:
    """Yield diagnostics of a fleet, from the view of this machine.

    Checks the plugins, devices and ports of robots that run here, by their addresses, and pings the others. No robot
    moves. The only devices that are opened are cameras, whose capabilities are read. Thread: blocks the caller, for
    some seconds if robots do not answer.
    """
    watch = StepWatch()
    here = [robot for robot in config.robots.values() if is_here(robot)]
    remote = [robot.name for robot in config.robots.values() if robot.address is not None]
    yield ok("fleet file", f"{config.source}: {len(here)} of {len(config.robots)} robots on this machine")
    yield from check_plugins(config, here)
    manifests, _ = discover(config.plugin_dirs)
    for shared in shared_ports(here, manifests):
        yield problem("fleet file", str(shared), "Name another port there: `eal ports` lists them.")
    yield from check_devices(named_devices(here, manifests))
    yield from check_certificates(config, here)
    answers, findings = ping_robots(config, remote)
    yield from check_ports(here, answers)
    yield from findings
    yield from watch.findings()
