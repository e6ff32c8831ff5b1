"""Real BitBake on the OpenEmbedded layers: parses them and plans every image for every machine, without a network.

Run as `python -m tests.evbotos.bitbake MIRRORS [MACHINE]...`. MIRRORS is a folder of git repositories, bare or not,
named as in `kas/common.yml` (`bitbake`, `openembedded-core`, ...), with or without `.git`. BitBake refuses root, so
root runs it as `nobody`. What it says goes to `build/bitbake/MACHINE.log` while it runs.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import yaml

REPOSITORY: Final = Path(__file__).parents[2]
KAS: Final = REPOSITORY / "evbotos/openembedded/kas"
IMAGES: Final = sorted(path.stem for path in (REPOSITORY / "evbotos/images").glob("*.yaml"))
LOGS: Final = REPOSITORY / "build/bitbake"
_TIMEOUT_S: Final = 7200.0  # for one machine; a free processor takes a quarter of an hour
_PLANNED: Final = re.compile(r"Attempted (\d+) tasks")


def main(words: list[str]) -> int:
    """Run the program, and return its exit code."""
    if not words:
        _say("Not run: name the folder of mirrors, such as `make test-bitbake MIRRORS=/srv/git`")
        return 2
    mirrors = Path(words[0]).resolve()
    missing = [name for name in repositories() if find_mirror(mirrors, name) is None]
    if missing:
        _say(f"Not run: {mirrors} has no git repository {', '.join(missing)}")
        return 2
    machines = words[1:] or sorted(path.stem for path in KAS.glob("*.yml") if path.stem != "common")
    with TemporaryDirectory(prefix="evbotos-bitbake-") as work:
        failed = [machine for machine in machines if not plan(machine, mirrors, Path(work))]
    _say(
        f"{len(machines) - len(failed)} of {len(machines)} machines planned" + "".join(f"; failed: {m}" for m in failed)
    )
    return 1 if failed else 0


def repositories() -> dict[str, str]:
    """Return the addresses of the repositories that the project files name."""
    found: dict[str, str] = {}
    for path in KAS.glob("*.yml"):
        repos = yaml.safe_load(path.read_text()).get("repos", {})
        found |= {name: repo["url"] for name, repo in repos.items() if repo and "url" in repo}
    return found


def find_mirror(mirrors: Path, name: str) -> Path | None:
    """Return a mirror's git directory."""
    places = (mirrors / name, mirrors / f"{name}.git", mirrors / name / ".git", *mirrors.glob(f"*+{name}/repo"))
    return next((place for place in places if (place / "HEAD").is_file()), None)


def plan(machine: str, mirrors: Path, work: Path) -> bool:
    """Plan all images for a machine, print errors and the number of tasks, and return whether it succeeded."""
    settings = work / "gitconfig"
    settings.write_text("[safe]\n\tdirectory = *\n")  # the mirrors may belong to another user
    mirrored = (f"^{re.escape(url)}$ file://{find_mirror(mirrors, name)}" for name, url in repositories().items())
    env = {**os.environ, "KAS_WORK_DIR": str(work), "HOME": str(work), "LANG": "en_US.UTF-8", "LC_ALL": "en_US.UTF-8"}
    env |= {"KAS_PREMIRRORS": "\n".join(mirrored), "GITCONFIG_FILE": str(settings), "KAS_CLONE_DEPTH": "1"}
    project = work / "project"
    if not project.is_dir():
        for name in ("evbotos", "plugins"):
            shutil.copytree(REPOSITORY / name, project / name, ignore=shutil.ignore_patterns("__pycache__"))
        # kas looks for includes from a checkout's root, and BitBake hashes what the checkout's index names.
        subprocess.run(["git", "init", "-q", project], check=True)
        subprocess.run(["git", "-C", project, "add", "--all"], check=True)
    argv = [str(Path(sys.executable).with_name("kas")), "shell", f"evbotos/openembedded/kas/{machine}.yml", "-c"]
    images = " ".join(f"evbotos-image-{image}" for image in IMAGES)
    argv.append(f"BB_ENV_PASSTHROUGH_ADDITIONS=BB_NO_NETWORK BB_NO_NETWORK=1 bitbake -n {images}")
    if os.geteuid() == 0:
        subprocess.run(["chown", "-R", "nobody:nogroup", str(work)], check=True)
        argv = ["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", *argv]
    LOGS.mkdir(parents=True, exist_ok=True)
    log = LOGS / f"{machine}.log"
    code = run_logged(argv, project, env, log, _TIMEOUT_S)
    said = log.read_text()
    lines = said.splitlines()
    errors = [number for number, line in enumerate(lines) if line.startswith("ERROR") or "Nothing PROVIDES" in line]
    problems = lines[errors[0] :] if errors else [line for line in lines if line.startswith("WARNING")]
    tasks = _PLANNED.search(said)
    ended = "took too long" if code is None else f"exit code {code}"
    _say(f"{machine}: {ended}, {tasks[1] if tasks else 'no'} tasks ({log})")
    _say("\n".join(problems or ([] if code == 0 else said.splitlines()[-20:])))
    return code == 0 and not errors


def run_logged(argv: list[str], folder: Path, env: dict[str, str], log: Path, timeout_s: float) -> int | None:
    """Run a program whose output goes to a log; return its exit code, or None if it took too long.

    It is interrupted then, and everything that it started with it: what BitBake's server leaves running would report
    failed tasks while its folder is removed.
    """
    with (
        log.open("w") as stream,
        subprocess.Popen(
            argv, cwd=folder, env=env, stdout=stream, stderr=subprocess.STDOUT, start_new_session=True
        ) as program,
    ):
        try:
            return program.wait(timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(program.pid, signal.SIGINT)  # BitBake ends its tasks and its server
            return None


def _say(words: str) -> None:
    sys.stdout.write(f"{words}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
