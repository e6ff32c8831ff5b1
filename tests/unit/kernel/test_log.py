from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from collections.abc import Iterator

import pytest
import structlog

from eal_actors.device.resource import Resource, command
from eal_actors.kernel.log import configure_logging, get_logger
from tests.robots import running_robot


@pytest.fixture(autouse=True)
def unconfigured() -> Iterator[None]:
    yield
    structlog.reset_defaults()


class Chatty(Resource):
    """Logs from inside a plugin."""

    @command("talk")
    def talk(self) -> None:
        get_logger().info("hello from the plugin")
        get_logger(robot="another").info("it has not answered")


def test_json_lines_name_robot_resource_and_call_wherever_they_are_written() -> None:
    stream = io.StringIO()
    configure_logging("json", "debug", stream)
    with running_robot({"Chatty": Chatty}) as robot:
        robot["Chatty"].send_cmd("talk").get()
        robot["Chatty"].send_cmd("shout").exception()
    lines = [json.loads(line) for line in stream.getvalue().splitlines()]
    spoken = next(line for line in lines if line["event"] == "hello from the plugin")
    assert (spoken["robot"], spoken["resource"], spoken["level"]) == ("robot", "Chatty", "info")
    other = next(line for line in lines if line["event"] == "it has not answered")
    assert (other["robot"], other.get("resource"), other.get("call")) == ("another", None, None)
    failed = next(line for line in lines if line["event"] == "call failed")
    assert failed["method"] == "send_cmd 'shout'"
    assert {line["call"] for line in lines if line["event"] == "call"} == {spoken["call"], failed["call"]}


def test_human_lines_have_no_colours_where_there_is_no_terminal() -> None:
    stream = io.StringIO()
    configure_logging("human", "info", stream)
    get_logger(robot="evbot").info("moving", speed_m_s=0.2)
    get_logger().debug("too much")
    assert "moving" in stream.getvalue()
    assert "robot=evbot" in stream.getvalue()
    assert "\x1b[" not in stream.getvalue()
    assert "too much" not in stream.getvalue()


def test_without_configuration_only_warnings_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    get_logger().info("chatter")
    get_logger().warning("trouble")
    shown = capsys.readouterr()
    assert "chatter" not in shown.err
    assert "trouble" in shown.err
    assert shown.out == ""


def test_a_closed_stream_stops_nobody() -> None:
    stream = io.StringIO()
    configure_logging("human", "info", stream)
    stream.close()
    get_logger().error("into the void")


def test_no_stderr_at_all_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    configure_logging("human", "info")
    monkeypatch.setattr(sys, "stderr", None)
    get_logger().error("into the void")


def test_a_pipe_that_nobody_reads_stops_nobody() -> None:
    """As a terminal that is paused with Ctrl-S: the threads of a robot that logged did nothing more."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(4096))
    os.set_blocking(writing, True)
    with os.fdopen(reading, encoding="utf-8") as pipe, os.fdopen(writing, "w", encoding="utf-8") as stream:
        configure_logging("human", "info", stream)
        for number in range(3):
            get_logger().warning("halted", number=number)
        lines = (pipe.readline() for _ in range(3))
        assert [line.split("number=")[1] for line in lines] == ["0\n", "1\n", "2\n"]
