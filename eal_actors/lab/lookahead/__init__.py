"""A look ahead during a run: where the plan takes the robots from their estimated poses, and warnings before they meet.

scripts = rehearse_scripts(scenario, twins, binding)
with Lookahead(fleet, plan.robots, scripts) as lookahead:
    run = Run(plan, fleet, directory, [lookahead.hear])
    lookahead.attach(run)
    report = run.start().get()
"""

from eal_actors.lab.lookahead.forecast import Forecast, ForeseenEvent, PresentState, forecast
from eal_actors.lab.lookahead.script import Script, ScriptStep, rehearse_scripts
from eal_actors.lab.lookahead.watching import Lookahead, LookaheadOptions

__all__ = [
    "Forecast",
    "ForeseenEvent",
    "Lookahead",
    "LookaheadOptions",
    "PresentState",
    "Script",
    "ScriptStep",
    "forecast",
    "rehearse_scripts",
]
