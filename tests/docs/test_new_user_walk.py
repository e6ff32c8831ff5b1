"""The walk of a new user: every command and program of README and tutorials, in empty folders, with only the wheel.

`python -m pytest -rP -m slow tests/docs/test_new_user_walk.py` prints what the user types and reads.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.test_documentation import BLOCK, ROOT
from tests.docs.test_tutorials import TUTORIALS, do, emulated_create
from tests.house.test_packaging import Installed
from tests.house.test_packaging import built as built
from tests.house.test_packaging import installed as installed

pytestmark = [pytest.mark.docs, pytest.mark.slow, pytest.mark.timeout(900)]

README = [(kind, text) for kind, text in BLOCK.findall((ROOT / "README.md").read_text()) if kind in ("sh", "python")]
OF_A_CHECKOUT = ("make ", "pip install")


def variables(installed: Installed) -> dict[str, str]:
    """Return an environment that finds the wheel's programs and not those of the checkout."""
    checkout = str(Path(sys.executable).parent)
    path = ":".join(part for part in os.environ["PATH"].split(":") if part != checkout)
    return {**installed.environment(), "PATH": f"{installed.bin}:{path}", "PYTHONPATH": ""}


@pytest.mark.parametrize("text", [text for kind, text in README if kind == "sh"], ids=lambda text: text[:24])
def test_the_commands_of_the_readme(text: str, installed: Installed, tmp_path: Path) -> None:
    typed = [line.partition("#")[0].strip() for line in text.splitlines()]
    script = "\n".join(["set -eux", *(line for line in typed if not line.startswith(OF_A_CHECKOUT))])
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=variables(installed), capture_output=True, text=True, timeout=600
    )
    sys.stdout.write(done.stderr + done.stdout)
    assert done.returncode == 0


@pytest.mark.parametrize("text", [text for kind, text in README if kind == "python"], ids=lambda text: text[:24])
def test_the_programs_of_the_readme(text: str, installed: Installed, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(text)
    done = subprocess.run(
        ["python", "program.py"], cwd=tmp_path, env=variables(installed), capture_output=True, text=True, timeout=600
    )
    sys.stdout.write(text + done.stdout + done.stderr)
    assert done.returncode == 0


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial(page: Path, installed: Installed, tmp_path: Path) -> None:
    with emulated_create() as port:
        sys.stdout.write(do(page, tmp_path, slow=False, **variables(installed), ROOMBA_PORT=port))
