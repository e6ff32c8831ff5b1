"""No output, log, record or page contains private keys, tokens or passwords."""

from __future__ import annotations

import base64
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest
import yaml
from websockets.sync.client import connect
from websockets.typing import Origin

from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.recording.provenance import resolved_fleet
from tests.net.links import free_port
from tests.plugin_files import write_plugin

PROGRAM = (sys.executable, "-m", "eal_actors", "--log-level", "debug", "--log-format", "json")
PASSWORD = "Xyzzy-plugh-42"  # noqa: S105  # it must not be found
PLUGIN = """\
from eal_actors.plugin import EALPlugin, PluginSettingsModel, Resource, ResourceType, command


class Settings(PluginSettingsModel):
    password: str
    url: str


class Slide(Resource):
    types = ResourceType.SENSOR | ResourceType.ACTUATOR

    def __init__(self, settings):
        self._settings = settings

    def get_value(self):
        return len(self._settings.password)

    @command("fail")
    def fail(self):
        raise RuntimeError("it is stuck")

    def halt(self):
        pass


def connect(context):
    return EALPlugin("Slide")


def create_Slide(context):
    return Slide(context.settings)
"""
NOTHING: Mapping[str, str] = {}
SCENARIO = """\
version: 1
name: look
roles: {all: {}}
steps:
  - on: all
    do:
      - get_value: {resource: SampleResource}
        save: value.csv
      - get_value: {resource: Slide}
"""


class Words:
    """Secrets in every encoding in which they could leak."""

    def __init__(self, *secrets: str) -> None:
        self._forms = {form for secret in secrets for form in _forms(secret)}

    def found_in(self, texts: Iterable[tuple[str, bytes]]) -> list[str]:
        return [f"{form!r} in {where}" for where, text in texts for form in self._forms if form in text]


def _forms(secret: str) -> Iterator[bytes]:
    raw = secret.encode()
    yield raw
    yield base64.b64encode(raw).rstrip(b"=")
    yield raw.hex().encode()
    yield secret.replace("-", "%2D").encode() if "-" in secret else raw


def private_words(keys: Path) -> list[str]:
    """Return each line of the private keys that no other file has."""
    lines = [line for file in keys.glob("*.key") for line in file.read_text().splitlines()]
    return [line for line in lines if not line.startswith("-----")]


def files_of(*folders: Path) -> Iterator[tuple[str, bytes]]:
    for folder in folders:
        for file in folder.rglob("*"):
            if file.is_file():
                yield str(file), file.read_bytes()


def environment(more: Mapping[str, str]) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(bundled_path(".")), "NO_COLOR": "1", **more}


