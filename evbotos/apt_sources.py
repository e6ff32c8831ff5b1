"""Sources of Debian packages: the build machine's apt configuration, or the user's mirror."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.lock import Archive

APT: Final = Path("/etc/apt")
_KEYRING: Final = "/usr/share/keyrings/debian-archive-keyring.gpg"
_RELEASES: Final = ("trixie", "bookworm")
"""Of build machines."""


@dataclass(frozen=True, slots=True)
class Source:
    """One archive of a suite.

    Attributes:
        uri: its address without a trailing slash.
        suite: such as `bookworm-security`.
        components: such as `main`.
        signed_by: the keyring that verifies its index.
    """

    uri: str
    suite: str
    components: tuple[str, ...]
    signed_by: str

    @property
    def archive(self) -> Archive:
        """The kind of archive within its suite."""
        _, _, kind = self.suite.partition("-")
        return "security" if kind == "security" else "updates" if kind == "updates" else "main"

    def line(self) -> str:
        """Return its line of a sources.list."""
        return f"deb [signed-by={self.signed_by}] {self.uri} {self.suite} {' '.join(self.components)}"


def sources_for(
    suite: str,
    mirror: str | None,
    folder: Path = APT,
    *,
    components: tuple[str, ...] = (),
    has_backports: bool = False,
) -> list[Source]:
    """Return the sources of a suite's packages.

    Args:
        suite: a Debian suite such as `bookworm`.
        mirror: the user's mirror; if given, the only archive.
        folder: apt's configuration.
        components: archive components in addition to those of the build machine.
        has_backports: whether the suite's backports are a source.

    Raises:
        BuildError: the build machine has no source of Debian.
    """
    found = [Source(mirror.rstrip("/"), suite, ("main",), _KEYRING)] if mirror is not None else _debian(folder, suite)
    more = [replace(one, components=tuple(dict.fromkeys((*one.components, *components)))) for one in found]
    if has_backports:
        more += [replace(one, suite=f"{suite}-backports") for one in more if one.suite == suite]
    return list(dict.fromkeys(more))


def _debian(folder: Path, suite: str) -> list[Source]:
    """Return the configured sources of a suite; those of another one have its packages in the same archives."""
    configured = [source for source in _configured(folder) if "main" in source.components]
    for release in (suite, *_RELEASES):
        wanted = {f"{release}{kind}": f"{suite}{kind}" for kind in ("", "-updates", "-security")}
        found = [replace(source, suite=wanted[source.suite]) for source in configured if source.suite in wanted]
        if any(source.suite == suite for source in found):
            return found
    raise BuildError("apt on this machine has no source of Debian; name one as `mirror` in local.yaml")


def _configured(folder: Path) -> Iterator[Source]:
    files = [folder / "sources.list", *sorted((folder / "sources.list.d").glob("*"))]
    for file in files:
        if not file.is_file():
            continue
        text = file.read_text()
        if file.suffix == ".sources":
            for paragraph in text.split("\n\n"):
                yield from _deb822(paragraph.splitlines())
        elif file.suffix == ".list":
            for line in text.splitlines():
                yield from _one_line(line)


def _deb822(lines: Iterable[str]) -> Iterator[Source]:
    fields: dict[str, str] = {}
    for line in lines:
        key, separator, value = line.partition(":")
        if separator and not line.startswith(("#", " ")):
            fields[key.strip().lower()] = value.strip()
    if "deb" not in fields.get("types", "").split() or fields.get("enabled", "yes") == "no":
        return
    for uri in fields.get("uris", "").split():
        for suite in fields.get("suites", "").split():
            components = tuple(fields.get("components", "").split())
            yield Source(uri.rstrip("/"), suite, components, fields.get("signed-by", _KEYRING))


def _one_line(line: str) -> Iterator[Source]:
    words = line.split("#", 1)[0].split()
    if words[:1] != ["deb"]:
        return
    options, rest = "", words[1:]
    if rest and rest[0].startswith("["):
        end = next(index for index, word in enumerate(rest) if word.endswith("]"))
        options, rest = " ".join(rest[: end + 1]).strip("[]"), rest[end + 1 :]
    keys = dict(option.split("=", 1) for option in options.split() if "=" in option)
    if len(rest) >= 2:
        yield Source(rest[0].rstrip("/"), rest[1], tuple(rest[2:]), keys.get("signed-by", _KEYRING))
