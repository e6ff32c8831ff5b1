"""The option `--setting`: settings of a plugin as YAML, for `eal plugin check` and `eal bridge`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, TypeAlias

import typer

from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.yaml_source import parse_yaml

SettingOption: TypeAlias = Annotated[
    list[str] | None, typer.Option("--setting", metavar="KEY=VALUE", help="A setting, as YAML; repeatable.")
]


def parse_settings(texts: Sequence[str]) -> dict[str, Any]:
    """Return the settings of texts such as `rate_hz=5`.

    Raises BadParameter if a text is no KEY=VALUE, or its value is no YAML.
    """
    settings: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise typer.BadParameter(f"must be KEY=VALUE, not {text!r}", param_hint="--setting")
        try:
            settings[key] = parse_yaml(f"value: {value}", f"--setting {key}").root["value"]
        except ConfigError as error:
            reasons = "; ".join(problem.message for problem in error.problems)
            raise typer.BadParameter(f"{text!r}: {reasons}", param_hint="--setting") from None
    return settings
