"""Debian packages of any architecture, resolved and downloaded by apt with its own state; nothing is installed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from evbotos.apt_sources import Source, sources_for
from evbotos.errors import BuildError, DiskFullError
from evbotos.hashing import file_sha256
from evbotos.lock import LockedPackage
from evbotos.model import Platform
from evbotos.shell import run

_HELPER: Final = "/usr/lib/apt/apt-helper"
_URI: Final = re.compile(r"^'(?P<uri>[^']+)' (?P<file>\S+) (?P<size>\d+) SHA256:(?P<sha256>[0-9a-f]{64})$")


class Apt:
    """Apt for one suite and architecture.

    Args:
        folder: the folder of its state.
        architecture: Debian's name of the architecture.
        sources: the package sources.
        warn: receives warnings.
        backports: source packages whose versions are those of the suite's backports.
    """

    def __init__(
        self,
        folder: Path,
        architecture: str,
        sources: list[Source],
        warn: Callable[[str], None],
        backports: Iterable[str] = (),
    ) -> None:
        self._folder = folder
        self._architecture = architecture
        self._sources = sources
        self._warn = warn
        self._pins = [f"Package: src:{name}\nPin: release n=*-backports\nPin-Priority: 990\n" for name in backports]

    def update(self) -> None:
        """Fetch the indexes; continue with a warning if the security archive is unreachable.

        Raises:
            BuildError: the suite is unreachable.
        """
        try:
            self._write_config(self._sources)
            self._apt("update", "-qq", "-o", "APT::Update::Error-Mode=any")
        except BuildError as error:
            rest = [source for source in self._sources if source.archive != "security"]
            if rest == self._sources:
                raise
            self._warn(f"the security archive is unreachable, so the build continues without it: {_reason(error)}")
            self._sources = rest
            self._write_config(rest)
            self._apt("update", "-qq", "-o", "APT::Update::Error-Mode=any")

    def resolve(self, names: Iterable[str]) -> list[LockedPackage]:
        """Return packages with all dependencies, sorted by name. Call `update` first.

        Raises:
            BuildError: a package does not exist, or dependencies conflict.
        """
        said = self._apt("install", "-qq", "-y", "--print-uris", *names)
        return sorted((self._package(line) for line in said.splitlines() if line), key=lambda package: package.name)

    def fetch(self, packages: Iterable[LockedPackage], folder: Path) -> list[Path]:
        """Return the files of packages from a cache keyed by hash; download missing ones.

        Raises:
            BuildError: a file is no longer offered, or does not match the lock.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._write_config(self._sources)
        files = []
        for package in packages:
            file = folder / f"{package.sha256}.deb"
            if not file.is_file() or file_sha256(file) != package.sha256:
                self._download(package, file)
            files.append(file)
        return files

    def _download(self, package: LockedPackage, file: Path) -> None:
        part = file.with_suffix(".part")
        homes = dict.fromkeys(source.uri for source in self._sources if source.archive == package.archive)
        reasons = []
        for home in homes:
            part.unlink(missing_ok=True)
            try:
                run([_HELPER, "download-file", f"{home}/{package.path}", part], env=self._env, timeout_s=900)
            except DiskFullError:
                part.unlink(missing_ok=True)
                raise
            except BuildError as error:
                reasons.append(_reason(error))
                continue
            if file_sha256(part) != package.sha256:
                reasons.append("its content is another")
                continue
            part.replace(file)
            return
        part.unlink(missing_ok=True)
        raise BuildError(
            f"{package.name} {package.version}, as locked, is unavailable: "
            f"{'; '.join(reasons) or f'no source of the {package.archive} archive'}; "
            "if the archive has newer versions, run `evbotos build --update-lock`"
        )

    @property
    def _env(self) -> dict[str, str]:
        return {"APT_CONFIG": str(self._folder / "apt.conf")}

    def _apt(self, *arguments: str) -> str:
        return run(["apt-get", *arguments], env=self._env, timeout_s=600)

    def _write_config(self, sources: list[Source]) -> None:
        folder = self._folder
        for part in ("state/lists/partial", "cache/archives/partial", "preferences.d"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        (folder / "status").touch()
        (folder / "sources.list").write_text("".join(f"{source.line()}\n" for source in sources))
        (folder / "preferences.d/backports").write_text("\n".join(self._pins))
        settings = {
            "APT::Architecture": self._architecture,
            "Dir::State": folder / "state",
            "Dir::State::status": folder / "status",
            "Dir::Cache": folder / "cache",
            "Dir::Etc::sourcelist": folder / "sources.list",
            "Dir::Etc::sourceparts": "/dev/null",
            "Dir::Etc::PreferencesParts": folder / "preferences.d",
            "APT::Install-Recommends": "false",
            "APT::Sandbox::User": "root",
            "Acquire::Languages": "none",
            "Acquire::ForceHash": "SHA256",
            "Acquire::Retries": "2",
            "Debug::NoLocking": "true",
        }
        lines = [f'{key} "{value}";' for key, value in settings.items()]
        (folder / "apt.conf").write_text("\n".join([f'APT::Architectures {{ "{self._architecture}"; }};', *lines, ""]))

    def _package(self, line: str) -> LockedPackage:
        match = _URI.match(line)
        if match is None:
            raise BuildError(f"apt-get printed an invalid line: {line!r}")
        uri = match["uri"]
        name, version, _ = match["file"].removesuffix(".deb").split("_")
        for source in self._sources:
            if uri.startswith(f"{source.uri}/"):
                return LockedPackage(
                    name=name,
                    version=version.replace("%3a", ":"),
                    archive=source.archive,
                    path=uri.removeprefix(f"{source.uri}/"),
                    size=int(match["size"]),
                    sha256=match["sha256"],
                )
        raise BuildError(f"{name} comes from none of the known sources")


def apt_for(platform: Platform, architecture: str, mirror: str | None, cache: Path, warn: Callable[[str], None]) -> Apt:
    """Return the apt instance of a platform's suite, for an architecture.

    Args:
        platform: the board.
        architecture: the board's, or that of a build machine.
        mirror: the user's mirror, or None.
        cache: the folder of the cache.
        warn: receives warnings.

    Raises:
        BuildError: the build machine has no source of Debian.
    """
    backports = platform.backports
    sources = sources_for(platform.suite, mirror, components=platform.components, has_backports=bool(backports))
    folder = cache / "apt" / f"{platform.suite}-{architecture}"
    return Apt(folder, architecture, sources, warn, backports)


def _reason(error: BuildError) -> str:
    """Return the first error line of apt's output."""
    lines = error.message.splitlines()
    return next((line for line in lines if line.startswith(("E:", "Err"))), lines[-1])
