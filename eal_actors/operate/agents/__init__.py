"""Agents: programs such as language models that watch a fleet, and move it by plans that a person has approved.

An agent's only way to move a robot is a *plan*: the text of a scenario. `PlanGate` checks it, makes its dry run,
rehearses it in simulation and stores it under its hash. It runs only after a person has approved that hash, or if a
policy allows it, once, and on the fleet that it was rehearsed with. Nothing that an agent or a robot says changes this:
the gate reads a plan's content, its hash and the decision's file, and no other text.
"""

from eal_actors.operate.agents.gate import PlanGate
from eal_actors.operate.agents.plans import Decision, PlanStore, StoredPlan
from eal_actors.operate.agents.policy import Policy, load_policy

__all__ = ["Decision", "PlanGate", "PlanStore", "Policy", "StoredPlan", "load_policy"]
