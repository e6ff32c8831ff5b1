"""Paths of the bundled plugins, fleets, scenarios and worlds, in a checkout and in a wheel."""

from __future__ import annotations

from collections.abc import Container, Iterable
from pathlib import Path
from typing import Final, Literal

from eal_actors.kernel.errors import ConfigError, file_error
from eal_actors.kernel.suggestions import nearest
from eal_actors.kernel.yaml_tree import YamlTree

Kind = Literal["fleet", "scenario", "world"]

_FOLDERS: Final[dict[Kind, str]] = {"fleet": "fleets", "scenario": "scenarios", "world": "fleets/worlds"}
_MAIN_KEYS: Final[dict[Kind, str]] = {"fleet": "robots", "scenario": "steps", "world": "size_m"}
_SUFFIX: Final = ".yaml"
FLEET_VARIABLE: Final = "EAL_FLEET"
"""The environment variable with the default fleet file of `connect`."""

_INSTALLED: Final = Path(__file__).parents[1] / "_bundled"
"""Their folder in a wheel; in a checkout they are beside the package."""


def bundled_path(name: str) -> Path:
    """Return the path of a bundled file or folder, such as `plugins` or `fleets/local.yaml`."""
    return (_INSTALLED if _INSTALLED.is_dir() else _INSTALLED.parents[1]) / name


def is_installed(file: Path) -> bool:
    """Return whether a file was installed with the framework, so that users must not change it."""
    return file.resolve().is_relative_to(_INSTALLED.resolve())


def bundled_names(kind: Kind) -> tuple[str, ...]:
    """Return the names of the bundled files of a kind."""
    return tuple(sorted(file.stem for file in bundled_path(_FOLDERS[kind]).glob(f"*{_SUFFIX}")))


def find_file(name: str | Path, kind: Kind, folder: Path | None = None) -> Path:
    """Return the file of a path or a name.

    A path, which has a folder or a suffix, is returned as it is. A name such as `dance` is the file `dance` or
    `dance.yaml` of the folder, by default the working directory, or else the bundled one. Raises ConfigError if no file
    has that name, in the folder or bundled, or the path does not exist and the framework has a file of that name.
    """
    path = Path(name) if folder is None else folder / name
    if not _is_bare(name):
        _refuse_path_of_bundled(path, bundled_names(kind))
        return path
    if path.is_file():
        return path
    here = path.with_name(f"{path.name}{_SUFFIX}")
    shipped = bundled_path(_FOLDERS[kind]) / here.name
    for file in (here, shipped):
        if file.is_file():
            return file
    raise _unknown(name, kind, bundled_names(kind))


def require_kind(tree: YamlTree, kind: Kind) -> None:
    """Raise ConfigError if a file lacks the main key of its kind and has that of another: files were confused."""
    if _MAIN_KEYS[kind] in tree.root:
        return
    for other, key in _MAIN_KEYS.items():
        if key in tree.root:
            raise ConfigError([tree.problem((key,), f"this is a {other} file; a {kind} file was expected", key=True)])


def find_files(name: str | Path) -> tuple[Path, ...]:
    """Return the files of a path or a name, whatever their kinds: fleets, scenarios and worlds may share a name.

    Raises ConfigError if no file has that name, in the working directory or bundled; see `find_file`.
    """
    path = Path(name)
    if not _is_bare(name):
        _refuse_path_of_bundled(path, {known for kind in _FOLDERS for known in bundled_names(kind)})
        return (path,)
    for here in (path, path.with_name(f"{path.name}{_SUFFIX}")):
        if here.is_file():
            return (here,)
    shipped = (bundled_path(folder) / f"{name}{_SUFFIX}" for folder in _FOLDERS.values())
    if found := tuple(file for file in shipped if file.is_file()):
        return found
    raise _unknown(name, "file", sorted({known for kind in _FOLDERS for known in bundled_names(kind)}))


def _is_bare(name: str | Path) -> bool:
    path = Path(name)
    return bool(path.name) and not path.suffix and len(path.parts) == 1  # `.` and `/` have no name


def _refuse_path_of_bundled(path: Path, names: Container[str]) -> None:
    """Refuse a path such as `fleets/sim.yaml` that exists in a checkout only; its name works in every folder."""
    if path.suffix in ("", _SUFFIX) and path.stem in names:
        try:
            path.stat()
        except (FileNotFoundError, NotADirectoryError):
            raise file_error(path, f"no such file; the framework has one: write '{path.stem}'") from None
        except (OSError, ValueError):  # its reader reports it
            return


def _unknown(name: str | Path, kind: str, known: Iterable[str]) -> ConfigError:
    names = list(known)
    near = nearest(str(name), names)
    hint = f"did you mean '{near}'?" if near is not None else f"there are: {', '.join(names)}"
    return file_error(name, f"no such file, and no {kind} of that name comes with the framework; {hint}")


def short_path(path: Path) -> Path:
    """Return a path relative to the working directory if it is inside it."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
