"""`--metrics-port` of `eal run` and `eal serve`, scraped over HTTP."""

from __future__ import annotations

import re
import signal
import socket
from pathlib import Path
from typing import Any

from eal_actors import Fleet
from tests.net.links import free_port
from tests.operate.metrics.scraping import samples, scrape

LISTENS = re.compile(r"^metrics at http://127\.0\.0\.1:(\d+)/metrics$")


def port_of(process: Any) -> int:
    for line in process.stdout:
        if (match := LISTENS.match(line.strip())) is not None:
            return int(match[1])
    raise AssertionError(f"no metrics: {process.stderr.read()}")


class TestServe:
    def test_a_served_robot_reports_the_calls_of_controllers(self, start: Any, slides: Path) -> None:
        text = slides.read_text(encoding="utf-8")
        slides.write_text(text.replace("  one: {", f"  one: {{address: 'tcp/127.0.0.1:{free_port()}', "))
        process = start("serve", "--fleet", slides, "--robot", "one", "--metrics-port", 0)
        port = port_of(process)
        with Fleet.load(slides).connect(["one"]) as controller:
            controller["one"]["Slide"].send_cmd("to0.01").get()
            found = samples(scrape(port))
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)
        assert found["eal_calls_total", ("send_cmd", "done", "Slide", "one")] == 1
        assert found["eal_robot_state", ("one", "ready")] == 1
        assert found["eal_dead_man_trips_total", ("Slide", "one")] == 0
        assert found["eal_mailbox_depth", ("Slide", "one")] == 0


class TestRun:
    def test_a_run_is_reported_while_it_is_active(self, start: Any, slides: Path, write: Any) -> None:
        scenario = write(
            "far.yaml",
            """\
            version: 1
            name: far
            description: Move far.
            roles: {movers: {}}
            steps:
              - on: movers
                do:
                  - send_cmd: {resource: Slide, cmd: to1}
            """,
        )
        process = start("run", scenario, "--fleet", slides, "--no-plot", "--metrics-port", 0)
        found = samples(scrape(port_of(process)))
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
        assert found["eal_robot_state", ("two", "ready")] == 1
        assert ("eal_dead_man_trips_total", ("Slide", "one")) not in found  # a metric of `eal serve` only

    def test_nothing_moves_if_the_port_is_in_use(self, eal: Any, slides: Path, move: Path, tmp_path: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            result = eal("run", move, "--fleet", slides, "--metrics-port", port, "--runs-dir", tmp_path / "runs")
        assert result.exit_code == 3
        assert not (tmp_path / "runs").exists()
        assert f"metrics cannot be served at port {port}" in result.stderr
