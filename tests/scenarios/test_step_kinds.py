"""A kind of step is one module: the one defined here runs without any other change."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from typing_extensions import override

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.strict_model import StrictModel
from eal_actors.scenario import Timeline, load_scenario, make_plan, scenario_schema
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import render
from eal_actors.scenario.language.scenario import Keys, ScenarioFile, Show, Step
from eal_actors.scenario.language.values import Seconds, VariableName, Wanted
from eal_actors.scenario.steps import registry
from eal_actors.scenario.steps.base import TimedStep
from tests.scenarios.rig import scenario
from tests.scenarios.running import ON, brief, run

PACKAGE = Path(registry.__file__).parents[2]


class NapStep(TimedStep, kind="nap_s"):
    """Sleep and keep the duration."""

    nap_s: Seconds
    """Seconds of the fleet's clock."""
    save_as: VariableName | None = None
    """Variable for the duration."""

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), (("nap_s",), self.nap_s))

    @override
    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        return (*super().numbers(), (("nap_s",), self.nap_s, "seconds"))

    @override
    def assigned(self) -> Iterable[tuple[Keys, str | None]]:
        return ((("save_as",), self.save_as),)

    @override
    def words(self, show: Show) -> str:
        return f"nap for {show(self.nap_s)} s"

    @property
    @override
    def label(self) -> str:
        return "nap"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        names = yield from action.read(self.nap_s)
        duration_s = yield from action.number(render(self.nap_s, names), "seconds", "nap_s")
        yield from action.run.sleep(action.context, duration_s)
        action.run.assign(action.context, self.save_as, duration_s)


def rebuild_models() -> None:
    """Forget pydantic's schemas, which other tests have built without the kind."""
    models: list[type[StrictModel]] = [*registry.kinds().values(), ScenarioFile]
    for model in models:
        for name in ("__pydantic_core_schema__", "__pydantic_validator__", "__pydantic_serializer__"):
            if name in vars(model):
                delattr(model, name)
        model.__pydantic_complete__ = False
    for model in models:
        model.model_rebuild(force=True)


@pytest.fixture
def nap() -> Iterator[type[Step]]:
    registry.register(NapStep)
    rebuild_models()
    yield NapStep
    del registry.kinds()["nap_s"]
    rebuild_models()


NAP = f"{ON}  - {{nap_s: '${{2 * index + 1}}', save_as: slept_s}}\n  - expect: slept_s == 2 * index + 1\n"


def test_a_kind_is_one_module(nap: type[Step], two: Fleet, tmp_path: Path) -> None:
    report = run(two, tmp_path, NAP)

    assert report.outcome == "done"
    assert brief(report, "slow") == [("nap", "done", 1), ("expect slept_s == 2 * index + 1", "done", 1)]
    assert report.robots["slow"].variables == {"slept_s": 3}
    assert report.duration_s >= 3.0


def test_a_plan_has_its_words(nap: type[Step], two: Fleet, tmp_path: Path) -> None:
    plan = make_plan(scenario(tmp_path, NAP), two)
    (entry,) = Timeline.of(plan.scenario, plan.roles).steps

    assert (entry.inner[0].kind, entry.inner[0].text) == ("nap_s", "nap for ${2 * index + 1} s")
    assert entry.inner[0].unknown == ()
    assert "NapStep" in scenario_schema()["$defs"]


@pytest.mark.parametrize(
    ("step", "problem"),
    [
        ("{nap_s: -1}", "trial.yaml:9:13: steps[0].do[0].nap_s: must be at least 0, not -1"),
        ("{nap_s: '${nobody}'}", "trial.yaml:9:16: steps[0].do[0].nap_s: unknown variable 'nobody'"),
        ("{nap_s: 1, until: first}", "trial.yaml:9:16: steps[0].do[0].until: unknown key 'until'"),
        ("{nap_s: 1, log: 2}", "is 'nap_s' and 'log' at once"),
        ("{naps_s: 1}", "unknown step 'naps_s'; did you mean 'nap_s'?"),
    ],
)
def test_its_values_are_checked_when_the_file_is_read(nap: type[Step], tmp_path: Path, step: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        scenario(tmp_path, f"{ON}  - {step}\n")

    assert problem in str(caught.value)


def test_its_values_are_checked_on_the_robots(nap: type[Step], two: Fleet, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"steps\[0\]\.do\[0\]\.nap_s: must be at least 0, not -1"):
        make_plan(scenario(tmp_path, NAP.replace("2 * index + 1", "-index")), two)


def test_a_kind_has_one_model(nap: type[Step]) -> None:
    class OtherStep(TimedStep, kind="nap_s"):
        pass

    with pytest.raises(ValueError, match="there is a step kind 'nap_s' already"):
        registry.register(OtherStep)


def test_without_the_kind_it_is_unknown(tmp_path: Path) -> None:
    path = tmp_path / "trial.yaml"
    path.write_text("version: 1\nname: x\nroles: {all: {}}\nsteps: [{nap_s: 1}]\n")

    with pytest.raises(ConfigError, match="unknown step 'nap_s'"):
        load_scenario(path)


def test_no_module_outside_of_the_kinds_names_one() -> None:
    kinds = {kind.__name__ for kind in registry.kinds().values()}
    found = {
        f"{path.relative_to(PACKAGE)}: {node.id}"
        for path in PACKAGE.rglob("*.py")
        if path.parent != Path(registry.__file__).parent
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Name) and node.id in kinds
    }

    assert found == set()
