"""The proof of every board that a refused update never starts."""

from __future__ import annotations

import random
from pathlib import Path

from evbotos.qemu import Machine
from tests.evbotos.proof import SERVES, Proof, answer, said, ssh, started, wait_for_words, wait_until
from tests.evbotos.proofs import restart, status, update_of, wait_for_good


def damaged(good: bytes, generator: random.Random) -> bytes:
    """Return an update with a genuine manifest and a changed kernel or root, or one that ends too early."""
    start = good.index(b"ustar", 2000)  # past the manifest, its signature and their headers
    place = generator.randrange(start + 2048, len(good) - 8192)
    if generator.random() < 0.3:
        return good[:place]
    return good[:place] + bytes([good[place] ^ 1 << generator.randrange(8)]) + good[place + 1 :]


def refuse(proof: Proof, machine: Machine, update: bytes) -> None:
    refused = ssh(proof, machine, "evbotos-update install -", update)
    assert refused.returncode == 1, refused.stdout
    assert "refused" in refused.stderr


def cut_starts(proof: Proof, disk: Path, times: int) -> str:
    """Start and cut the power before the system reports success; return what the consoles said."""
    consoles = ""
    for _ in range(times):
        with started(proof, disk) as machine:
            wait_until(machine, "a start", lambda: "is up" in said(machine) or "panic" in said(machine))
            machine.kill()
            consoles += said(machine)
    return consoles


def prove_refusal(proof: Proof, disk: Path, folder: Path, seed: int) -> None:
    """A refused update never starts: after a good one without a restart, or alone with the power cut at each start."""
    generator = random.Random(seed)  # noqa: S311  # places of damage
    good = update_of(proof, folder).read_bytes()
    after_a_good_one = seed % 2 == 0
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        if after_a_good_one:
            answer(proof, machine, "evbotos-update install -", good)
            assert status(proof, machine).endswith("to be tried b")
        refuse(proof, machine, damaged(good, generator))
        if after_a_good_one:
            restart(proof, machine)
            wait_until(machine, "a second start", lambda: said(machine).count("is up") == 2)
            assert "evbotos: slot b" not in said(machine), f"seed {seed}"
            wait_for_good(proof, machine, "a")
            return
        answer(proof, machine, "sync")
        machine.kill()
    assert "evbotos: slot b" not in cut_starts(proof, disk, 4), f"seed {seed}"
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        assert "evbotos: slot b" not in said(machine), f"seed {seed}"
        wait_for_good(proof, machine, "a")
