"""Loading a world file."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from eal_actors.device.world.model import WorldModel
from eal_actors.device.world.validation import validate
from eal_actors.kernel.bundled import find_file
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.strict_model import problems_from
from eal_actors.kernel.yaml_source import load_yaml


def load_world(path: str | Path) -> WorldModel:
    """Load a world file. It does not depend on the environment: a world is the same on every machine.

    Args:
        path: the world file, or the name of a bundled one, such as `lab`.

    Raises:
        ConfigError: with every problem of the file.
    """
    tree = load_yaml(find_file(path, "world"))
    try:
        world = WorldModel.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, WorldModel)) from None
    if problems := [tree.problem(path, message) for path, message in validate(world)]:
        raise ConfigError(sorted(problems))
    return world
