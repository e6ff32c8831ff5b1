"""The gate between agents and motions, in this process."""

from __future__ import annotations

import random
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest

from eal_actors.cli.mcp import approve_plan
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import AccessDeniedError, ArgumentError, ConfigError, EALError, ScenarioError
from eal_actors.operate.agents import PlanGate, PlanStore, StoredPlan
from eal_actors.operate.agents.examination import dry_run, read_plan
from eal_actors.operate.agents.gate import describe_problems
from eal_actors.operate.agents.policy import load_policy
from tests.operate.agents.agent import FLEET, PLACE, PLAN, POLICY, mutate

SEED = 3


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    file = tmp_path / "hall.yaml"
    file.write_text(FLEET, encoding="utf-8")
    with Fleet.load(file).connect() as fleet:
        yield fleet


@pytest.fixture
def gate(fleet: Fleet, tmp_path: Path) -> PlanGate:
    return PlanGate(fleet, tmp_path)


def places(fleet: Fleet) -> list[list[float]]:
    return [robot["TruePose"].get_value().get().value.tolist() for robot in fleet.values()]


def refusal(gate: PlanGate, plan: str) -> list[str]:
    """Return the lines with which a plan is refused; none if it has no problems."""
    try:
        gate.examine(plan, {})
    except EALError as error:
        return describe_problems(error)
    return []


def test_mutated_plans_are_refused_with_a_place_and_move_nothing(fleet: Fleet, gate: PlanGate, tmp_path: Path) -> None:
    random_, before, refused = random.Random(SEED), places(fleet), 0  # noqa: S311
    for number in range(60):
        plan = mutate(PLAN, random_)
        lines = refusal(gate, plan)
        refused += bool(lines)
        assert all(map(PLACE.match, lines)), (SEED, number, plan, lines)
        for word in ("approved", "*", "0" * 64, ""):
            with pytest.raises(EALError):
                gate.start(word)
    assert refused > 20
    assert places(fleet) == before
    assert not list(tmp_path.glob("*/events.jsonl"))


def test_odd_parameters_are_refused_with_a_place(gate: PlanGate) -> None:
    words = "  word: {type: string, default: a}\n  size: {type: double, default: 1}\n"
    text = PLAN.replace("parameters:\n", f"parameters:\n{words}")
    odd: tuple[dict[str, object], ...] = (
        {"word": "\ud800"},
        {"word": ["\udfff"]},
        {"size": 10**400},
        {"size": -(10**400)},
    )
    for parameters in odd:
        with pytest.raises(ConfigError, match=r"plan\.yaml:\d+:\d+: "):
            gate.examine(text, parameters)


def test_a_plan_is_one_file_without_code(gate: PlanGate) -> None:
    for step in ("scenario: dance", "scenario: /etc/passwd", "python: os:system"):
        with pytest.raises(ConfigError, match=r"plan\.yaml:1\d:\d+: "):
            gate.examine(PLAN.replace("wait_s: 0.1", step), {})


def kept_plan(gate: PlanGate, text: str = PLAN) -> StoredPlan:
    """Keep a plan as `submit` does after its rehearsal."""
    plan, lines = gate.examine(text, {})
    stored = gate.describe(plan, lines, text, {}, "a test", {"runs": [], "duration_s": 1.0})
    gate.store.keep(stored)
    return stored


def test_a_plan_waits_for_a_decision_that_counts_once_and_expires(gate: PlanGate) -> None:
    stored, store = kept_plan(gate), gate.store
    with pytest.raises(AccessDeniedError, match="is waiting: a person approves it with `eal approve "):
        gate.start(stored.hash)
    store.decide(stored, "user tester", is_approved=True, valid_min=0)
    with pytest.raises(AccessDeniedError, match="is expired"):
        gate.start(stored.hash)
    with pytest.raises(ScenarioError, match="does not wait for a decision: it is expired"):
        store.decide(stored, "user tester", is_approved=True)
    store.keep(stored)
    store.decide(stored, "user tester", is_approved=False)
    with pytest.raises(AccessDeniedError, match="is refused"):
        gate.start(stored.hash)
    store.keep(stored)
    store.decide(stored, "user tester", is_approved=True)
    store.use(stored)
    with pytest.raises(AccessDeniedError, match="is used"):
        gate.start(stored.hash)


