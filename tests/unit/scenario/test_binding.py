"""Participants, spares, and robots that lack a role's requirements."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario
from eal_actors.scenario.language.binding import Binding, RobotFacts, bind, match_roles
from tests.unit.scenario.test_robots import BASE, EYE

FLEET = "version: 1\nname: four\nrobots:\n" + "".join(f"  {name}: {{plugins: {{p: {{}}}}}}\n" for name in "abcd")
FACTS = {
    "a": RobotFacts({"Base": BASE, "Eye": EYE}),
    "b": RobotFacts({"Base": BASE}, "; left out: no camera"),
    "c": RobotFacts({"Base": BASE, "Eye": EYE}),
    "d": RobotFacts({"Eye": EYE}),
}


def bound(folder: Path, roles: str, wishes: dict[str, list[str]] | None = None) -> Binding:
    (folder / "f.yaml").write_text(FLEET)
    (folder / "s.yaml").write_text(f"version: 1\nname: x\nroles: {roles}\nsteps: [{{log: x}}]\n")
    fleet = EALConfigManager.load(folder / "f.yaml", environment={}).fleet
    scenario = load_scenario(folder / "s.yaml")
    candidates, unbound = match_roles(scenario, fleet, wishes)
    binding, unfit = bind(scenario, fleet, candidates, FACTS, wishes)
    if problems := unbound + unfit:
        raise ConfigError(problems)
    return binding


@pytest.mark.parametrize(
    ("role", "robots", "spares"),
    [
        ("{}", "abcd", ""),
        ("{max: 2}", "ab", ""),
        ("{spares: 1}", "abc", "d"),
        ("{max: 2, spares: 1}", "ab", "c"),
        ("{min: 3, spares: 2}", "abc", "d"),
        ("{needs: {Eye: []}}", "acd", ""),
        ('{needs: {Eye: [], Base: [g, "r<degrees>"]}, spares: 1}', "a", "c"),
        ("{min: 0, needs: {Arm: []}}", "", ""),
    ],
)
def test_who_takes_part(tmp_path: Path, role: str, robots: str, spares: str) -> None:
    binding = bound(tmp_path, f"{{r: {role}}}")

    assert ("".join(binding.roles["r"]), "".join(binding.spares["r"])) == (robots, spares)


def test_who_works_in_one_role_is_no_spare_of_another(tmp_path: Path) -> None:
    binding = bound(tmp_path, "{r: {spares: 2}, q: {robots: [d]}}")

    assert (binding.roles, binding.spares) == ({"r": ("a", "b"), "q": ("d",)}, {"r": ("c",), "q": ()})


def test_roles_are_bound_by_hand(tmp_path: Path) -> None:
    binding = bound(tmp_path, "{r: {robots: [a]}, q: {}}", {"r": ["c", "b"]})

    assert binding.roles == {"r": ("b", "c"), "q": ("a", "b", "c", "d")}
    assert binding.robots == {"a", "b", "c", "d"}


@pytest.mark.parametrize(
    ("roles", "wishes", "expected"),
    [
        (
            "{r: {robots: [b], needs: {Eye: []}}}",
            None,
            [
                (
                    "3:9: roles.r: needs at least 1 of the robots of fleet 'four', but none fit; "
                    "b: unknown resource 'Eye'; known: Base; left out: no camera"
                ),
                "3:26: roles.r.needs: b: unknown resource 'Eye'; known: Base; left out: no camera",
            ],
        ),
        (
            "{r: {needs: {Base: [fly]}, min: 2}}",
            None,
            [
                (
                    "3:9: roles.r: needs at least 2 of the robots of fleet 'four', but none fit; "
                    "a: Base has no command 'fly'; b: Base has no command 'fly'; c: Base has no command 'fly'"
                )
            ],
        ),
        (
            "{r: {}}",
            {"r": ["x"]},
            ["3:9: roles.r: as it was bound: the fleet 'four' has no robot 'x'; known: a, b, c, d"],
        ),
        ("{r: {}}", {"rr": ["a"]}, ["3:1: roles: unknown role 'rr'; did you mean 'r'?"]),
    ],
)
def test_who_cannot_take_part(
    tmp_path: Path, roles: str, wishes: dict[str, list[str]] | None, expected: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        bound(tmp_path, roles, wishes)

    assert [str(problem).removeprefix(f"{tmp_path}/s.yaml:") for problem in caught.value.problems] == expected
