"""Plugins that a test writes into a folder."""

from __future__ import annotations

import json
from pathlib import Path

_FUNCTIONS = """
def connect(): return EALPlugin({names})
def disconnect(plugin): pass
"""


def write_plugin(folder: Path, name: str, code: str, *resources: str) -> None:
    """Write `plugins/<name>` into a folder.

    Args:
        folder: the folder of the fleet file.
        name: the plugin's name.
        code: the resources' classes; the plugin's functions are added unless it has a `connect`.
        resources: the names of the resources.
    """
    if "\ndef connect(" not in code:
        code += _FUNCTIONS.format(names=", ".join(map(repr, resources)))
        code += "".join(f"def create_{one}(): return {one}()\ndef destroy_{one}(resource): pass\n" for one in resources)
    plugin = folder / "plugins" / name
    plugin.mkdir(parents=True)
    (plugin / "plugin.py").write_text(code)
    manifest = {"version": 1, "name": name, "description": "d", "plugin_version": "1", "resources": resources}
    (plugin / "plugin.yaml").write_text(json.dumps(manifest))