@contextmanager
def running(
    folder: Path, name: str, *arguments: str, until: str, variables: Mapping[str, str] = NOTHING
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the program while the block lasts; its outputs go to `<name>.out` and `.err`. Yields the line waited for."""
    with (folder / f"{name}.err").open("w") as err, (folder / f"{name}.out").open("w") as out:
        process = subprocess.Popen(
            [*PROGRAM, *arguments],
            cwd=folder,
            env=environment(variables),
            stdout=subprocess.PIPE,
            stderr=err,
            text=True,
        )
        assert process.stdout is not None
        try:
            yield process, _line_with(until, process.stdout, out)
        finally:
            process.terminate()
            rest, _ = process.communicate(timeout=60)
            out.write(rest)


def _line_with(text: str, stream: IO[str], out: IO[str]) -> str:
    for line in stream:
        out.write(line)
        if text in line:
            return line
    raise AssertionError(f"it ended without {text!r}")


def call(folder: Path, name: str, *arguments: str, variables: Mapping[str, str] = NOTHING, code: int = 0) -> None:
    """Run the program to its end; its outputs go to `<name>.out` and `.err`."""
    done = subprocess.run(
        [*PROGRAM, *arguments], cwd=folder, env=environment(variables), capture_output=True, timeout=120
    )
    (folder / f"{name}.out").write_bytes(done.stdout)
    (folder / f"{name}.err").write_bytes(done.stderr)
    assert done.returncode == code, done.stderr.decode()


def secured_fleet(folder: Path) -> Path:
    """Write a fleet with TLS and keys, and a plugin that is given a password by the environment."""
    make_authority(folder / "keys", "f")
    make_certificate(folder / "keys", "r1", ["127.0.0.1"])
    make_certificate(folder / "keys", "controller")
    write_plugin(folder, "slide", PLUGIN, "Slide")
    content = {
        "version": 1,
        "name": "f",
        "plugin_dirs": ["plugins"],
        "network": {"security": {"keys": "keys", "roles": {"controllers": ["controller"]}}},
        "robots": {
            "r1": {
                "address": f"tls/127.0.0.1:{free_port()}",
                "plugins": {
                    "sample": {},
                    "slide": {
                        "password": "${SLIDE_PASSWORD}",
                        "url": "http://me:${SLIDE_PASSWORD}@slide/?k=${SLIDE_PASSWORD}",
                    },
                },
            }
        },
    }
    file = folder / "f.yaml"
    file.write_text(yaml.safe_dump(content))
    (folder / "look.yaml").write_text(SCENARIO)
    return file


def test_a_run_over_tls_tells_no_key_and_no_password(tmp_path: Path) -> None:
    """At the loudest level, with everything recorded, with a report, and with commands that fail."""
    folder = tmp_path / "lab"
    folder.mkdir()
    secured_fleet(folder)
    given = {"SLIDE_PASSWORD": PASSWORD}
    with running(folder, "serve", "serve", "--fleet", "f.yaml", "--robot", "r1", until="listening", variables=given):
        call(
            folder,
            "run",
            "run",
            "look.yaml",
            "--fleet",
            "f.yaml",
            "--record",
            "all",
            "--events",
            "events",
            variables=given,
        )
        call(folder, "doctor", "doctor", "--fleet", "f.yaml", variables=given)
        call(folder, "call", "call", "r1", "Slide", "send_cmd", "fail", "--fleet", "f.yaml", code=1, variables=given)
    (kept,) = (folder / "runs").iterdir()
    call(folder, "report", "report", str(kept))
    outputs = [*files_of(folder / "runs"), *((str(file), file.read_bytes()) for file in folder.glob("*.*"))]

    keys = private_words(folder / "keys")
    assert len(keys) >= 6
    assert {"serve.err", "run.out", "events.jsonl", "run.mcap", "fleet.yaml", "report.html"} <= {
        Path(name).name for name, _ in outputs
    }
    assert Words(*keys, PASSWORD).found_in(outputs) == []
    assert "listening" in (folder / "serve.out").read_text()  # it did say something


def test_the_dashboards_token_is_told_to_who_started_it_and_to_nobody_else(tmp_path: Path) -> None:
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "look.yaml").write_text(SCENARIO.replace("      - get_value: {resource: Slide}\n", ""))
    options = ("--fleet", "local", "--port", "0", "--token")
    heard: list[str] = []
    with running(tmp_path, "dashboard", "dashboard", *options, until="#token=") as (_, link):
        found = re.search(r"(http://([\d.:]+))/?#token=(\S+)", link)
        assert found is not None
        url, place, token = found.groups()
        for shown in ("wrong", token):
            with connect(f"ws://{place}/ws", origin=Origin(url), proxy=None) as page:
                page.send(json.dumps({"do": "hello", "token": shown}))
                heard += _until(page, "now_s" if shown == token else "wrong token")
                if shown == token:
                    start = {"do": "start", "id": 1, "file": "look.yaml", "parameters": {}}
                    page.send(json.dumps({**start, "heard_s": json.loads(heard[-1])["hello"]["now_s"]}))
                    heard += _until(page, "ended")
    outputs = [*files_of(tmp_path / "runs"), ("stderr", (tmp_path / "dashboard.err").read_bytes())]
    outputs.append(("what the pages heard", "\n".join(heard).encode()))

    assert Words(token).found_in(outputs) == []
    assert (tmp_path / "dashboard.out").read_text().count(token) == 1


def _until(page: Any, text: str) -> list[str]:
    heard: list[str] = []
    while not heard or text not in heard[-1]:
        message = page.recv(30.0)
        heard.append(message if isinstance(message, str) else "")
    return heard


@pytest.mark.parametrize(
    ("settings", "kept"),
    [
        ({"password": PASSWORD}, {"password": "***"}),
        ({"api_token": PASSWORD, "user": "me"}, {"api_token": "***", "user": "me"}),
        ({"source": f"rtsp://me:{PASSWORD}@cam/1"}, {"source": "rtsp://me:***@cam/1"}),
        ({"source": f"rtsp://:{PASSWORD}@cam/1"}, {"source": "rtsp://:***@cam/1"}),
        ({"source": f"http://cam/live?user=me&pwd={PASSWORD}"}, {"source": "http://cam/live?***"}),
        ({"deep": {"list": [{"client_secret": PASSWORD}]}}, {"deep": {"list": [{"client_secret": "***"}]}}),
        ({"token": [PASSWORD, None], "secret": {"user": "me"}}, {"token": ["***", None], "secret": {"user": "me"}}),
        ({"speed_m_s": 0.2, "tokens": 3}, {"speed_m_s": 0.2, "tokens": 3}),
    ],
)
def test_the_fleet_that_is_kept_with_a_run_is_kept_without_secrets(
    settings: Mapping[str, Any], kept: Mapping[str, Any]
) -> None:
    config = EALConfigManager.of({"version": 1, "robots": {"r": {"plugins": {"one": settings}}}}).fleet

    assert resolved_fleet(config)["robots"]["r"]["plugins"]["one"] == kept
