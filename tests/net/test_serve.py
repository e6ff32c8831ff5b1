"""`eal serve`: how it ends, and that it serves a robot that has failed."""

from __future__ import annotations

import os
import pty
import re
import socket
import subprocess
import sys
import termios
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

import pytest

from eal_actors import Fleet, gather
from eal_actors.actors.robot_view import RobotState
from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.output import service_output
from eal_actors.cli.serve import _reload
from eal_actors.facade.service import RobotService, serve_together
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import DataError, DeadlineError, ResourceFaultError, RobotFailedError, UnavailableError
from eal_actors.wire.rpc.client.remote_robot import RemoteRobot
from eal_actors.wire.rpc.server.outbox import Outbox
from eal_actors.wire.rpc.server.server_tokens import ServerTokens
from eal_actors.wire.session import open_session, robot_config, router_config
from eal_actors.wire.transport import Transport
from tests.log_lines import log_lines
from tests.net.links import eventually, free_port
from tests.net.rig import WAIT_S, Rig, becomes, failure, ready, servers
from tests.plugin_files import write_plugin
from tests.program import eal_processes, paused_terminal


def test_it_ends_at_sigterm_while_its_terminal_is_paused(tmp_path: Path) -> None:
    """Its output blocked it for good."""
    rig = Rig(tmp_path)
    with paused_terminal() as terminal, eal_processes(tmp_path) as start:
        arguments = "serve", "--fleet", rig.file, "--robot", "r1"
        server = start(*arguments, environment=os.environ, stdout=terminal)
        with ready(Fleet(rig.config)):
            server.terminate()
            assert server.wait(WAIT_S) == 0


def test_a_service_can_be_opened_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    service = RobotService(rig.config, "r1")
    for _ in range(2):
        with service, ready(Fleet(rig.config)) as fleet:
            assert fleet["r1"]["Gauge"].get_value().get(timeout=WAIT_S).value == -42


def test_the_error_of_a_reload_does_not_wait_for_a_paused_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path)
    with ExitStack() as stack:
        master, slave = pty.openpty()
        stack.callback(os.close, master)
        terminal = stack.enter_context(os.fdopen(slave, "w", encoding="utf-8"))
        stack.callback(termios.tcflow, slave, termios.TCOON)
        service = stack.enter_context(RobotService(rig.config, "r1"))
        rig.file.write_text("{")
        termios.tcflow(slave, termios.TCOOFF)
        monkeypatch.setattr(sys, "stderr", terminal)
        thread = threading.Thread(target=_reload, args=(service, service_output(), GlobalOptions()), daemon=True)
        thread.start()
        thread.join(WAIT_S / 3)
        assert not thread.is_alive()
        termios.tcflow(slave, termios.TCOON)
        assert b"not valid YAML" in os.read(master, 10_000)


def test_a_robot_that_has_failed_is_served_with_the_reason(tmp_path: Path) -> None:
    rig = Rig(tmp_path, extra={"defaults": {"max_restarts": 0}})
    with rig.served_here() as fleet:
        robot = fleet["r1"]
        failure(robot["Arm"].send_cmd("crash"), ResourceFaultError)
        assert becomes(robot, RobotState.FAILED)
        assert robot.ping().get(timeout=WAIT_S).state is RobotState.FAILED
        assert "stopped safely after more than 0 restarts" in robot.problems[-1].message
        assert "stopped safely after more than 0 restarts" in str(failure(robot["Arm"].get_value(), RobotFailedError))
        assert rig.notes("halt")


def test_a_robot_that_fits_no_handshake_is_refused(tmp_path: Path) -> None:
    """Each controller refused it; `eal serve` said nothing."""
    code = "from eal_actors.plugin import EALPlugin, Resource\nclass Lamp(Resource):\n    __doc__ = 'x' * 2**20\n"
    write_plugin(tmp_path, "lamp", code, "Lamp")
    rig = Rig(tmp_path)
    rig.content["plugin_dirs"] = ["plugins"]
    rig.content["robots"]["r1"]["plugins"] = {"lamp": {}}
    rig.write()
    with pytest.raises(DataError, match="r1: cannot be served: the information of its resources"):
        RobotService(rig.config, "r1").open()


