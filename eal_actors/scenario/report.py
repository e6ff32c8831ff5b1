"""What a run leaves behind: `summary.json`, whose JSON Schema is `summary_schema()`.

    {
      "scenario": "dance",                      name in the scenario file
      "scenario_file": "scenarios/dance.yaml",  as it was given
      "fleet": "sim", "fleet_file": "fleets/sim.yaml", "seed": 7, "rate": 2.0,
      "started": "2025-03-01T10:00:00.000000+00:00",   wall time, UTC
      "duration_s": 31.2,                       seconds of the fleet's clock, as all times below
      "outcome": "done",
      "error": null,                            or {"code": "deadline", "message": "..."}
      "robots": {"evbot2-1": {"outcome": "done", "error": null}},
      "steps": [
        {"robot": "evbot2-1", "step": "steps[0].do[0].do[0]", "label": "send_cmd Base r45",
         "resource": "Base", "method": "send_cmd", "command": "r45",
         "start_s": 0.01, "end_s": 0.92, "outcome": "done", "attempts": 1, "error": null}
      ]
    }

A step is `done`, `failed` (its last attempt failed), `dropped` (it failed, and cost the robot its part in the run) or
`aborted` (the run was stopped while it was under way). A
robot is `done` if it went through all of its steps, `failed` if a step of its ended the run, if one of its steps in
`finally` failed or if it could not be halted, `dropped` if it left the run, and `aborted` if the run was stopped
around it. The run is `done` only if every robot is; it is `failed` if a robot failed or was dropped or the engine
itself had an error, and otherwise `aborted`. Steps that were never reached have no entry.
"""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import Field

from eal_actors.errors import EALError
from eal_actors.lock_step import Rate
from eal_actors.strict_model import StrictModel

Outcome = Literal["done", "failed", "dropped", "aborted"]
RunOutcome = Literal["done", "failed", "aborted"]


class ErrorReport(StrictModel):
    """An error in a record."""

    code: str
    """The stable name of its class, see `eal_actors.errors`."""
    message: str

    @classmethod
    def of(cls, error: BaseException) -> Self:
        """Describe any exception; what is no EALError is named by its class."""
        if isinstance(error, EALError):
            return cls(code=error.code, message=str(error))
        return cls(code=EALError.code, message=f"{type(error).__name__}: {error}")


class RobotReport(StrictModel):
    """How a robot fared."""

    outcome: Outcome
    error: ErrorReport | None = None


class StepRecord(StrictModel):
    """One call of one robot, all its attempts together."""

    robot: str
    step: str
    """Its path in the scenario file."""
    label: str
    """What it does, for people."""
    resource: str
    method: str
    command: str | None
    """What send_cmd, send_req, get_config or set_config was given as text."""
    start_s: float
    """Since the run's start, in seconds of the fleet's clock."""
    end_s: float
    outcome: Outcome
    attempts: int = Field(ge=0)
    """0 if it failed before anything was sent."""
    error: ErrorReport | None = None


class Report(StrictModel):
    """The whole run."""

    scenario: str
    scenario_file: str
    fleet: str
    fleet_file: str
    seed: int
    rate: Rate
    """Seconds of the fleet's clock in one real second."""
    started: str
    """Wall time in UTC, ISO 8601."""
    duration_s: float
    """Seconds of the fleet's clock."""
    outcome: RunOutcome
    error: ErrorReport | None
    robots: dict[str, RobotReport]
    steps: tuple[StepRecord, ...] = Field(strict=False)


def summary_schema() -> dict[str, Any]:
    """Return the JSON Schema of `summary.json`."""
    schema = Report.model_json_schema(mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": "scenario/summary", **schema}
