"""The report of a run, as in `summary.json`. Its JSON Schema is `summary_schema()`.

    {
      "scenario": "dance",                      name in the scenario file
      "scenario_file": "scenarios/dance.yaml",  as the user gave it
      "fleet": "sim", "fleet_file": "fleets/sim.yaml", "seed": 7, "rate": 2.0,
      "parameters": {"speed_m_s": 0.3},
      "roles": {"dancers": ["evbot2-1"]},       the robots of each role at the start
      "wall_started": "2025-03-01T10:00:00.000000+00:00",   wall time, UTC
      "duration_s": 31.2,                       seconds of the fleet's clock, as all times below
      "paused_s": 0.0,                          total time of pauses
      "continued_s": [],                        the times at which it was resumed
      "outcome": "done",
      "error": null,                            or {"code": "deadline", "message": "..."}
      "robots": {"evbot2-1": {"outcome": "done", "error": null, "variables": {"seen_m": 1.5}}},
      "variables": {"total": 3},                those of the run at its end; above, those of each robot's slot
      "steps": [
        {"robot": "evbot2-1", "role": "dancers", "step": "steps[0].do[0].do[0]", "branch": null,
         "kind": "send_cmd", "label": "send_cmd Base r45", "resource": "Base", "command": "r45",
         "start_s": 0.01, "end_s": 0.92, "outcome": "done", "attempts": 1, "error": null}
      ],
      "starts": [
        {"step": "steps[0].do[0].do[0]", "start_s": 0.01, "skew_s": 0.0004, "skew_error_s": 0.0,
         "begins": {"evbot2-1": 0.0101}}
      ]
    }

A step is `done`, `failed` (its last attempt failed, and that ended the run), `dropped` (it failed, and cost the robot
its part in the run), `replaced` (it failed, and a spare took the robot's place), `skipped` (it failed, and the scenario
went on without it), `stopped` (others were through first, as `until` wants it) or `aborted` (the run was stopped while
it was under way).

A robot is `done` if it went through all of its steps, `failed` if a step of its ended the run, if one of its steps in
`finally` failed or if it could not be halted, `dropped` if it left the run, `replaced` if a spare took its place,
`aborted` if the run was stopped around it, and `spare` if it was kept in reserve and never needed. The run is `failed`
if a robot failed, if dropped robots left a role with fewer than its `min`, if a step of no robot failed, or if the
engine itself had an error; `aborted` if it was stopped otherwise; and `done` in all other cases: also without the
robots that were dropped. Steps that were never reached
have no entry.
"""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import Field

from eal_actors.kernel.errors import EALError
from eal_actors.kernel.lock_step import Rate
from eal_actors.kernel.strict_model import StrictModel
from eal_actors.scenario.report.records import whole_text

StepOutcome = Literal["done", "failed", "dropped", "replaced", "skipped", "stopped", "aborted"]
RobotOutcome = Literal["done", "failed", "dropped", "replaced", "aborted", "spare"]
RunOutcome = Literal["done", "failed", "aborted"]


class ErrorReport(StrictModel):
    """An error in a record."""

    code: str
    """The stable name of its class; see `eal_actors.kernel.errors`."""
    message: str

    @classmethod
    def of(cls, error: BaseException) -> Self:
        """Return the report of any exception; the message of one that is no EALError begins with its class."""
        if isinstance(error, EALError):
            return cls(code=error.code, message=whole_text(str(error)))
        return cls(code=EALError.code, message=whole_text(f"{type(error).__name__}: {error}"))


class LossReport(StrictModel):
    """A time during which a robot was out of reach, in seconds since the run's start."""

    lost_s: float
    back_s: float | None = None
    """None if it did not come back."""


class RobotReport(StrictModel):
    """The outcome of a robot."""

    outcome: RobotOutcome
    error: ErrorReport | None = None
    variables: dict[str, Any] = Field(default={})
    """Those of its slot at the end of the run, as plain values; values without a form in JSON are left out."""
    losses: tuple[LossReport, ...] = Field(default=(), strict=False)
    """When it was out of reach."""


class StepRecord(StrictModel):
    """One step of one robot, or of the run itself, with all its attempts."""

    robot: str | None
    """None for a step outside of `on`."""
    role: str | None
    """The robot's role in it."""
    step: str
    """Its path in the scenario file; inside another scenario, behind the path of the step that runs it."""
    branch: str | None
    """The innermost branch of a `parallel` that it belongs to: its name, or its number from 0."""
    kind: str
    """The kind of the step, such as `send_cmd` or `wait_for`."""
    label: str
    """The step for people."""
    resource: str | None
    """For calls."""
    command: str | None
    """The text argument of send_cmd, send_req, get_config or set_config."""
    start_s: float
    """Since the run's start, in seconds of the fleet's clock; with `together`, the time after the meeting."""
    end_s: float
    outcome: StepOutcome
    attempts: int = Field(ge=0)
    """0 if it failed before anything was sent."""
    error: ErrorReport | None = None

    @property
    def is_call(self) -> bool:
        """Whether it is a call of a resource."""
        return self.resource is not None


class StartReport(StrictModel):
    """The begins of a step with `together`."""

    step: str
    start_s: float
    """The agreed time."""
    skew_s: float | None
    """From the first begin to the last; None if a robot has not begun."""
    skew_error_s: float
    """Maximum error of the skew, either way; 0 for robots in the controller's own process."""
    begins: dict[str, float | None]
    """The begin of each robot."""


class ContactReport(StrictModel):
    """A contact of a simulated robot."""

    time_s: float
    """Its begin, in seconds since the run's start."""
    robot: str
    other: str
    """Another robot, or what the robot has touched."""


class Report(StrictModel):
    """The whole run."""

    scenario: str
    scenario_file: str
    fleet: str
    fleet_file: str
    seed: int
    rate: Rate
    """Seconds of the fleet's clock in one real second."""
    parameters: dict[str, Any]
    roles: dict[str, list[str]]
    """The robots of each role at the start."""
    wall_started: str
    """Wall time in UTC, ISO 8601."""
    duration_s: float
    """Seconds of the fleet's clock."""
    paused_s: float
    continued_s: tuple[float, ...] = Field(default=(), strict=False)
    """The times at which the run was resumed."""
    outcome: RunOutcome
    error: ErrorReport | None
    robots: dict[str, RobotReport]
    variables: dict[str, Any] = Field(default={})
    """Those of the run at its end."""
    steps: tuple[StepRecord, ...] = Field(strict=False)
    starts: tuple[StartReport, ...] = Field(default=(), strict=False)
    contacts: tuple[ContactReport, ...] = Field(default=(), strict=False)
    """The contacts of simulated robots; those of a second count once."""

    @property
    def dropped(self) -> list[str]:
        """The names of the robots that were dropped."""
        return [name for name, robot in self.robots.items() if robot.outcome == "dropped"]


def summary_schema() -> dict[str, Any]:
    """Return the JSON Schema of `summary.json`."""
    schema = Report.model_json_schema(mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": "scenario/summary", **schema}
