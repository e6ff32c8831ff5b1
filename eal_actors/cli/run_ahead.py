"""`eal run --lookahead`: the rehearsal before the run, and the look-ahead during it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

from eal_actors.cli.run_options import RunRequest
from eal_actors.facade.fleet import Fleet
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Plan
from eal_actors.scenario.language.binding import bound_robots

if TYPE_CHECKING:
    from eal_actors.lab.lookahead.script import Script
    from eal_actors.lab.lookahead.watching import Lookahead, LookaheadOptions


@dataclass(frozen=True, slots=True)
class Ahead:
    """The scripts of a rehearsal, and what to look for."""

    scripts: Mapping[str, Script]
    options: LookaheadOptions

    def watcher(self, fleet: Fleet, plan: Plan) -> Lookahead:
        """Return the look-ahead of a run."""
        from eal_actors.lab.lookahead.watching import Lookahead

        robots = tuple(name for name in plan.robots if name not in plan.lost)
        return Lookahead(fleet, robots, self.scripts, self.options)


def rehearse_ahead(request: RunRequest, horizon_s: float | None, *, holds: bool) -> Ahead | None:
    """Rehearse the scenario in simulation; None without a horizon.

    Raises:
        BadParameter: `--lookahead-hold` without `--lookahead`, or a look ahead of a resumed run.
        ConfigError: a robot cannot be simulated.
    """
    if horizon_s is None:
        if holds:
            raise typer.BadParameter("needs --lookahead", param_hint="'--lookahead-hold'")
        return None
    if request.resumption is not None:
        why = "not with --resume: the rehearsal begins at the first step"
        raise typer.BadParameter(why, param_hint="'--lookahead'")
    from eal_actors.lab.lookahead.script import rehearse_scripts
    from eal_actors.lab.lookahead.watching import LookaheadOptions

    twins = simulated(request.config, bound_robots(request.scenario, request.config, request.binding))
    scripts = rehearse_scripts(request.scenario, twins, request.binding)
    return Ahead(scripts, LookaheadOptions(horizon_s=horizon_s, holds=holds))
