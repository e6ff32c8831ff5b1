"""What can be wrong with a scenario: by itself, and on the robots that will carry it out."""

from eal_actors.scenario.checks.scope import check_scope

__all__ = ["check_scope"]
