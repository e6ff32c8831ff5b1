"""Checks of a network against the whole fleet: addresses, keys and roles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_tree import MarkedDict, MarkedList, YamlPath, YamlTree
from eal_actors.managers.network_model import BEHIND_ROUTER, SECURE_PROTOCOLS, check_address, parse_endpoint

_NEEDS_KEYS = "needs keys: make them with `eal keys init`, and name them under network.security"


def no_lock_step(robot: str) -> str:
    """Return why a fleet with a robot in another process cannot run at rate max."""
    return f"rate max is for robots of one process, for processes cannot share its clock: '{robot}' has an address"


def network_problems(tree: YamlTree, robots: Mapping[str, tuple[str, MarkedDict]]) -> list[Problem]:
    """Return the contradictions between the `network:` section and the robots; refused values are skipped.

    `robots` has, by name, the key of each entry in the file and its merged levels.
    """
    check = _NetworkCheck(tree, tree.root.section("network"), robots)
    return [*check.clock(), *check.addresses(), *check.routers(), *check.roles()]


class _NetworkCheck:
    """Checks the values of the files, which the models have checked one by one."""

    def __init__(self, tree: YamlTree, network: MarkedDict, robots: Mapping[str, tuple[str, MarkedDict]]) -> None:
        self._tree = tree
        self._robots = robots
        self._routers = _items(network, "routers")
        security = network.get("security")
        self._security = security if isinstance(security, MarkedDict) else None

    def clock(self) -> Iterator[Problem]:
        clock = self._tree.root.get("clock")
        if isinstance(clock, MarkedDict) and clock.get("rate") == MAX:
            remote = [name for name, (_, levels) in self._robots.items() if levels.get("address") is not None]
            if remote:
                yield self._tree.problem(("clock", "rate"), no_lock_step(remote[0]))

    def addresses(self) -> Iterator[Problem]:
        """Yield the problems of the robots' addresses.

        Robots of one numbered entry may have one address, at which one process serves them. With certificates they
        cannot, as each has its own.
        """
        owners: dict[str, tuple[str, str]] = {}
        for name, (key, levels) in self._robots.items():
            address, listen = levels.get("address"), levels.get("listen")
            at: YamlPath = ("robots", key, "address")
            if not isinstance(address, str):
                if address is None and isinstance(listen, str):
                    hint = "a robot without an address lives in the controller's process; give it one under 'address'"
                    yield self._tree.problem(("robots", key, "listen"), hint, key=True)
                continue
            yield from self._address(address, at)
            if address == BEHIND_ROUTER and listen is not None:
                hint = "a robot behind a router listens nowhere: leave this out, or give it an address of its own"
                yield self._tree.problem(("robots", key, "listen"), hint, key=True)
            elif isinstance(listen, str):
                yield from self._endpoint(listen, ("robots", key, "listen"))
            owner, its_key = owners.setdefault(address, (name, key))
            if address != BEHIND_ROUTER and owner != name and (its_key != key or self._security is not None):
                yield self._tree.problem(at, f"'{address}' is the address of '{owner}' already")

    def _address(self, address: str, at: YamlPath) -> Iterator[Problem]:
        if address == BEHIND_ROUTER:
            if not self._routers:
                yield self._tree.problem(at, "the network has no routers; name them under network.routers")
            return
        try:
            check_address(address)
        except ValueError as error:  # `{n}` has become a number
            yield self._tree.problem(at, str(error))
        else:
            yield from self._endpoint(address, at)

    def _endpoint(self, text: str, at: YamlPath) -> Iterator[Problem]:
        try:
            protocol = parse_endpoint(text).protocol
        except ValueError as error:
            yield self._tree.problem(at, str(error))
            return
        if self._security is None and protocol in SECURE_PROTOCOLS:
            yield self._tree.problem(at, f"{protocol} {_NEEDS_KEYS}")
        elif self._security is not None and protocol not in SECURE_PROTOCOLS:
            yield self._tree.problem(
                at, f"{protocol} carries no certificates, which network.security asks for; use tls"
            )

    def routers(self) -> Iterator[Problem]:
        for index, text in enumerate(self._routers):
            at: YamlPath = ("network", "routers", index)
            if isinstance(text, str):
                yield from self._endpoint(text, at)
                if text in self._routers[:index]:
                    yield self._tree.problem(at, f"'{text}' is named already")

    def roles(self) -> Iterator[Problem]:
        if self._security is None:
            return
        roles = self._security.section("roles")
        named: set[str] = set()
        for role in ("controllers", "observers", "routers"):
            for index, entry in enumerate(_items(roles, role)):
                at: YamlPath = ("network", "security", "roles", role, index)
                grant = entry if isinstance(entry, MarkedDict) else {"name": entry}
                name = grant.get("name")
                if isinstance(name, str):
                    named.add(name)
                    if name in self._robots:
                        at_name = (*at, "name") if isinstance(entry, MarkedDict) else at
                        yield self._tree.problem(at_name, f"'{name}' is a robot, whose certificate has no other role")
                yield from self._known_robots(grant, at)
        controller = self._security.get("controller", "controller")
        if isinstance(controller, str) and controller not in named:
            message = f"'{controller}' has no role; name it under roles.controllers or roles.observers"
            yield self._tree.problem(("network", "security", "controller"), message)

    def _known_robots(self, grant: Mapping[str, object], at: YamlPath) -> Iterator[Problem]:
        robots = grant.get("robots")
        for index, name in enumerate(robots if isinstance(robots, MarkedList) else ()):
            if isinstance(name, str) and name not in self._robots:
                yield self._tree.problem(
                    (*at, "robots", index), f"unknown robot '{name}'{did_you_mean(name, self._robots)}"
                )


def _items(section: MarkedDict, key: str) -> MarkedList:
    items = section.get(key)
    return items if isinstance(items, MarkedList) else MarkedList(section.mark)
