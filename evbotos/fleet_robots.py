"""The robots of a fleet for an update, over the fleet's own network, by the resource `Update` of the plugin evbotos."""

from __future__ import annotations

import json
import subprocess
import sys
import tarfile
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eal_actors import Fleet, ResourceHandle
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, ResourceNotFoundError, StaleCommandError, UnavailableError
from eal_actors.kernel.yaml_source import load_yaml
from evbotos.delta import messages, missing_pieces
from evbotos.errors import UpdateError
from evbotos.fleet_update import LOOK_S, Standing, Update

RESOURCE: Final = "Update"
_LONG_S: Final = 900.0
"""Deadline of what reads a whole slot."""
_STATUS_S: Final = 60.0
"""Deadline of a status, which may have to start the program behind the robot's process."""
_CONNECT_S: Final = 60.0
"""Longest wait for robots that do not answer at once: a slow one takes longer than `Fleet.connect` waits."""
_MESSAGE_BYTES: Final = 512 << 10
_TRIES: Final = 5
_UNREACHABLE: Final = 3
"""The exit code of `eal run` whose robot does not answer."""
_SHOWN_LINES: Final = 12


def read_update(path: Path) -> Update:
    """Read a file of `evbotos slot`.

    Raises:
        UpdateError: it is not one.
    """
    try:
        with tarfile.open(path) as archive:
            files = {member.name: archive.extractfile(member) for member in archive}
            content = {name: file.read() for name, file in files.items() if file is not None}
        manifest = json.loads(content["manifest.json"])
        parts = {part: content[part] for part in ("kernel", "root")}
        return Update(
            content["manifest.json"],
            content["manifest.sig"],
            manifest["platform"],
            manifest["release"],
            manifest["verity"]["verity"],
            parts,
        )
    except (OSError, tarfile.TarError, KeyError, ValueError) as error:
        raise UpdateError(f"{path} is not an update of `evbotos slot`: {error}") from None


@dataclass(frozen=True)
class FleetRobots:
    """A connected fleet.

    Attributes:
        file: its fleet file.
        check: the scenario that an updated robot must pass; None for none.
        say: reports a robot's step.
    """

    fleet: Fleet
    file: Path
    check: Path | None
    say: Callable[[str, str], None]

    def wait_for(self, names: Iterable[str]) -> None:
        """Wait until each robot answers, for a minute at most: a robot that is skipped costs another run."""
        end_s = REAL_TIME.now() + _CONNECT_S
        late = set(names)
        while (late := {robot for robot in late if not self._answers(robot)}) and REAL_TIME.now() < end_s:
            REAL_TIME.sleep(LOOK_S)

    def _answers(self, robot: str) -> bool:
        try:
            self.fleet[robot].ping().get()
        except EALError:
            return False
        return True

    def standing(self, robot: str) -> Standing | None:
        """Return what a robot says; None if it does not answer."""
        try:
            fields = self._status(robot)
        except EALError:
            return None
        return Standing(**fields) if fields else None

    def unsuited(self, robot: str) -> str | None:
        """Return why a robot that answers takes no updates; None if it is absent."""
        try:
            self.fleet[robot].ping().get()
            return None if self._status(robot) else "it does not run EvBotOS with two slots"
        except ResourceNotFoundError:
            return "its fleet file has no plugin evbotos"
        except EALError:
            return None

    def used_by(self, robot: str) -> str | None:
        """Return the controller that uses a robot now; None if nobody does."""
        answer = self.fleet[robot].ping().get()
        others = answer.holders.keys() - answer.holder_ids.keys()
        return next((answer.holders[resource] for resource in sorted(others)), None)

    def push(self, robot: str, update: Update) -> None:
        """Write an update into a robot's other slot; a short loss of the network, or a slow one, only delays it.

        Raises:
            EALError: the robot refuses it, or went away.
        """
        for tries_left in reversed(range(_TRIES)):
            try:
                self._push(robot, update)
            except (UnavailableError, StaleCommandError):
                if not tries_left or self.standing(robot) is None:
                    raise
            else:
                return

    def _push(self, robot: str, update: Update) -> None:
        handle = self._update_of(robot)
        handle.send_cmd("begin", update.signature + update.signed, timeout_s=_LONG_S).get()
        total, done, sent = sum(map(len, update.parts.values())), 0, 0
        for part, new in update.parts.items():
            present, running = (
                bytes(handle.send_req(f"{slot}_{part}", timeout_s=_LONG_S).get().payload)
                for slot in ("other", "running")
            )
            pieces = missing_pieces(new, present, running)
            done += len(new) - sum(piece.length for piece in pieces)
            for message, written in messages(part, new, pieces, _MESSAGE_BYTES):
                _write(handle, message)
                done, sent = done + written, sent + len(message)
                self.tell(robot, f"receives {update.release}: {done / total:.0%}")
        handle.send_cmd("finish", timeout_s=_LONG_S).get()
        self.tell(robot, f"has received {update.release}: {sent / 1e6:.1f} of {total / 1e6:.1f} MB were sent")

    def restart(self, robot: str) -> None:
        """Restart a robot that has a system to try; it may go down before its answer has left."""
        with suppress(UnavailableError):
            self._update_of(robot).send_cmd("restart").get()

    def fall_back(self, robot: str) -> None:
        """Let the next start of a robot try its former system."""
        self._update_of(robot).send_cmd("fall_back").get()

    def problem_of(self, robot: str) -> str | None:
        """Return why an updated robot is not healthy: a resource that is not ready, or the scenario; None if it is."""
        try:
            not_ready = self.fleet[robot].ping().get().not_ready
        except EALError as error:
            return str(error)
        if not_ready:
            return "; ".join(f"{resource}: {why}" for resource, why in not_ready.items())
        return None if self.check is None else self._scenario_problem(robot, self.check)

    def tell(self, robot: str, words: str) -> None:
        """Report a step to the user, and on the robot itself, where dashboards show it."""
        self.say(robot, words)
        handle = self.fleet[robot]
        if RESOURCE in handle:
            handle[RESOURCE].send_cmd("stage", words)

    def _scenario_problem(self, robot: str, scenario: Path) -> str | None:
        """Return why a scenario fails; a robot that is not reached at once, in its first minute, is tried again."""
        self.fleet[robot].release()
        binds = [word for role in load_yaml(scenario).root["roles"] for word in ("--bind", f"{role}={robot}")]
        words = [sys.executable, "-P", "-m", "eal_actors", "run", str(scenario), "--fleet", str(self.file), *binds]
        for _ in range(_TRIES):
            done = subprocess.run(words, capture_output=True, text=True, timeout=_LONG_S, check=False)  # noqa: S603
            if done.returncode == 0:
                return None
            if done.returncode != _UNREACHABLE:
                break
        return "\n".join([f"{scenario.stem} failed with {done.returncode}", *done.stderr.splitlines()[-_SHOWN_LINES:]])

    def _status(self, robot: str) -> dict[str, Any]:
        return dict(json.loads(self._update_of(robot).send_req("status", timeout_s=_STATUS_S).get().value))

    def _update_of(self, robot: str) -> ResourceHandle:
        return self.fleet[robot][RESOURCE]


def _write(handle: ResourceHandle, message: bytes) -> None:
    """Send a part of an update; one that a slow robot received too late was not executed, and is sent again."""
    for tries_left in reversed(range(_TRIES)):
        try:
            handle.write_comm(message, timeout_s=_LONG_S).get()
        except StaleCommandError:
            if not tries_left:
                raise
        else:
            return
