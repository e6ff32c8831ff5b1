"""`eal mcp`: a fleet for agents, by the Model Context Protocol. `eal approve`: a person's decision about a plan."""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.fleets import in_real_time, read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.live_view import FoxgloveOption, foxglove_at
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import new_table, print_line, service_output, stdout, write_json
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.posix import user_name
from eal_actors.managers.missing_modules import needs_extra, require_modules
from eal_actors.operate.audit import AuditLog

if TYPE_CHECKING:
    from eal_actors.operate.agents import Decision, StoredPlan

_RunsDirOption = Annotated[Path, typer.Option(help="The folder of runs, plans and the audit log.")]
_TYPED: Final = 6  # characters of the hash that a person types


def serve_agents(
    fleet: FleetOption,
    http: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, metavar="PORT", help="Serve HTTP on loopback, with a token, in place of stdio; 0: any."
        ),
    ] = None,
    policy: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="A file of plans that need no person.")
    ] = None,
    runs_dir: _RunsDirOption = Path("runs"),
    rehearsal_limit_s: Annotated[
        float, typer.Option("--rehearsal-limit-s", min=1, max=3600, help="Real seconds for the rehearsals of a plan.")
    ] = 120.0,
    foxglove: FoxgloveOption = None,
) -> None:
    """Serve a fleet to agents by the Model Context Protocol, until its client leaves or Ctrl-C; then all robots halt.

    Agents read the fleet, and check and rehearse plans. A plan, the text of a scenario, moves robots only after a
    person has approved it with `eal approve` or on the dashboard, or if the policy allows it. STOP needs no approval.
    `eal audit` shows every request.
    """
    with needs_extra("mcp", "the door for agents needs"):
        from eal_actors.operate.agents import PlanGate, load_policy
        from eal_actors.operate.agents.server import AgentServer
    handle_signals()
    rules = load_policy(policy) if policy is not None else None
    config = in_real_time(read_fleet(fleet))
    require_modules(config, config.robots)
    console = service_output(sys.stderr)  # stdout is the protocol's
    with ExitStack() as stack:
        protocol_stdout = stack.enter_context(_stdout_for_protocol() if http is None else nullcontext(nullcontext))
        audit = stack.enter_context(closing(AuditLog(runs_dir).start()))
        opened = stack.enter_context(Fleet(config).connect())
        stack.enter_context(foxglove_at(foxglove, opened, console, allow_control=False))
        gate = PlanGate(opened, runs_dir, rules, rehearsal_limit_s)
        stack.callback(gate.close)
        server = AgentServer(gate, audit, runs_dir, "stdio" if http is None else "http")
        try:
            if http is None:
                try:
                    with protocol_stdout():
                        server.server.run("stdio")
                except* BrokenPipeError:
                    get_logger().info("the client has left while it was answered")
            else:
                _serve_http(server, http, console)
        except KeyboardInterrupt:
            console.print("halting the robots")


@contextmanager
def _stdout_for_protocol() -> Iterator[Callable[[], AbstractContextManager[None]]]:
    """Send what plugins, their libraries and processes print to stderr; yield what returns stdout to the SDK.

    The SDK does the same while it serves, but not while the fleet connects and disconnects.
    """
    kept = os.dup(1)

    def point_at(descriptor: int) -> None:
        sys.stdout.flush()
        os.dup2(descriptor, 1)

    @contextmanager
    def returned() -> Iterator[None]:
        point_at(kept)
        try:
            yield
        finally:
            os.dup2(2, 1)

    point_at(2)
    try:
        yield returned
    finally:
        point_at(kept)
        os.close(kept)


def _serve_http(server: Any, port: int, console: Console) -> None:
    import uvicorn

    from eal_actors.operate.dashboard.web_server import listen_at

    token = secrets.token_urlsafe(24)
    listener = listen_at("127.0.0.1", port)
    with listener:
        address = f"http://127.0.0.1:{listener.getsockname()[1]}/mcp"
        console.print(f"MCP: {address}\nAuthorization: Bearer {token}", soft_wrap=True, highlight=False)
        settings = uvicorn.Config(server.http(token), log_config=None, timeout_graceful_shutdown=1, lifespan="on")
        uvicorn.Server(settings).run(sockets=[listener])


