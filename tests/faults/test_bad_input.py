"""`eal run` with bad input: it names the cause once, halts the robots, keeps the record, and ends."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.scenario_texts import scenario_of

PLUGIN = '''
import sys, threading
from pathlib import Path
from eal_actors.plugin import *

NOTES = Path(__file__).parent / "notes.txt"

def note(text):
    with NOTES.open("a") as file:
        file.write(text + "\\n")

class Base(Resource):
    """A base that can be made to fail."""
    types = ResourceType.ACTUATOR
    def halt(self):
        note("halt")
    @command("go")
    def go(self):
        note("motors on")
        try:
            yield 60.0
        finally:
            note("motors off")
    @command("hop")
    def hop(self): pass
    @command("raise")
    def raise_(self): raise OSError("cable off")
    @command("hang")
    def hang(self):
        while True:
            threading.Event().wait(0.01)
    @command("lie")
    def lie(self): return "fine"
    @command("exit")
    def exit(self): sys.exit(7)

def connect():
    if "CONNECT":
        raise OSError("no bus")
    return EALPlugin("Base")
def disconnect(plugin): pass
def create_Base(): return Base()
def destroy_Base(resource): pass
'''

MANIFEST = 'version: 1\nname: bad\ndescription: Fails.\nplugin_version: "1"\nresources: [Base]\n'
FLEET = "version: 1\nplugin_dirs: [plugins]\ndefaults: {timeout_s: 2}\nrobots: {one: {plugins: {bad: {}}}}\n"
SCENARIO = scenario_of("send_cmd: {resource: Base, cmd: hop}", "send_cmd: {resource: Base, cmd: CMD}", name="trouble")


@dataclass
class Outcome:
    """The output of `eal run`."""

    code: int
    out: str
    err: str
    folder: Path

    @property
    def notes(self) -> list[str]:
        file = self.folder / "plugins" / "bad" / "notes.txt"
        return file.read_text().split("\n")[:-1] if file.exists() else []

    def summary(self) -> dict[str, object]:
        (file,) = self.folder.glob("runs/*/summary.json")
        loaded: dict[str, object] = json.loads(file.read_text())
        return loaded


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    plugin = tmp_path / "plugins" / "bad"
    plugin.mkdir(parents=True)
    (plugin / "plugin.py").write_text(PLUGIN.replace('"CONNECT"', "False"))
    (plugin / "plugin.yaml").write_text(MANIFEST)
    (tmp_path / "fleet.yaml").write_text(FLEET)
    (tmp_path / "scenario.yaml").write_text(SCENARIO.replace("CMD", "hop"))
    return tmp_path


def run(folder: Path) -> Outcome:
    command = [sys.executable, "-m", "eal_actors", "run", "scenario.yaml", "--fleet", "fleet.yaml"]
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(Path(__file__).parents[2]), "NO_COLOR": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=60)
    assert "Traceback" not in done.stderr, done.stderr
    return Outcome(done.returncode, done.stdout, done.stderr, folder)


def test_the_good_case(folder: Path) -> None:
    outcome = run(folder)
    assert outcome.code == 0, outcome.err
    assert outcome.summary()["outcome"] == "done"


@pytest.mark.parametrize(
    ("fleet", "message"),
    [
        (None, r"fleet\.yaml: .*(no such file|does not exist|not found)"),
        ("", r"fleet\.yaml.*empty"),
        ("- one\n- two\n", r"fleet\.yaml:1:1: .*mapping"),
        (FLEET.replace("bad:", "bat:"), r"fleet\.yaml:4:\d+: robots\.one\.plugins\.bat: .*did you mean 'bad'"),
        (
            FLEET.replace("bad: {}", "bad: {speed: 3}"),
            r"fleet\.yaml:4:\d+: robots\.one\.plugins\.bad\.speed: .*settings",
        ),
        (
            "version: 1\ntypes: {a: {type: b}, b: {type: a}}\nrobots: {one: {type: a}}\n",
            r"fleet\.yaml:2:\d+: .*a -> b -> a|b -> a -> b",
        ),
        ("version: 1\ninclude: [fleet.yaml]\nrobots: {}\n", r"fleet\.yaml:2:\d+: .*fleet\.yaml.*fleet\.yaml"),
        (FLEET.replace("timeout_s", "timeout"), r"fleet\.yaml:3:\d+: defaults\.timeout: .*did you mean 'timeout_s'"),
    ],
    ids=[
        "missing",
        "empty",
        "a list",
        "unknown plugin",
        "unwanted setting",
        "type loop",
        "include loop",
        "unknown key",
    ],
)
def test_a_bad_fleet_file(folder: Path, fleet: str | None, message: str) -> None:
    if fleet is None:
        (folder / "fleet.yaml").unlink()
    else:
        (folder / "fleet.yaml").write_text(fleet)
    outcome = run(folder)
    assert outcome.code == 2
    assert re.search(message, outcome.err), outcome.err
    assert outcome.notes == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("send_cmd: {resource: Arm, cmd: hop}", r"scenario\.yaml:9:\d+: .*Arm"),
        ("send_cmd: {resource: Base, cmd: hopp}", r"scenario\.yaml:9:\d+: .*did you mean 'hop'"),
        ("get_value: {resource: Base}", r"scenario\.yaml:9:\d+: .*get_value"),
        ("send_cmd: {resource: Base, command: hop}", r"scenario\.yaml:9:\d+: .*unknown key 'command'"),
    ],
    ids=["resource", "command", "method", "key"],
)
def test_a_bad_scenario_is_found_before_anything_moves(folder: Path, line: str, message: str) -> None:
    text = SCENARIO.replace("send_cmd: {resource: Base, cmd: CMD}", line)
    (folder / "scenario.yaml").write_text(text)
    outcome = run(folder)
    assert outcome.code == 2
    assert re.search(message, outcome.err), outcome.err
    assert "motors on" not in outcome.notes


@pytest.mark.parametrize(
    ("cmd", "message"),
    [
        ("raise", "one/Base: send_cmd 'raise' raised OSError: cable off"),
        ("hang", "one/Base: send_cmd 'hang' had no answer within its 2 s"),
        ("lie", "one/Base: send_cmd 'lie' returned 'fine' where a status int is wanted"),
        ("exit", "one/Base: send_cmd 'exit' raised SystemExit: 7"),
        ("go", "one/Base: send_cmd 'go' had no answer within its 2 s"),
    ],
)
def test_a_resource_that_fails(folder: Path, cmd: str, message: str) -> None:
    (folder / "scenario.yaml").write_text(SCENARIO.replace("CMD", cmd))
    outcome = run(folder)
    assert outcome.code == 1, outcome.err
    summary = outcome.summary()
    assert summary["outcome"] == "failed"
    assert message in json.dumps(summary)
    assert message in outcome.out + outcome.err
    assert "halt" in outcome.notes
    assert outcome.notes.count("motors on") == outcome.notes.count("motors off")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (PLUGIN.replace('"CONNECT"', "True"), "plugin 'bad': connect raised OSError: no bus"),
        ("import nothing_of_that_name\n", "plugin 'bad' fails to import: ModuleNotFoundError"),
        ("import sys; sys.exit(3)\n", "plugin 'bad' fails to import: SystemExit"),
        (
            PLUGIN.replace('"CONNECT"', "False").replace("def create_Base", "def make_Base"),
            "lacks the function create_Base()",
        ),
        (
            PLUGIN.replace('"CONNECT"', "False").replace("return Base()", "return 5"),
            "create_Base returned 5, which is no Resource",
        ),
    ],
    ids=["raises in connect", "does not import", "exits", "lacks a function", "makes no resource"],
)
def test_a_plugin_that_does_not_connect(folder: Path, source: str, message: str) -> None:
    (folder / "plugins" / "bad" / "plugin.py").write_text(source)
    outcome = run(folder)
    assert outcome.code == 3, outcome.err
    assert message in outcome.err


def test_every_problem_of_both_files_is_told_at_once(folder: Path) -> None:
    (folder / "fleet.yaml").write_text(FLEET.replace("timeout_s", "timeout").replace("version: 1", "version: 2"))
    (folder / "scenario.yaml").write_text(SCENARIO.replace("roles:", "rolls:"))
    outcome = run(folder)
    assert outcome.code == 2
    assert len(re.findall(r"^(?:fleet|scenario)\.yaml:\d+:\d+: ", outcome.err, re.MULTILINE)) >= 3, outcome.err
