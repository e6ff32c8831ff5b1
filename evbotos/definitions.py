"""Reading the definitions; all problems of all files are reported at once with file, line and column."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from eal_actors.kernel.errors import ConfigError, Problem, file_error
from eal_actors.kernel.strict_model import StrictModel, model_of
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_source import load_yaml
from evbotos import lock
from evbotos.model import LISTS, Image, Kernel, Local, Platform

FOLDER: Final = Path(__file__).parent
LOCAL: Final = "local.yaml"
LIBCAMERA: Final = "libcamera-ipa"
"""The package with libcamera's control of cameras on a cable."""

_M = TypeVar("_M", bound=StrictModel)


@dataclass(frozen=True, slots=True)
class Definitions:
    """All platforms and images.

    Attributes:
        platforms: by name.
        images: by name, with included images and the user's changes merged.
        local: the user's own settings.
        own_locks: the folder of the user's lock files, next to `local.yaml`.
        changed: platforms and images whose packages, wheels or kernels the user changes.
    """

    platforms: dict[str, Platform]
    images: dict[str, Image]
    local: Local
    own_locks: Path
    changed: frozenset[tuple[str, str]]

    def platform(self, name: str) -> Platform:
        """Return a platform. Raises ConfigError for an unknown name."""
        return _known("platform", name, self.platforms)

    def image(self, name: str) -> Image:
        """Return an image. Raises ConfigError for an unknown name."""
        return _known("image", name, self.images)

    def chosen(self, platform: str, image: str) -> tuple[Platform, Image]:
        """Return a platform, with the kernel that the image wants, and an image for it.

        Raises:
            ConfigError: an unknown name, or the image is for other architectures.
        """
        board, what = self.platform(platform), self.image(image)
        if not fits(board, what):
            wanted = ", ".join(what.architectures)
            message = f"the image {image} is for {wanted}; the platform {platform} is {board.architecture}"
            raise file_error("images", message)
        return _for_image(board, what), what

    def lock_path(self, platform: Platform, image: Image) -> Path:
        """Return the lock file of an image: the user's own if `local.yaml` changes its contents."""
        is_own = (platform.name, image.name) in self.changed
        return lock.lock_path(platform, image, self.own_locks if is_own else lock.FOLDER)


def load_definitions(local: Path | None = None, folder: Path = FOLDER) -> Definitions:
    """Read all platforms and images.

    Args:
        local: the user's file; None selects `local.yaml` in the working directory, if present.
        folder: the parent of `platforms/` and `images/`.

    Raises:
        ConfigError: lists every problem of all files.
    """
    problems: list[Problem] = []
    platforms = _read_folder(folder / "platforms", Platform, problems)
    raw = _read_folder(folder / "images", Image, problems)
    own = local if local is not None else Path(LOCAL)
    settings = Local(version=1)
    if local is not None or own.is_file():
        settings = _read(own, Local, problems) or settings
        problems += _unknown(own, "image", settings.images, raw)
        problems += _unknown(own, "platform", settings.platforms, platforms)
    images = {name: _with_includes(name, raw, folder, problems, ()) for name in raw}
    if problems:
        raise ConfigError(set(problems))
    own_platforms = {name: _with_own_parts(platform, settings) for name, platform in platforms.items()}
    own_images = {name: _overridden(image, settings) for name, image in images.items()}
    changed = {
        (platform.name, image.name)
        for platform in platforms.values()
        for image in images.values()
        if lock.asked_by(platform, image) != lock.asked_by(own_platforms[platform.name], own_images[image.name])
    }
    return Definitions(own_platforms, own_images, settings, own.parent / "locks", frozenset(changed))


def fits(platform: Platform, image: Image) -> bool:
    """Return whether an image is for a platform's architecture."""
    return not image.architectures or platform.architecture in image.architectures