@pytest.mark.parametrize("together", [False, True])
def test_a_port_that_another_program_holds_is_reported_before_the_robot_starts(tmp_path: Path, together: bool) -> None:
    """It started the robot first, which took 13 s on a busy machine."""
    code = "from eal_actors.plugin import EALPlugin, Resource\nclass Lamp(Resource): pass\ndef connect():\n    1 / 0\n"
    write_plugin(tmp_path, "lamp", code, "Lamp")
    rig = Rig(tmp_path)
    rig.content["plugin_dirs"] = ["plugins"]
    rig.content["robots"]["r1"]["plugins"] = {"lamp": {}}
    rig.write()
    service = serve_together(rig.config, ["r1"]) if together else RobotService(rig.config, "r1")
    address = str(rig.config.robots["r1"].address)
    with socket.create_server(("127.0.0.1", int(address.rpartition(":")[2]))) as held:
        holder = subprocess.Popen(["sleep", "60"], stdin=held.fileno())
        try:
            with pytest.raises(UnavailableError) as refused:
                service.__enter__()
        finally:
            holder.kill()
            holder.wait()
    assert refused.value.message.startswith(f"{address}: cannot listen there: the port is in use by ")
    assert f"this program (pid {os.getpid()})" in refused.value.message
    assert f"sleep (pid {holder.pid})" in refused.value.message


def look_in_step(look: Callable[[], dict[str, str]], in_step: threading.Barrier) -> dict[str, str]:
    """Look for other processes at the same instant as they do, and once their tokens have passed the router."""
    with suppress(threading.BrokenBarrierError):
        in_step.wait()
        REAL_TIME.sleep(0.1)
    others = look()
    with suppress(threading.BrokenBarrierError):
        in_step.wait()
    return others


def test_the_state_follows_a_robot_that_has_failed_and_its_server_that_starts_again(tmp_path: Path) -> None:
    """It was ready, as far as controllers saw."""
    rig = Rig(tmp_path, extra={"defaults": {"max_restarts": 0}})
    with servers(rig) as running, ready(Fleet(rig.config)) as fleet:
        robot = fleet["r1"]
        states: list[RobotState] = []
        robot.on_state(states.append)
        failure(robot["Arm"].send_cmd("crash"), ResourceFaultError)
        assert becomes(robot, RobotState.FAILED)
        with Fleet(rig.config) as late:
            assert late["r1"].state is RobotState.FAILED  # for one that connects now too
        reason = failure(robot["Arm"].send_cmd("step0"), RobotFailedError).message
        with pytest.raises(RobotFailedError, match=f"^r1: {re.escape(reason)}"):
            robot.require_started()
        running.start("r1")
        assert becomes(robot, RobotState.READY), robot.problems
        assert robot["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
        assert states == [RobotState.READY, RobotState.FAILED, RobotState.LOST, RobotState.READY]


def test_a_ping_repairs_a_state_whose_event_was_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path, extra={"defaults": {"max_restarts": 0}})
    with rig.served_here() as fleet:
        robot = fleet["r1"]
        monkeypatch.setattr(RemoteRobot, "_handle_robot_event", lambda *_: None)
        failure(robot["Arm"].send_cmd("crash"), ResourceFaultError)
        assert eventually(lambda: robot.ping().get(timeout=WAIT_S).state is RobotState.FAILED)
        assert becomes(robot, RobotState.FAILED)