def approve_plan(
    plan: Annotated[str | None, typer.Argument(metavar="[HASH]", help="The hash of a plan, or its beginning.")] = None,
    refuse: Annotated[bool, typer.Option("--refuse", help="Refuse the plan.")] = False,
    valid_min: Annotated[float, typer.Option(min=0.1, max=1440, help="Minutes within which it must start.")] = 15.0,
    runs_dir: _RunsDirOption = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """Approve or refuse the plan of an agent, after showing it; without a hash, list the plans.

    A plan shows its text, what each robot does, and its rehearsal. To approve it, type the first characters of its
    hash: this needs a terminal. An approval is for this text, these parameters and this fleet, and for one run.
    """
    from eal_actors.operate.agents.plans import PlanStore

    store = PlanStore(runs_dir)
    if plan is None:
        _list_plans(store, as_json=as_json)
        return
    found = store.find(plan)
    _print_plan(found, store.state(found))
    if not refuse and not _is_confirmed(found):
        raise ScenarioError(f"plan {found.hash[:12]} was not approved")
    with closing(AuditLog(runs_dir).start()) as audit:
        who = f"user {user_name()}"
        user = {"who": who, "role": "person", "from": "terminal"}
        finish = audit.begin(user, "refuse_plan" if refuse else "approve_plan", {"hash": found.hash})
        try:
            decision = store.decide(found, who, is_approved=not refuse, valid_min=valid_min)
        except ScenarioError as error:
            finish(f"refused: {error.message}")
            raise
        finish("ok")
    print_line(stdout(), _decided(found, decision))


def _decided(plan: StoredPlan, decision: Decision) -> Text:
    if not decision.is_approved:
        return Text(f"refused: plan {plan.hash[:12]}", "red")
    until = decision.valid_until.astimezone().strftime("%H:%M:%S")
    return Text(f"approved: plan {plan.hash[:12]} may run once, if it starts before {until}", "green")


def _is_confirmed(plan: StoredPlan) -> bool:
    """Ask at the terminal; a pipe is no person."""
    if not sys.stdin.isatty():
        raise ScenarioError("a plan is approved by a person at a terminal, or on the dashboard")
    typed = typer.prompt(f"To approve it, type {plan.hash[:_TYPED]}", default="", show_default=False, err=True)
    return bool(typed.strip() == plan.hash[:_TYPED])


def _list_plans(store: Any, *, as_json: bool) -> None:
    plans = [(plan, store.state(plan)) for plan in store.plans()]
    if as_json:
        write_json({"plans": [{**plan.model_dump(mode="json"), "state": state} for plan, state in plans]})
        return
    table = new_table("hash", "state", "scenario", "fleet", "robots", "agent", "submitted")
    for plan, state in plans:
        when = plan.submitted.astimezone().strftime("%Y-%m-%d %H:%M:%S")
        robots = ", ".join(plan.robots)
        table.add_row(plan.hash[:12], state, plan.name, plan.fleet, robots, Text(plan.agent), when)
    stdout().print(table)


def _print_plan(plan: StoredPlan, state: str) -> None:
    out = stdout()
    print_line(out, Text.assemble((f"{plan.name} on {plan.fleet}", "bold"), f", plan {plan.hash[:12]}, {state}"))
    print_line(out, Text(f"by agent {plan.agent!r} for {', '.join(plan.robots)}"))
    for name, value in plan.parameters.items():
        print_line(out, Text(f"  {name} = {_visible(str(value))}"))
    print_line(out, Text("\nText:", "bold"))
    for line in plan.text.splitlines():
        print_line(out, Text(f"  {_visible(line)}"))
    print_line(out, Text("\nSteps:", "bold"))
    for line in plan.steps:
        print_line(out, Text(f"  {_visible(line)}"))
    rehearsal = plan.rehearsal
    gaps = [near["gap_m"] for run in rehearsal["runs"] for near in run["nearest"].values()]
    closest = f", closest approach {min(gaps):.2f} m" if gaps else ""
    runs = len(rehearsal["runs"])
    print_line(out, Text(f"\nRehearsed {runs} times: done, {rehearsal['duration_s']:.1f} s{closest}"))


def _visible(line: str) -> str:
    """Return a line in which nothing is hidden from a person, such as characters that move the cursor or reverse it."""
    return "".join(one if one.isprintable() else f"\\u{ord(one):04x}" for one in line)
