"""`evbotos claim`: give a machine without a fleet its identity over the network, with the claim code on its console."""

from __future__ import annotations

import hashlib
import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final

import typer
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.identity import read_identity
from evbotos.options import JsonOption
from evbotos.terminal import console, write_json

_CODE: Final = re.compile(r"[A-Z2-7]{16}")
_SALT: Final = b"evbotos claim code 1"
_COST: Final = 1 << 14
_ALIAS: Final = "claimed"
_CONNECT_S: Final = 15
_TIMEOUT_S: Final = 180.0
_TAKEN: Final = "from now on"


def claim(
    host: Annotated[str, typer.Argument(metavar="HOST", help="The address on the machine's console.")],
    identity: Annotated[Path, typer.Argument(metavar="IDENTITY", help="A file of `evbotos provision`.")],
    code: Annotated[str, typer.Option("--code", help="The claim code on the machine's console.")],
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="The machine's SSH port.")] = 22,
    as_json: JsonOption = False,
) -> None:
    """Give a machine without a fleet its identity over the network.

    The code proves each side to the other; nobody between them learns the identity's keys.
    """
    robot = claim_machine(host, port, code, identity)
    if as_json:
        write_json({"host": host, "robot": robot})
        return
    console().print(f"{host} is {robot} from now on; it restarts", soft_wrap=True)


def claim_machine(host: str, port: int, code: str, identity: Path) -> str:
    """Give a machine its identity, and return the robot's name.

    Raises:
        BuildError: the code is invalid or not the machine's, or the machine does not answer or refuses the identity.
    """
    robot = read_identity(identity)["name"].decode().strip()
    machine, owner = keys_of(code)
    with TemporaryDirectory(prefix="evbotos-claim-") as work:
        key, known = Path(work) / "key", Path(work) / "known_hosts"
        key.touch(0o600)
        key.write_bytes(owner.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption()))
        public = machine.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH)
        known.write_text(f"{_ALIAS} {public.decode()}\n")
        options = {
            "HostKeyAlias": _ALIAS,
            "UserKnownHostsFile": known,
            "StrictHostKeyChecking": "yes",
            "IdentitiesOnly": "yes",
            "IdentityAgent": "none",
            "BatchMode": "yes",
            "ConnectTimeout": _CONNECT_S,
            "ServerAliveInterval": _CONNECT_S,
        }
        words = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
        argv = [tool("ssh"), "-F", "none", *words, "-i", key, "-p", str(port), "-l", "root", "--", host, "claim"]
        try:
            done = subprocess.run(  # noqa: S603
                [str(word) for word in argv],
                input=identity.read_bytes(),
                capture_output=True,
                timeout=_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise BuildError(f"{host} has not answered for {_TIMEOUT_S:g} s; look at its console") from None
    said, error = done.stdout.decode(errors="replace").strip(), done.stderr.decode(errors="replace").strip()
    if _TAKEN in said:
        return robot
    if "Host key verification failed" in error or "Permission denied" in error:
        raise BuildError(f"{host} has another claim code: it is mistyped or of an earlier start, or of another machine")
    reason = said or error.rpartition("\n")[2] or "no answer"
    raise BuildError(f"{host} has not taken the identity: {reason}")


def keys_of(code: str) -> tuple[Ed25519PrivateKey, Ed25519PrivateKey]:
    """Return the private keys of a code: the machine's host key, and the owner's key.

    Raises:
        BuildError: it is not a claim code.
    """
    letters = code.upper().replace("-", "").replace(" ", "")
    if not _CODE.fullmatch(letters):
        raise BuildError(f"{code!r} is not a claim code such as ABCD-EFGH-IJKL-MN23, on the console of the machine")
    both = hashlib.scrypt(letters.encode(), salt=_SALT, n=_COST, r=8, p=1, dklen=64)
    return Ed25519PrivateKey.from_private_bytes(both[:32]), Ed25519PrivateKey.from_private_bytes(both[32:])
