"""Python's own `logging` receives every line."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator

import pytest
import structlog

from eal_actors.kernel.log import configure_logging, get_logger


@pytest.fixture(autouse=True)
def configured() -> Iterator[io.StringIO]:
    stream = io.StringIO()
    configure_logging(level="info", stream=stream)
    yield stream
    structlog.reset_defaults()


def test_a_line_has_its_level_its_words_and_its_fields(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "eal_actors")
    get_logger(robot="roomba-1").warning("docked", places=2)
    get_logger().debug("below the level")
    (record,) = caplog.records
    assert (record.name, record.levelno) == ("eal_actors", logging.WARNING)
    assert record.getMessage() == "docked robot=roomba-1 places=2"
    assert record.__dict__["eal"] == {"robot": "roomba-1", "places": 2}


def test_an_exception_keeps_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    try:
        raise ValueError("100 %d percent")
    except ValueError:
        get_logger().exception("failed %s")
    assert caplog.records[0].exc_info is not None
    assert "100 %d percent" in caplog.text


def test_a_program_without_handlers_gets_no_second_line(
    configured: io.StringIO, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(logging.getLogger("eal_actors"), "propagate", False)  # as if the root had none
    get_logger().error("once")
    assert configured.getvalue().count("once") == 1
    assert capsys.readouterr().err == ""