class TestBehindARouter:
    """Two processes served one robot, and both carried out its commands."""

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        """A robot behind a router; on a busy machine, a link with a shorter lease may lapse."""
        router = f"tcp/127.0.0.1:{free_port()}"
        rig = Rig(tmp_path, network={"routers": [router], "lease_s": 1.0}, behind="router")
        with open_session(router_config([router])):
            yield rig

    def test_a_second_process_is_refused_and_told_of_the_first(self, rig: Rig) -> None:
        with rig.served_here() as fleet:
            steps = [fleet["r1"]["Arm"].send_cmd(f"step{number}") for number in range(3)]
            with pytest.raises(UnavailableError, match=rf"r1: is served already, by .*\(pid {os.getpid()}\)"):
                RobotService(rig.config, "r1").open()
            steps += [fleet["r1"]["Arm"].send_cmd(f"step{number}") for number in range(3, 6)]
            assert gather(steps).get(timeout=WAIT_S) == list(range(6))
            assert rig.steps() == [str(number) for number in range(6)]
        with rig.served_here():
            pass  # the first one has left

    def test_one_of_those_that_start_together_remains(self, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
        """Each refused for the others, and a service manager started them again together, for ever."""
        processes = "first", "second", "third"
        with ExitStack() as stack:
            in_step = threading.Barrier(len(processes))
            tokens = {process: self.tokens(rig, process, stack) for process in processes}
            for one in tokens.values():
                monkeypatch.setattr(one, "_servers", partial(look_in_step, one._servers, in_step))
            pool = stack.enter_context(ThreadPoolExecutor(len(processes)))
            claims = {process: pool.submit(one.claim) for process, one in tokens.items()}
            wait(claims.values(), WAIT_S, FIRST_COMPLETED)
            in_step.abort()
            errors = {process: claim.exception(WAIT_S) for process, claim in claims.items()}
            assert errors["first"] is None
            for process in processes[1:]:
                assert isinstance(errors[process], UnavailableError)

    def test_one_that_serves_the_robot_outlasts_one_that_goes_first(self, rig: Rig) -> None:
        with ExitStack() as stack:
            tokens = self.tokens(rig, "second", stack)
            tokens.claim()
            tokens.announce()
            with pytest.raises(UnavailableError, match="r1: is served already, by"):
                self.tokens(rig, "first", stack).claim()

    def tokens(self, rig: Rig, process: str, stack: ExitStack) -> ServerTokens:
        """Return the tokens of a process with an identifier, on a session of its own."""
        session = stack.enter_context(open_session(robot_config(rig.config, "r1")))
        return ServerTokens(Outbox(process, Transport(session)), "f", "r1", process, rig.config.network.lease_s)

    def test_the_place_of_a_process_that_was_cut_off_is_taken(self, rig: Rig) -> None:
        with servers(rig) as running:
            running["r1"].freeze()
            with rig.served_here() as fleet:
                assert fleet["r1"]["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
                assert not fleet["r1"].ping().get(timeout=WAIT_S).warnings
                running["r1"].thaw()  # both serve the robot, and say so
                assert eventually(
                    lambda: "serves the robot too" in str(fleet["r1"].ping().get(timeout=WAIT_S).warnings)
                )

    def test_a_command_for_another_process_is_left_to_it(self, rig: Rig) -> None:
        """While its link was renewed, the other one saw no second process, and refused the command as stale."""
        with rig.served_here() as fleet:
            robot = fleet["r1"]
            robot.ping().get(timeout=WAIT_S)  # the last reply that is due: each shows the robot's own process
            robot._actor.calls._heard("another", REAL_TIME.now(), REAL_TIME.now())  # type: ignore[attr-defined]
            failure(robot["Arm"].send_cmd("step0", timeout_s=0.5), DeadlineError)
            robot.ping().get(timeout=WAIT_S)
            assert robot["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
            assert rig.steps() == ["1"]

    def test_while_two_processes_serve_a_robot_each_command_has_the_answer_of_the_one_that_executes_it(
        self, rig: Rig
    ) -> None:
        """The other one refused it as stale, and often answered first."""
        with servers(rig) as running:
            running["r1"].freeze()
            with log_lines("error") as lines, rig.served_here() as fleet:
                running["r1"].thaw()
                running["r1"].wait_for("another process serves the robot too")
                assert eventually(lambda: "another process serves the robot too" in lines.getvalue())
                steps = [str(number) for number in range(20)]
                outcomes = [fleet["r1"]["Arm"].send_cmd(f"step{step}").get(timeout=WAIT_S) for step in steps]
                assert outcomes == list(range(20))
                assert rig.steps() == steps
