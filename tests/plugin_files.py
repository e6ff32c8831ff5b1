"""Plugins that a test writes into a folder."""

from __future__ import annotations

import json
from pathlib import Path


def write_plugin(folder: Path, name: str, code: str, *resources: str) -> None:
    """Write `plugins/<name>` into a folder.

    Args:
        folder: the folder of the fleet file.
        name: the plugin's name.
        code: the resources' classes; functions of the plugin API that it lacks are added.
        resources: the names of the resources.
    """
    names = ", ".join(map(repr, resources))
    functions = {"connect": f"(): return EALPlugin({names})", "disconnect": "(plugin): pass"}
    for one in resources:
        functions |= {f"create_{one}": f"(): return {one}()", f"destroy_{one}": "(resource): pass"}
    code += "".join(f"\ndef {name}{rest}\n" for name, rest in functions.items() if f"\ndef {name}(" not in code)
    plugin = folder / "plugins" / name
    plugin.mkdir(parents=True, exist_ok=True)
    (plugin / "plugin.py").write_text(code)
    manifest = {"version": 1, "name": name, "description": "d", "plugin_version": "1", "resources": resources}
    (plugin / "plugin.yaml").write_text(json.dumps(manifest))