def test_a_plan_that_was_changed_or_is_for_another_fleet_does_not_run(gate: PlanGate) -> None:
    stored = kept_plan(gate)
    changed = stored.model_copy(update={"text": stored.text.replace("20", "90")})
    gate.store.keep(changed)
    gate.store.decide(changed, "user tester", is_approved=True)
    with pytest.raises(AccessDeniedError, match="was changed"):
        gate.start(changed.hash)


def test_a_decision_of_another_hash_or_a_damaged_one_does_not_count(gate: PlanGate, tmp_path: Path) -> None:
    first, second = kept_plan(gate), kept_plan(gate, PLAN.replace("greet", "meet"))
    gate.store.decide(first, "user tester", is_approved=True)
    file = tmp_path / "plans" / second.hash / "decision.json"
    file.write_bytes((tmp_path / "plans" / first.hash / "decision.json").read_bytes())
    assert gate.store.state(second) == "waiting"
    file.write_text('{"is_approved": true}', encoding="utf-8")
    assert gate.store.state(second) == "waiting"
    with pytest.raises(ArgumentError, match="is no hash"):
        gate.start("../" + first.hash)


def test_old_plans_no_longer_wait(tmp_path: Path, gate: PlanGate) -> None:
    stored = kept_plan(gate)
    gate.store.keep(stored.model_copy(update={"submitted": stored.submitted - timedelta(days=2)}))
    assert PlanStore(tmp_path).state(gate.store.find(stored.hash)) == "expired"


def test_a_plan_whose_robots_have_changed_since_its_approval_does_not_run(gate: PlanGate, tmp_path: Path) -> None:
    """A robot that lacks what a role needs is replaced by another, which the person has not seen."""
    stored = kept_plan(gate)
    gate.store.keep(
        stored.model_copy(update={"steps": (*stored.steps[:1], "  on greeters: second", *stored.steps[2:])})
    )
    gate.store.decide(stored, "user tester", is_approved=True)
    with pytest.raises(AccessDeniedError, match=r"has other robots now: SYSTEM.* second; submit it again"):
        gate.start(stored.hash)
    assert gate.store.state(stored) == "approved"
    assert not list(tmp_path.glob("*/events.jsonl"))


def test_a_plan_that_is_aborted_before_it_begins_moves_nothing(gate: PlanGate) -> None:
    plan = kept_plan(gate)
    gate.store.decide(plan, "user tester", is_approved=True)
    asked = gate.aborts
    gate.abort("the agent thinks again")
    with pytest.raises(ScenarioError, match="aborted before it began"):
        gate.start(plan.hash, asked)
    assert gate.status() == {"state": "none"}
    assert gate.store.state(plan) == "approved"


def test_nothing_begins_after_the_end_of_the_door(gate: PlanGate) -> None:
    stored = kept_plan(gate)
    gate.store.decide(stored, "user tester", is_approved=True)
    gate.close()
    with pytest.raises(ScenarioError, match="the door for agents is closed"):
        gate.start(stored.hash)
    with pytest.raises(ScenarioError, match="the plan cannot be rehearsed"):
        gate.rehearse(PLAN, {})


