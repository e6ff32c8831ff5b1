"""`eal dashboard` in a process of its own."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import pytest
from websockets.sync.client import connect
from websockets.typing import Origin

from tests.operate.dashboard.rig import ROOT, WAIT_S, Page

LOCAL = ROOT / "fleets/local.yaml"


@contextmanager
def started(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Start the command in a folder; yield its process and the address that it prints."""
    command = [sys.executable, "-m", "eal_actors", "dashboard", "--fleet", str(LOCAL), "--port", "0", *options]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NO_COLOR": "1"}
    process = subprocess.Popen(
        command, cwd=folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        match = re.search(r"http://\S+", process.stdout.readline())
        assert match is not None, process.communicate()[1]
        yield process, match.group()
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_a_signal(tmp_path: Path, number: signal.Signals) -> None:
    with started(tmp_path) as (process, address):
        with urlopen(address, timeout=WAIT_S) as answer:  # noqa: S310  # its own address
            assert b"<title>eal dashboard</title>" in answer.read()
        process.send_signal(number)
        out, err = process.communicate(timeout=WAIT_S)
        assert (process.returncode, err) == (0, "")
        assert "halting the robots" in out


def test_the_link_holds_a_token_once_and_it_commands(tmp_path: Path) -> None:
    with started(tmp_path, "--token") as (process, link):
        address, _, token = link.partition("#token=")
        assert len(token) >= 32
        place = address.removeprefix("http://").rstrip("/")
        with connect(f"ws://{place}/ws", origin=Origin(f"http://{place}"), compression=None, proxy=None) as opened:
            page = Page(opened, token)
            assert page.hello["may_command"] is True
            assert page.ask(do="stop")["ok"] is True
            assert "dance.yaml" in {entry["file"] for entry in page.ask(do="scenarios")["scenarios"]}
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=WAIT_S)
        assert token not in out + err


def test_other_machines_may_only_watch_without_a_token(tmp_path: Path) -> None:
    with started(tmp_path, "--host", "0.0.0.0") as (process, address):  # noqa: S104
        place = address.removeprefix("http://").rstrip("/")
        with connect(f"ws://{place}/ws", origin=Origin(f"http://{place}"), compression=None, proxy=None) as opened:
            page = Page(opened, None)
            assert page.hello["may_command"] is False
            assert page.ask(do="stop")["code"] == "access_denied"
        assert process.stdout is not None
        assert process.stdout.readline().startswith("read-only: use --token")


def test_a_port_in_use_is_reported_in_one_line(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        done = subprocess.run(
            [sys.executable, "-m", "eal_actors", "dashboard", "--fleet", str(LOCAL), "--port", port],
            cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
    assert done.returncode == 2
    assert f"127.0.0.1:{port}: cannot listen there: Address already in use" in done.stderr
    assert "Traceback" not in done.stderr
