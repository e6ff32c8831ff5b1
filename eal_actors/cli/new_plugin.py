"""Write a new plugin's folder from the templates."""

from __future__ import annotations

import keyword
import re
from pathlib import Path
from string import Template
from typing import Final

from eal_actors import plugin as plugin_api
from eal_actors.kernel.errors import ConfigError, Problem

_TEMPLATES: Final = Path(__file__).with_name("plugin_template")
_NAME: Final = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def write_plugin(name: str, directory: Path) -> Path:
    """Write a plugin's folder, and return it.

    Args:
        name: the plugin's name, which is its folder's as well.
        directory: the folder that holds the plugin's folder; made if it is not there.

    Raises:
        ConfigError: the name cannot be used, the folder exists, or it cannot be written.
    """
    resource = "".join(part.capitalize() for part in name.split("_"))
    folder = directory / name
    if not _NAME.fullmatch(name):
        raise _refused(name, "a plugin's name is a lower-case letter, then lower-case letters, digits, and single '_'")
    if keyword.iskeyword(name) or keyword.iskeyword(resource) or resource in plugin_api.__all__:
        raise _refused(name, f"{resource!r}, the name its resource would get, is taken; choose another")
    try:
        folder.mkdir(parents=True)
        for template in sorted(_TEMPLATES.iterdir()):
            file = folder / template.name.removesuffix(".txt").replace("NAME", name)
            text = Template(template.read_text(encoding="utf-8")).substitute(name=name, resource=resource)
            file.write_text(text, encoding="utf-8")
    except FileExistsError:
        raise _refused(str(folder), "is there already; nothing was written") from None
    except OSError as error:
        raise _refused(str(folder), f"cannot be written: {error.strerror}") from error
    return folder


def _refused(what: str, why: str) -> ConfigError:
    return ConfigError([Problem(what, 0, 0, "", why)])
