"""PlanStore: the plans of agents and the decisions about them, as files below the folder of runs.

The process that runs plans, the terminal and the dashboard share the folder. Only its owner can read or write it. A
decision is a file that appears at once and is never changed; so is the mark that a plan was used.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import AccessDeniedError, ArgumentError, BusyError, ScenarioError
from eal_actors.recording import folder_errors

PLANS: Final = "plans"
VALID_MIN: Final = 15.0
"""Default minutes for which an approval is valid."""
MAX_WAITING: Final = 50
"""Plans that wait for a decision at the same time."""
KEPT_DAYS: Final = 1
"""A plan without a decision stops waiting after this time."""
_HASH: Final = re.compile(r"[0-9a-f]{6,64}")
_PLAN: Final = "plan.json"
_DECISION: Final = "decision.json"
_USED: Final = "used"

_Content = TypeVar("_Content", bound="_Record")
PlanState = Literal["waiting", "approved", "refused", "expired", "used"]


class _Record(BaseModel):
    """The content of a file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Decision(_Record):
    """The decision about a plan. `who` is the user of the terminal or of the dashboard, or the policy's rule."""

    hash: str
    is_approved: bool
    who: str
    at: datetime
    valid_until: datetime


class StoredPlan(_Record):
    """A plan that passed all checks.

    `hash` is the SHA-256 of its text, its parameters and the fleet, in hexadecimal; `steps` are the lines of the dry
    run.
    """

    hash: str
    name: str
    fleet: str
    text: str
    parameters: dict[str, Any]
    agent: str
    submitted: datetime
    robots: tuple[str, ...]
    steps: tuple[str, ...]
    rehearsal: dict[str, Any]


def plan_hash(text: str, parameters: Mapping[str, object], fleet: Mapping[str, object]) -> str:
    """Return the SHA-256 of a plan on a fleet, in hexadecimal."""
    content = json.dumps([text, dict(parameters), fleet], sort_keys=True, default=str)
    return hashlib.sha256(content.encode()).hexdigest()


class PlanStore:
    """The plans below one folder of runs; ScenarioError if the folder cannot be read or written.

    Thread: any; several processes may share the folder.
    """

    def __init__(self, runs_dir: Path) -> None:
        self._folder = runs_dir / PLANS

    def keep(self, plan: StoredPlan) -> None:
        """Keep a plan; one that was kept before with the same hash is replaced, and needs a new decision.

        Raises BusyError if too many plans wait.
        """
        if sum(other.hash != plan.hash for other in self.waiting()) >= MAX_WAITING:
            raise BusyError(f"{MAX_WAITING} plans wait for a decision already; `eal approve` lists them")
        folder = self._folder / plan.hash
        with folder_errors(folder):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._folder.chmod(0o700)
            for old in (_DECISION, _USED):
                (folder / old).unlink(missing_ok=True)
            _write(folder / _PLAN, plan.model_dump_json(indent=2))

    def plans(self) -> list[StoredPlan]:
        """Return the plans, the oldest first; damaged ones are left out."""
        found = [plan for file in self._folder.glob(f"*/{_PLAN}") if (plan := _read(file, StoredPlan)) is not None]
        whole = (plan for plan in found if len(plan.hash) == 64 and _HASH.fullmatch(plan.hash))  # SHA-256
        return sorted(whole, key=lambda plan: (plan.submitted, plan.hash))

    def waiting(self) -> list[StoredPlan]:
        """Return the plans that wait for a decision, the oldest first."""
        return [plan for plan in self.plans() if self.state(plan) == "waiting"]

    def find(self, text: str) -> StoredPlan:
        """Return the plan whose hash begins with a text of at least six characters.

        Raises ArgumentError if no plan, or more than one, fits.
        """
        if not _HASH.fullmatch(text):
            raise ArgumentError(f"{text!r} is no hash of a plan: give at least its first six characters")
        found = [plan for plan in self.plans() if plan.hash.startswith(text)]
        if len(found) != 1:
            raise ArgumentError(f"{'no plan' if not found else 'more than one plan'} has the hash {text}")
        return found[0]

    def decision(self, plan: StoredPlan) -> Decision | None:
        """Return the decision about a plan; None if there is none that this user has written for this hash."""
        file = self._folder / plan.hash / _DECISION
        try:
            is_own = not hasattr(os, "getuid") or file.stat().st_uid == os.getuid()
        except OSError:
            return None
        found = _read(file, Decision) if is_own else None
        return found if found is not None and found.hash == plan.hash else None

    def state(self, plan: StoredPlan) -> PlanState:
        """Return the state of a plan."""
        decision = self.decision(plan)
        if (self._folder / plan.hash / _USED).exists():
            return "used"
        if decision is None:
            return "waiting" if wall_time() - plan.submitted < timedelta(days=KEPT_DAYS) else "expired"
        if not decision.is_approved:
            return "refused"
        return "approved" if wall_time() < decision.valid_until else "expired"

    def decide(self, plan: StoredPlan, who: str, *, is_approved: bool, valid_min: float = VALID_MIN) -> Decision:
        """Record a decision. Raises ScenarioError if the plan does not wait for one."""
        if (state := self.state(plan)) != "waiting":
            raise ScenarioError(f"plan {plan.hash[:12]} does not wait for a decision: it is {state}")
        now = wall_time()
        until = now + timedelta(minutes=valid_min)
        decision = Decision(hash=plan.hash, is_approved=is_approved, who=who, at=now, valid_until=until)
        if not self._create(plan, _DECISION, decision):
            raise ScenarioError(f"somebody else has just decided about plan {plan.hash[:12]}")
        return decision

    def use(self, plan: StoredPlan) -> Decision:
        """Mark an approved plan as used, once among all processes; return its approval.

        Raises AccessDeniedError if it is not approved now, or was used.
        """
        decision, state = self.decision(plan), self.state(plan)
        if decision is None or state != "approved":
            advice = f": a person approves it with `eal approve {plan.hash[:12]}`" if state == "waiting" else ""
            raise AccessDeniedError(f"plan {plan.hash[:12]} is {state}{advice}")
        if not self._create(plan, _USED, decision):
            raise AccessDeniedError(f"plan {plan.hash[:12]} was used: submit it again")
        return decision

    def _create(self, plan: StoredPlan, name: str, decision: Decision) -> bool:
        """Write a file of a plan; return false if it is there."""
        with folder_errors(self._folder):
            try:
                _write(self._folder / plan.hash / name, decision.model_dump_json(indent=2), is_new=True)
            except FileExistsError:
                return False
        return True


def _write(file: Path, text: str, *, is_new: bool = False) -> None:
    """Write a file that appears at once with its content; with `is_new`, raise FileExistsError if it is there."""
    part = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    try:
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as stream:
            stream.write(text)
        if is_new:
            file.hardlink_to(part)
        else:
            part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def _read(file: Path, model: type[_Content]) -> _Content | None:
    try:
        return model.model_validate_json(file.read_bytes())
    except (OSError, ValidationError):
        return None
