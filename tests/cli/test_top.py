"""`eal top`, driven by Textual's pilot, with robots of this process and a served one."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import DataTable, Static

from eal_actors import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import PreemptedError, StoppedError
from eal_actors.managers.config import EALConfigManager
from eal_actors.operate.metrics.call_observer import observe_calls
from eal_actors.operate.top.call_statistics import RecentCalls
from eal_actors.operate.top.run_progress import latest_run, progress_of
from eal_actors.operate.top.screen import Details, LogBuffer, TopApp
from tests.manual_clock import ManualClock
from tests.net.links import eventually, free_port

Script = Callable[[TopApp, Pilot[None]], Awaitable[None]]


def watch(fleet: Fleet, runs: Path, script: Script, lines: LogBuffer | None = None) -> None:
    """Run a script on the screen, without a terminal and without timers."""
    calls = RecentCalls()
    clock = fleet.clock

    async def play() -> None:
        app = TopApp(fleet, calls, runs, lines, update_period_s=None)
        async with app.run_test(size=(140, 30)) as pilot:
            await script(app, pilot)

    with observe_calls(clock, lambda call, _, taken_s: calls.add(call.cell.robot, clock.now(), taken_s)):
        asyncio.run(play())


def cells(app: TopApp, robot: str) -> list[str]:
    return [str(cell) for cell in app.screen_stack[0].query_one(DataTable).get_row(robot)]


def text(app: TopApp, where: str) -> str:
    return str(app.screen.query_one(where, Static).render())


@pytest.fixture
def fleet(slides: Path) -> Any:
    with ExitStack() as stack:
        yield stack.enter_context(Fleet(EALConfigManager.load(slides).fleet, ManualClock()).connect())


class TestRobots:
    def test_states_commands_and_statistics_are_shown(self, fleet: Fleet, tmp_path: Path) -> None:
        clock: Any = fleet.clock

        async def script(app: TopApp, pilot: Pilot[None]) -> None:
            assert cells(app, "one")[:8] == ["one", "ready", "0", "–", "0.0", "–", "–", "0"]
            for _number in range(20):
                fleet["one"]["Slide"].get_status().get()
            drive = fleet["one"]["Slide"].send_cmd("to1")
            fleet["one"]["Slide"].get_status().get()
            clock.advance(0.5)
            app.refresh_fleet()
            one = cells(app, "one")
            assert one[4] == "2.1"  # 21 calls have ended in 10 s
            assert one[5:7] == ["0.0 ms", "0.0 ms"]
            assert "Slide to1" in one[8]
            await pilot.pause()
            table = app.screen_stack[0].query_one(DataTable)
            shown = " ".join(table.render_line(1).text.split())
            assert shown.startswith("one ready 0 – 2.1 0.0 ms 0.0 ms 0 Slide to1"), "columns are as wide as their cells"
            assert cells(app, "two")[4] == "0.0"
            assert text(app, "#head") == "slides: 2 of 2 robots ready"
            drive.cancel()

        watch(fleet, tmp_path, script)

    def test_stop_and_resume_reach_every_robot(self, fleet: Fleet, tmp_path: Path) -> None:
        async def script(app: TopApp, pilot: Pilot[None]) -> None:
            drive = fleet["two"]["Slide"].send_cmd("to1")
            fleet["two"]["Slide"].get_status().get()
            await pilot.press("s")
            assert isinstance(drive.exception(), PreemptedError)
            assert all(robot.stopped_because == "stopped at eal top" for robot in fleet.values())
            assert isinstance(fleet["one"]["Slide"].send_cmd("to1").exception(), StoppedError)
            app.refresh_fleet()
            assert cells(app, "one")[1] == "STOP"
            await pilot.press("r")
            app.refresh_fleet()
            assert [cells(app, name)[1] for name in fleet] == ["ready", "ready"]

        watch(fleet, tmp_path, script)

    def test_details_of_the_robot_under_the_cursor_and_stop_from_there(self, fleet: Fleet, tmp_path: Path) -> None:
        async def script(app: TopApp, pilot: Pilot[None]) -> None:
            await pilot.press("down", "enter")
            await pilot.pause()
            assert isinstance(app.screen, Details)
            app.refresh_fleet()
            assert "two: ready, in this process" in text(app, "#details")
            assert "Slide, 0 calls waiting" in text(app, "#details")
            await pilot.press("s")
            app.refresh_fleet()
            assert "emergency stop: stopped at eal top" in text(app, "#details")
            await pilot.press("escape")
            await pilot.pause()
            assert not isinstance(app.screen, Details)
            await pilot.press("q")
            assert app._exit

        watch(fleet, tmp_path, script)

    def test_ctrl_c_quits_from_every_screen(self, fleet: Fleet, tmp_path: Path) -> None:
        async def script(app: TopApp, pilot: Pilot[None]) -> None:
            await pilot.press("enter")
            await pilot.pause()
            assert isinstance(app.screen, Details)
            await pilot.press("ctrl+c")
            assert app._exit

        watch(fleet, tmp_path, script)

    def test_the_last_log_lines_are_shown(self, fleet: Fleet, tmp_path: Path) -> None:
        lines = LogBuffer(most=2)

        async def script(app: TopApp, _: Pilot[None]) -> None:
            lines.write("first\nsecond\n")
            lines.write("third\n")
            app.refresh_fleet()
            assert text(app, "#log") == "second\nthird"

        watch(fleet, tmp_path, script, lines)

    def test_a_remote_robot_is_pinged(self, slides: Path, tmp_path: Path) -> None:
        source = slides.read_text(encoding="utf-8").replace("  two: {plugins: {slide: {}}}\n", "")
        slides.write_text(source.replace("  one: {", f"  one: {{address: 'tcp/127.0.0.1:{free_port()}', "))
        config = EALConfigManager.load(slides).fleet

        async def script(app: TopApp, pilot: Pilot[None]) -> None:
            assert cells(app, "one")[1:4] == ["ready", "–", "–"]  # it has not answered yet

            def is_measured() -> bool:
                app.refresh_fleet()
                return cells(app, "one")[5].endswith("ms")

            assert eventually(is_measured)
            assert cells(app, "one")[2] == "0"
            assert cells(app, "one")[7] == "0"
            await pilot.press("s")
            assert eventually(lambda: service.robot.stopped_because == "stopped at eal top")

        with RobotService(config, "one") as service, Fleet(config).connect() as opened:
            watch(opened, tmp_path, script)


class TestRuns:
    def test_the_progress_of_a_real_run_of_this_fleet_is_shown(
        self, eal: Any, slides: Path, move: Path, tmp_path: Path
    ) -> None:
        runs = tmp_path / "runs"
        assert eal("run", move, "--fleet", slides, "--runs-dir", runs, "--rate", "max").exit_code == 0
        with Fleet.load(slides).connect() as fleet:

            async def script(app: TopApp, _: Pilot[None]) -> None:
                assert text(app, "#run") == "last run: move done, 4/4 calls"

            watch(fleet, runs, script)
        (file,) = runs.glob("*/events.jsonl")
        lines = file.read_text(encoding="utf-8").splitlines()
        kinds = [json.loads(line)["event"] for line in lines]
        end = kinds.index("step_ended")
        start = kinds.index("step_started", end)  # that robot's next step, whichever robot was first
        cut = progress_of([*lines[: start + 1], lines[start + 1][:10]])  # while the next line is being written
        assert cut is not None
        assert (cut.done, cut.calls, cut.outcome) == (kinds[:start].count("step_ended"), 4, None)
        assert cut.steps

    def test_runs_of_other_fleets_are_not_shown(self, eal: Any, slides: Path, move: Path, tmp_path: Path) -> None:
        eal("run", move, "--fleet", slides, "--runs-dir", tmp_path / "runs", "--rate", "max")
        assert latest_run(tmp_path / "runs", "others") is None
        assert latest_run(tmp_path / "nowhere", "slides") is None


class TestStatistics:
    @pytest.mark.parametrize("line", ["[1]", '{"event": "run_started"}', '{"event": "step_ended", "record": 1}'])
    def test_a_damaged_record_is_skipped(self, eal: Any, slides: Path, move: Path, tmp_path: Path, line: str) -> None:
        """Of both the newest one, which is damaged, and the one before it, the second is shown."""
        for _ in range(2):
            assert eal("run", move, "--fleet", slides, "--rate", 20, "--no-plot", "--runs-dir", tmp_path).exit_code == 0
        _, second = sorted(tmp_path.glob("move-*"), key=lambda run: (run / "events.jsonl").stat().st_mtime_ns)
        with (second / "events.jsonl").open("a", encoding="utf-8") as events:
            events.write(f"{line}\n")
        found = latest_run(tmp_path, "slides")
        assert found is not None
        assert found.outcome == "done"

    def test_quantiles_and_rates_of_the_last_seconds(self) -> None:
        recent = RecentCalls()
        recent.add("one", 0.0, 9.0)  # too long ago
        for number in range(100):
            recent.add("one", 10.5, (number + 1) / 100)
        statistics = recent.statistics("one", 11.0)
        assert (statistics.calls_per_s, statistics.p50_s, statistics.p99_s) == (10.0, 0.5, 0.99)
        assert recent.statistics("two", 11.0).p50_s is None

    def test_the_rate_of_a_flood_comes_from_the_kept_calls(self) -> None:
        recent = RecentCalls()
        for number in range(10_000):
            recent.add("one", number / 10_000, 0.001)
        assert recent.statistics("one", 1.0).calls_per_s == pytest.approx(10_000, rel=0.01)


def test_without_a_terminal_it_fails_with_the_reason(eal: Any, slides: Path) -> None:
    result = eal("top", "--fleet", slides)
    assert result.exit_code == 2
    assert "needs a terminal" in result.stderr
