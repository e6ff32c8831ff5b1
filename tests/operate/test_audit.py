"""The audit log keeps its whole lines whatever a crash has left."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from eal_actors.cli.app import app
from eal_actors.operate.audit import AUDIT_FILE, AuditLog, read_audit

_DAMAGED = (
    b"\xff\xfe\n",
    b"[1]\n",
    b'{"id": "x", "command": "stop"}\n',
    b'{"id": "x", "at": "yesterday", "outcome": "ok"}\n',
    b'{"id": ["x"], "at": "2026-01-01T00:00:00+00:00", "outcome": "ok"}\n',
    b'{"id": "x", "at": "2026-01-01T00:00:00+00:00", "who": "u", "from": "f", "command": "c", "arguments": 1}\n',
    b'{"at": "2026-01-01T00:0',
)


@pytest.mark.parametrize("line", _DAMAGED)
def test_a_damaged_line_hides_no_other(tmp_path: Path, line: bytes) -> None:
    """The last one has no end: a crash has cut it off, and the next program appends to the file."""
    (tmp_path / AUDIT_FILE).write_bytes(line)
    log = AuditLog(tmp_path).start()
    log.begin({"who": "ann", "role": "run", "from": "here"}, "stop", {})("ok")
    log.close()
    found = read_audit(tmp_path)
    assert [(entry["who"], entry["command"], entry["outcome"]) for entry in found] == [("ann", "stop", "ok")]
    shown = CliRunner().invoke(app, ["audit", "--runs-dir", str(tmp_path)])
    assert shown.exit_code == 0, shown.output
    assert "ann" in shown.stdout