def _for_image(platform: Platform, image: Image) -> Platform:
    """Return a platform with the drivers and the firmware that an image needs; Debian's kernels have all drivers."""
    wifi = platform.wifi if "wifi" in image.services else None
    changed: dict[str, object] = {} if wifi is None else {"packages": (*platform.packages, *wifi.packages)}
    camera = platform.camera_fragments if LIBCAMERA in image.packages else ()
    added = (*image.kernel_fragments, *(wifi.kernel_fragments if wifi is not None else ()), *camera)
    if isinstance(kernel := platform.kernel, Kernel) and added:
        fragments = tuple(dict.fromkeys([*kernel.fragments, *added]))
        changed["kernel"] = kernel.model_copy(update={"fragments": fragments})
    return platform.model_copy(update=changed)


def _known(kind: str, name: str, found: dict[str, _M]) -> _M:
    if name not in found:
        message = f"there is no {kind} '{name}'{did_you_mean(name, found)}"
        raise file_error(f"{kind}s", message)
    return found[name]


def _read_folder(folder: Path, model: type[_M], problems: list[Problem]) -> dict[str, _M]:
    found: dict[str, _M] = {}
    for path in sorted(folder.glob("*.yaml")):
        definition = _read(path, model, problems)
        if definition is None:
            continue
        name: str = getattr(definition, "name", path.stem)
        if name != path.stem:
            problems.append(Problem(str(path), 0, 0, "name", f"is '{name}', but the file is {path.name}"))
        found[path.stem] = definition
    return found


def _read(path: Path, model: type[_M], problems: list[Problem]) -> _M | None:
    try:
        return model_of(model, load_yaml(path))
    except ConfigError as error:
        problems += error.problems
        return None


def _with_includes(
    name: str, raw: dict[str, Image], folder: Path, problems: list[Problem], way: tuple[str, ...]
) -> Image:
    """Return an image whose lists begin with those of its included images."""
    image, file = raw[name], str(folder / "images" / f"{name}.yaml")
    if name in way:
        problems.append(Problem(file, 0, 0, "include", f"include loop: {' -> '.join([*way, name])}"))
        return image
    lists: dict[str, list[str]] = {key: [] for key in LISTS}
    architectures, project = image.architectures, image.project
    for other in image.include:
        if other not in raw:
            if (folder / "images" / f"{other}.yaml").is_file():
                continue  # its own problems are reported
            message = f"there is no image '{other}'{did_you_mean(other, raw)}"
            problems.append(Problem(file, 0, 0, "include", message))
            continue
        base = _with_includes(other, raw, folder, problems, (*way, name))
        architectures, project = architectures or base.architectures, project or base.project
        for key in LISTS:
            lists[key] += getattr(base, key)
    joined = {key: tuple(dict.fromkeys([*lists[key], *getattr(image, key)])) for key in LISTS}
    return image.model_copy(update={**joined, "architectures": architectures, "project": project})


def _with_own_parts(platform: Platform, local: Local) -> Platform:
    over = local.platforms.get(platform.name)
    if over is None:
        return platform
    overlays = tuple(dict.fromkeys([*platform.overlays, *over.overlays]))
    return platform.model_copy(update={"kernel": over.kernel or platform.kernel, "overlays": overlays})


def _overridden(image: Image, local: Local) -> Image:
    over = local.images.get(image.name)
    if over is None:
        return image
    joined = {
        key: tuple(dict.fromkeys([*getattr(image, key), *getattr(over, key)]))
        for key in ("packages", "wheels", "services")
    }
    replaced = {key: value for key in ("budget_mb", "layout") if (value := getattr(over, key)) is not None}
    return image.model_copy(update={**joined, **replaced})


def _unknown(file: Path, kind: str, named: Iterable[str], known: Iterable[str]) -> list[Problem]:
    names = set(known)
    return [
        Problem(str(file), 0, 0, f"{kind}s.{name}", f"there is no {kind} '{name}'{did_you_mean(name, names)}")
        for name in named
        if name not in names
    ]
