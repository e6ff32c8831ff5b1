"""The proofs of every board that its power may go at any instant."""

from __future__ import annotations

import random
import subprocess
from pathlib import Path

from eal_actors.kernel.clock import REAL_TIME
from tests.evbotos.proof import SERVES, Proof, ssh_words, started, wait_for_words, wait_until
from tests.evbotos.proofs import status, update_of, wait_for_good

CUTS = 12


def prove_cut_starts(proof: Proof, disk: Path, seed: int) -> None:
    """A system starts although the power went early in many starts before."""
    generator = random.Random(seed)  # noqa: S311  # instants
    for number in range(CUTS):
        cut_s = generator.uniform(0.2, 5.0)
        with started(proof, disk) as machine:
            wait_until(machine, f"cut {number} after {cut_s:.2f} s", lambda: machine.computed_s() > cut_s)  # noqa: B023
            machine.kill()
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        wait_for_good(proof, machine, "a")


def prove_cut_update(proof: Proof, disk: Path, folder: Path, seed: int) -> None:
    """A system starts although the power went during an update, or during the restart after it."""
    update = update_of(proof, folder)
    cut_at = 1.3 * random.Random(seed).random()  # noqa: S311  # of its bytes; beyond 1, in its last steps and the restart
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        size = update.stat().st_size
        sender = subprocess.Popen(
            [*ssh_words(proof, machine), "evbotos-update install - && reboot"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        assert sender.stdin is not None
        with sender.stdin as pipe:
            pipe.write(update.read_bytes()[: int(size * min(cut_at, 1.0))])
            pipe.flush()
            if cut_at > 1.0:
                pipe.close()
            REAL_TIME.sleep(max(0.0, cut_at - 1.0) * 30.0)
            machine.kill()
        sender.kill()
        sender.wait(60)
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        assert status(proof, machine).startswith("running ")
