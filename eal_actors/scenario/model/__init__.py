"""What a scenario file may say.

A step is a mapping with one key that tells what it is. Whatever takes a value takes `${...}` in its texts too.
"""

from eal_actors.scenario.model.actions import ExpectStep, LetStep, LogStep, PythonStep, ScenarioStep
from eal_actors.scenario.model.base import BlockStep, FallibleStep, Step, TimedStep, WaitingStep
from eal_actors.scenario.model.calls import (
    TEXT_FIELDS,
    AnswerStep,
    CallStep,
    SendCmd,
    StartStep,
    call_fields,
    resolved_fields,
)
from eal_actors.scenario.model.file import ParameterSection, RoleSection, ScenarioFile
from eal_actors.scenario.model.policies import Action, OnFailure, RetryPolicy, final_action
from eal_actors.scenario.model.steps import (
    INDEX,
    MAX_REPEATS,
    AnyStep,
    ForStep,
    IfStep,
    OnStep,
    ParallelStep,
    RepeatStep,
    SequenceStep,
    WhileStep,
    inner_steps,
)
from eal_actors.scenario.model.waits import (
    POLL_S,
    BarrierStep,
    SignalStep,
    WaitForStep,
    WaitStep,
    WaitUntilStep,
)

__all__ = [
    "INDEX",
    "MAX_REPEATS",
    "POLL_S",
    "TEXT_FIELDS",
    "Action",
    "AnswerStep",
    "AnyStep",
    "BarrierStep",
    "BlockStep",
    "CallStep",
    "ExpectStep",
    "FallibleStep",
    "ForStep",
    "IfStep",
    "LetStep",
    "LogStep",
    "OnFailure",
    "OnStep",
    "ParallelStep",
    "ParameterSection",
    "PythonStep",
    "RepeatStep",
    "RetryPolicy",
    "RoleSection",
    "ScenarioFile",
    "ScenarioStep",
    "SendCmd",
    "SequenceStep",
    "SignalStep",
    "StartStep",
    "Step",
    "TimedStep",
    "WaitForStep",
    "WaitStep",
    "WaitUntilStep",
    "WaitingStep",
    "WhileStep",
    "call_fields",
    "final_action",
    "inner_steps",
    "resolved_fields",
]
