"""The order of a fleet's update: who is updated, when it stops, and where it goes on."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace

import pytest

from eal_actors.kernel.clock import ScaledClock
from eal_actors.kernel.errors import UnavailableError
from evbotos.fleet_update import Outcome, Stage, Standing, Update, stage_of, summary, update_fleet

OLD = Standing("start-1", "a", good=True, due=False, release="1", platform="pc", verity="old", other_verity="")
NEW = Update(b"{}", b"s" * 64, "pc", "2", "new", {})
ARM = Update(b"{}", b"s" * 64, "arm", "2", "new-arm", {})


@dataclass
class Machines:
    """Robots in memory that follow the rules of slots.

    Attributes:
        states: what each says; None while it is away.
        sick: robots whose new system is not healthy.
        broken: robots whose new system does not come up.
        leaves: robots that go away during a push, so many times.
        users: controllers that use robots.
        later: what robots say after so many looks.
        done: what was done, in order.
    """

    states: dict[str, Standing | None]
    sick: set[str] = field(default_factory=set)
    broken: set[str] = field(default_factory=set)
    leaves: dict[str, int] = field(default_factory=dict)
    users: dict[str, str] = field(default_factory=dict)
    later: dict[str, tuple[int, Standing]] = field(default_factory=dict)
    done: list[str] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def standing(self, robot: str) -> Standing | None:
        if robot in self.later:
            looks, state = self.later[robot]
            self.later[robot] = looks - 1, state
            if looks == 1:
                self.states[robot] = state
        return self.states[robot]

    def unsuited(self, robot: str) -> str | None:
        return "it has no plugin evbotos" if robot == "desk" else None

    def used_by(self, robot: str) -> str | None:
        return self.users.pop(robot, None)

    def push(self, robot: str, update: Update) -> None:
        state = self.states[robot]
        assert state is not None
        if self.leaves.get(robot, 0):
            self.leaves[robot] -= 1
            self.states[robot] = None
            self.later[robot] = 3, OLD
            raise UnavailableError("it is out of reach")
        self._note(f"push {robot}")
        self.states[robot] = replace(state, due=True, other_verity=update.verity)

    def restart(self, robot: str) -> None:
        state = self.states[robot]
        assert state is not None
        assert state.due
        self._note(f"restart {robot}")
        comes_up = not (robot in self.broken and state.other_verity == NEW.verity)
        running, other = (state.other_verity, state.verity) if comes_up else (state.verity, state.other_verity)
        release = "2" if running == NEW.verity else "1"
        self.states[robot] = replace(
            state, start=state.start + "+", due=False, verity=running, other_verity=other, release=release
        )

    def fall_back(self, robot: str) -> None:
        state = self.states[robot]
        assert state is not None
        self._note(f"fall back {robot}")
        self.states[robot] = replace(state, due=True)

    def problem_of(self, robot: str) -> str | None:
        self._note(f"check {robot}")
        return "it drives in circles" if robot in self.sick else None

    def tell(self, robot: str, words: str) -> None:
        pass

    def _note(self, words: str) -> None:
        with self.lock:
            self.done.append(words)


def fleet_of(*names: str) -> Machines:
    return Machines(dict.fromkeys(names, OLD))


@pytest.mark.parametrize(
    ("standing", "stage"),
    [
        (OLD, Stage.BEHIND),
        (replace(OLD, due=True), Stage.BEHIND),  # to something else
        (replace(OLD, other_verity="new"), Stage.BEHIND),  # it was tried, and did not come up
        (replace(OLD, due=True, other_verity="new"), Stage.INSTALLED),
        (replace(OLD, verity="new", good=False), Stage.TRYING),
        (replace(OLD, verity="new"), Stage.RUNNING),
    ],
)
def test_a_robot_says_how_far_it_is(standing: Standing, stage: Stage) -> None:
    assert stage_of(standing, NEW) is stage


def test_robots_are_updated_one_after_the_other() -> None:
    fleet = fleet_of("ada", "bob")
    assert set(update_fleet(fleet, ["ada", "bob"], [NEW]).values()) == {Outcome.UPDATED}
    assert fleet.done == ["push ada", "restart ada", "check ada", "push bob", "restart bob", "check bob"]


def test_a_failure_stops_the_fleet_and_the_next_run_goes_on() -> None:
    fleet = fleet_of("ada", "bob", "cyd", "dan")
    fleet.broken = {"bob"}
    outcomes = update_fleet(fleet, list(fleet.states), [NEW])
    assert summary(outcomes) == "1 updated; 1 failed (bob); 2 not begun (cyd, dan)"
    fleet.broken, fleet.done = set(), []
    assert set(update_fleet(fleet, list(fleet.states), [NEW]).values()) == {Outcome.UPDATED}
    assert fleet.done[:4] == ["check ada", "push bob", "restart bob", "check bob"]


def test_a_robot_that_is_not_healthy_returns_to_its_former_system() -> None:
    fleet = fleet_of("ada", "bob")
    fleet.sick = {"ada"}
    assert summary(update_fleet(fleet, ["ada", "bob"], [NEW])) == "1 failed (ada); 1 not begun (bob)"
    assert fleet.done == ["push ada", "restart ada", "check ada", "fall back ada", "restart ada"]
    assert fleet.states["ada"] is not None
    assert fleet.states["ada"].verity == "old"


def test_a_robot_that_does_not_answer_for_a_while_after_its_check_returns_all_the_same() -> None:
    fleet = fleet_of("ada")

    def goes_away(robot: str) -> str:
        state, fleet.states[robot] = fleet.states[robot], None
        assert state is not None
        fleet.later[robot] = 3, state
        return "it does not answer"

    fleet.problem_of = goes_away  # type: ignore[method-assign]
    assert update_fleet(fleet, ["ada"], [NEW], clock=ScaledClock(1000)) == {"ada": Outcome.FAILED}
    assert fleet.done == ["push ada", "restart ada", "fall back ada", "restart ada"]


def test_an_updated_robot_that_is_not_healthy_later_has_nothing_to_return_to() -> None:
    fleet = Machines({"ada": replace(OLD, verity="new", other_verity="")}, sick={"ada"})
    assert update_fleet(fleet, ["ada"], [NEW]) == {"ada": Outcome.FAILED}
    assert fleet.done == ["check ada"]


def test_a_group_is_updated_at_the_same_time_and_a_failure_lets_it_end() -> None:
    fleet = fleet_of("ada", "bob", "cyd", "dan")
    fleet.broken = {"ada"}
    outcomes = update_fleet(fleet, list(fleet.states), [NEW], group=2)
    assert summary(outcomes) == "1 updated; 1 failed (ada); 2 not begun (cyd, dan)"


def test_absent_and_used_robots_wait_for_another_run_or_for_this_one() -> None:
    fleet = fleet_of("ada", "bob", "cyd")
    fleet.states["ada"], fleet.users = None, {"bob": "anna@lab-pc"}
    assert summary(update_fleet(fleet, list(fleet.states), [NEW])) == "1 updated; 1 absent (ada); 1 in use (bob)"
    fleet = fleet_of("ada", "bob", "cyd")
    fleet.states["ada"], fleet.later, fleet.users = None, {"ada": (3, OLD)}, {"bob": "anna@lab-pc"}
    outcomes = update_fleet(fleet, list(fleet.states), [NEW], wait=True, clock=ScaledClock(1000))
    assert set(outcomes.values()) == {Outcome.UPDATED}
    assert [words for words in fleet.done if words.startswith("push")] == ["push cyd", "push bob", "push ada"]


def test_a_robot_that_goes_away_during_its_push_is_absent_and_not_failed() -> None:
    fleet = fleet_of("ada", "bob")
    fleet.leaves = {"ada": 1}
    outcomes = update_fleet(fleet, ["ada", "bob"], [NEW], wait=True, clock=ScaledClock(1000))
    assert set(outcomes.values()) == {Outcome.UPDATED}
    assert fleet.done[0] == "push bob"


def test_each_platform_has_its_update_and_others_are_left_out() -> None:
    fleet = fleet_of("ada", "bob", "desk")
    fleet.states["bob"], fleet.states["desk"] = replace(OLD, platform="arm"), None
    assert summary(update_fleet(fleet, list(fleet.states), [NEW])) == "1 updated; 2 unsuited (bob, desk)"
    assert update_fleet(fleet, ["bob"], [NEW, ARM]) == {"bob": Outcome.UPDATED}


def test_a_robot_that_does_not_come_back_fails() -> None:
    fleet = fleet_of("ada")
    fleet.restart = lambda robot: fleet.states.update({robot: None})  # type: ignore[method-assign]
    assert update_fleet(fleet, ["ada"], [NEW], restart_s=20, clock=ScaledClock(1000)) == {"ada": Outcome.FAILED}


def test_a_robot_on_trial_is_waited_for() -> None:
    trying = replace(OLD, verity="new", other_verity="old", good=False)
    fleet = Machines({"ada": trying}, later={"ada": (4, replace(trying, good=True))})
    assert update_fleet(fleet, ["ada"], [NEW], clock=ScaledClock(1000)) == {"ada": Outcome.UPDATED}
    assert fleet.done == ["check ada"]
    assert fleet.later["ada"][0] == 0
