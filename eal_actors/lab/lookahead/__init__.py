"""A look ahead during a run: where the plan takes the robots from their estimated poses, and warnings before they meet.

scripts = rehearse_scripts(scenario, twins, binding)
with Lookahead(fleet, plan.robots, scripts) as lookahead:
    run = Run(plan, fleet, directory, [lookahead.hear])
    lookahead.attach(run)
    report = run.start().get()
"""