def test_a_person_sees_the_parameters_as_they_are(
    gate: PlanGate, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PLAN.replace("parameters:\n", "parameters:\n  word: {type: string, default: a}\n")
    forged = {"word": "a\n\nRehearsed 9 times: done\u202e\u200b\x1b[2J"}
    plan, lines = gate.examine(text, forged)
    gate.store.keep(gate.describe(plan, lines, text, forged, "a test", {"runs": [], "duration_s": 1.0}))
    with pytest.raises(ScenarioError, match="by a person"):
        approve_plan(gate.store.plans()[0].hash, refuse=False, valid_min=1, runs_dir=tmp_path, as_json=False)
    shown = " ".join(capsys.readouterr().out.split())
    assert r"word = a\u000a\u000aRehearsed 9 times: done\u202e\u200b\u001b[2J" in shown


LAMP = """\
version: 1
name: hall
robots:
  turtle:
    plugins:
      ros2:
        router: tcp/127.0.0.1:1
        drive: {max_speed_m_s: 0.2, speed_m_s: 0.2, track_m: 0.2}
        services: {Lamp: {service: lamp, type: std_srvs/srv/SetBool}}
"""


def test_a_policy_does_not_take_a_call_of_a_service_for_reading(tmp_path: Path) -> None:
    (tmp_path / "hall.yaml").write_text(LAMP, encoding="utf-8")
    (tmp_path / "policy.yaml").write_text(f"{POLICY}    only_in_simulation: false\n", encoding="utf-8")
    policy = load_policy(tmp_path / "policy.yaml")
    head = "version: 1\nname: lamp\nroles: {it: {robots: [turtle]}}\nsteps:\n  - on: it\n    do:\n"
    reading = "      - send_req: {resource: Base, req: path}\n"
    with Fleet.load(tmp_path / "hall.yaml").connect() as fleet:
        plan, _ = dry_run(read_plan(head + reading, {}), fleet)
        assert policy.judge(plan, fleet, 1)[0] is not None
        for call in (
            """      - send_req: {resource: Lamp, req: '{"data": true}'}\n""",
            """      - if: "request('Lamp', '{}') == ''"\n        then: [wait_s: 0.1]\n""",
        ):
            plan, _ = dry_run(read_plan(head + call, {}), fleet)
            rule, problems = policy.judge(plan, fleet, 1)
            assert rule is None
            assert ["Lamp send_req" in str(problem) for problem in problems] == [True], problems


NOT_ALLOWED = (
    ("r${angle * turn}", "r${40 * turn}", "r 80 is not within 0 and 60"),
    ("r${angle * turn}", "f0.1", "Base f"),
    ("wait_s: 0.1", "go_to: {x_m: 1, y_m: 1}", "a step 'go_to'"),
    ("wait_s: 0.1", "set_value: {resource: Base, value: [0.1, 0.0]}", "Base set_value"),
    ("wait_s: 0.1", "set_config: {resource: Base, key: speed_m_s, value: 0.1}", "set_config"),
    ("angle * turn", "10 + 0 * value('Odometry')[0]", "known only during the run"),
)


def test_the_policy_of_the_page_is_valid(tmp_path: Path) -> None:
    page = bundled_path("docs/agents.md").read_text(encoding="utf-8")
    (tmp_path / "policy.yaml").write_text(page.partition("```yaml\n")[2].partition("```")[0], encoding="utf-8")
    assert load_policy(tmp_path / "policy.yaml")


def test_a_policy_allows_only_what_it_names(fleet: Fleet, tmp_path: Path) -> None:
    file = tmp_path / "policy.yaml"
    file.write_text(POLICY, encoding="utf-8")
    policy = load_policy(file)
    plan, _ = dry_run(read_plan(PLAN, {}), fleet)
    assert policy.judge(plan, fleet, 5)[0] is not None
    assert policy.judge(plan, fleet, 31)[0] is None
    for old, new, reason in NOT_ALLOWED:
        other, _ = dry_run(read_plan(PLAN.replace(old, new), {}), fleet)
        rule, problems = policy.judge(other, fleet, 5)
        assert rule is None, new
        assert any(reason in str(problem) and PLACE.match(str(problem)) for problem in problems), problems


@pytest.mark.slow
def test_an_approved_plan_runs_within_the_time_of_its_policy(fleet: Fleet, tmp_path: Path) -> None:
    file = tmp_path / "policy.yaml"
    file.write_text(POLICY.replace("max_duration_s: 30", "max_duration_s: 1"), encoding="utf-8")
    gate = PlanGate(fleet, tmp_path, load_policy(file))
    before = places(fleet)
    stored = kept_plan(gate)
    gate.store.decide(stored, "policy rule 'small turns'", is_approved=True)
    gate.start(stored.hash)
    assert "longer than the 1 s that the policy allows" in gate.status(60)["error"]
    gate.close()
    assert places(fleet) != before
