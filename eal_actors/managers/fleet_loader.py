"""Builds a FleetConfig from fleet files: includes, levels, numbered robots, and their problems."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from eal_actors.device.world import WorldModel, load_world
from eal_actors.kernel.bundled import Kind, find_file, require_kind
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.strict_model import model_of
from eal_actors.kernel.suggestions import did_you_mean, numbered_name_meant
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.kernel.yaml_tree import (
    Mark,
    MarkedDict,
    MarkedList,
    YamlPath,
    YamlTree,
    merge,
    parse_path,
    plain,
    replace_text,
)
from eal_actors.managers.fleet_model import MAX_ROBOTS_OF_ONE_ENTRY, FleetConfig, FleetFile, robot_config
from eal_actors.managers.map_check import map_problems
from eal_actors.managers.memory_file import tree_of
from eal_actors.managers.network_check import network_problems
from eal_actors.managers.network_model import IDENTITY_VARIABLE, network_config
from eal_actors.managers.pose_check import pose_problems


def load_fleet(path: str | Path, environment: Mapping[str, str]) -> FleetConfig:
    """Read a fleet file and what it refers to; arguments and errors as for `EALConfigManager.load`."""
    reader = _FleetFileReader(environment)
    source = find_file(path, "fleet")
    return _resolved(reader, reader.read(source, ()), source)


def load_valid_part(path: str | Path, environment: Mapping[str, str]) -> FleetConfig | None:
    """Read a fleet file without its invalid values, only for more checks; None if other files are not valid either.

    Arguments and errors as for `EALConfigManager.load`.
    """
    source = find_file(path, "fleet")
    tree = load_yaml(source, environment=environment)
    while True:
        reader = _FleetFileReader(environment)
        try:
            return _resolved(reader, reader.take(tree, (source,)), source)
        except ConfigError as error:
            places = [parse_path(problem.path) for problem in error.problems if problem.file == str(source)]
            if len(places) < len(error.problems) or not all(_remove(tree.root, place) for place in places):
                return None


def _remove(root: MarkedDict, path: YamlPath) -> bool:
    """Remove the last named value of a path; return whether there is one, and no other part of the file needs it."""
    node: object = root
    removed = None
    for element in path:
        if not isinstance(node, MarkedDict) or element not in node:
            break
        removed, node = (node, str(element)), node[str(element)]
    if removed is None or path[0] in ("version", "include", "plugin_dirs", "types"):
        return False
    del removed[0][removed[1]]
    return True


def fleet_of(content: Mapping[str, object], name: str, environment: Mapping[str, str]) -> FleetConfig:
    """Build a fleet from the content of its file; arguments and errors as for `EALConfigManager.of`."""
    reader = _FleetFileReader(environment)
    source = Path(name)
    return _resolved(reader, reader.take(tree_of(content, name), (source,)), source)


def _resolved(reader: _FleetFileReader, root: MarkedDict | None, source: Path) -> FleetConfig:
    """Build a fleet from merged files; raises ConfigError with every problem."""
    if root is None:
        raise ConfigError(reader.problems)
    resolver = _Resolver(YamlTree(root), sound=reader.sound)
    merged = resolver.robots()
    resolver.check_network()
    resolver.check_poses()
    world = resolver.world()
    map_path = resolver.map_path()
    plugin_dirs = resolver.plugin_dirs()
    problems = {*reader.problems, *resolver.problems}  # numbered robots may all repeat one
    if problems:
        raise ConfigError(tuple(problems))
    fleet = FleetFile.model_validate(root)
    keys = _beside(YamlTree(root).mark_at(("network", "security", "keys")), "")
    return FleetConfig(
        name=fleet.name or source.stem,
        source=source,
        rate=fleet.clock.rate,
        seed=fleet.seed,
        world=world,
        plugin_dirs=plugin_dirs,
        robots={name: robot_config(name, levels, types) for name, levels, types in merged},
        network=network_config(fleet.network, keys, reader.environment.get(IDENTITY_VARIABLE)),
        content=plain(root),
        tree=YamlTree(root),
        python_steps=fleet.python_steps,
        operators=fleet.dashboard.operators,
        map_path=map_path,
    )


class _FleetFileReader:
    """Reads a fleet file merged over the files it includes, and checks each file by itself.

    `sound` is whether every file was found and every section is a mapping, so that a missing key is really missing.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self.problems: list[Problem] = []
        self.sound = True
        self.environment = environment
        self._read: dict[Path, MarkedDict | None] = {}

    def read(self, path: Path, including: tuple[Path, ...]) -> MarkedDict | None:
        """Return the merged content, or None for a file that cannot be read."""
        identity = path.resolve()
        if identity not in self._read:
            self._read[identity] = self._read_new(path, (*including, path))
        return self._read[identity]

    def _read_new(self, path: Path, chain: tuple[Path, ...]) -> MarkedDict | None:
        try:
            tree = load_yaml(path, environment=self.environment)
            require_kind(tree, "fleet")
        except ConfigError as error:
            self.problems += error.problems
            self.sound = False
            return None
        return self.take(tree, chain)

    def take(self, tree: YamlTree, chain: tuple[Path, ...]) -> MarkedDict:
        """Return the content of one file merged over the files it includes; `chain` leads to it and ends with it."""
        try:
            model_of(FleetFile, tree)
        except ConfigError as error:
            self.problems += error.problems
        sections = (tree.root.get(key, tree.root) for key in ("defaults", "types", "robots"))
        self.sound = self.sound and all(isinstance(section, MarkedDict) for section in sections)
        merged = MarkedDict(tree.root.mark)
        for index, target in enumerate(_texts(tree.root.get("include"))):
            part = self._include(tree, ("include", index), target, chain)
            merged = merge(merged, part) if part is not None else merged
        return merge(merged, tree.root)

    def _include(self, tree: YamlTree, at: YamlPath, target: str, chain: tuple[Path, ...]) -> MarkedDict | None:
        try:
            path = _find(tree.mark_at(at), target, "fleet")
        except FileNotFoundError as error:
            self.problems.append(tree.problem(at, str(error)))
            self.sound = False
            return None
        identities = [file.resolve() for file in chain]
        if path.resolve() in identities:
            loop = [*chain[identities.index(path.resolve()) :], path]
            self.problems.append(tree.problem(at, f"include loop: {' -> '.join(str(file) for file in loop)}"))
            return None
        return self.read(path, chain)


class _Resolver:
    """Applies types and defaults to the robots of a merged fleet.

    It works on the files' own values, which a model may have refused, so that one pass reports everything: values of
    the wrong form are skipped here.
    """

    def __init__(self, tree: YamlTree, *, sound: bool) -> None:
        self.problems: list[Problem] = []
        self._tree = tree
        self._sound = sound
        self._types = tree.root.section("types")
        self._robots = tree.root.section("robots")
        self._entries: dict[str, tuple[str, MarkedDict]] = {}

    def robots(self) -> list[tuple[str, MarkedDict, tuple[str, ...]]]:
        """Return each robot's name, its levels merged into one, and the chain of its types."""
        self._check_types()
        if not self._robots and self._sound:
            self._report(("robots",), "the fleet has no robots; name at least one under 'robots'")
        made: dict[str, Mark] = {}
        merged: list[tuple[str, MarkedDict, tuple[str, ...]]] = []
        for key, entry in self._robots.items():
            if not isinstance(entry, MarkedDict):
                continue
            mark = self._robots.key_marks[key]
            for name, own in self._numbered(key, entry):
                if name in made:
                    earlier = made[name]
                    place = f"{earlier.file}:{earlier.line}"
                    self._report(("robots", key), f"the robot '{name}' is there already, from {place}", key=True)
                    continue
                made[name] = mark
                levels, types = self._levels(key, own)
                self._entries[name] = (key, levels)
                merged.append((name, levels, types))
        return merged

    def check_network(self) -> None:
        """Look for contradictions between the network and the robots that `robots` returned."""
        if self._sound:
            self.problems += network_problems(self._tree, self._entries)

    def check_poses(self) -> None:
        """Look for contradictions between the sources of the pose estimates and the robots that `robots` returned."""
        if self._sound:
            self.problems += pose_problems(self._tree, self._entries)

    def world(self) -> WorldModel | None:
        """Return the world, or None if the fleet has none or it is not right."""
        target = self._tree.root.get("world")
        if not isinstance(target, str):
            return None
        try:
            return load_world(_find(self._tree.mark_at(("world",)), target, "world"))
        except FileNotFoundError as error:
            self._report(("world",), str(error))
            return None
        except ConfigError as error:
            self.problems += error.problems
            return None

    def map_path(self) -> Path | None:
        target = self._tree.root.get("map")
        path = _beside(self._tree.mark_at(("map",)), target) if isinstance(target, str) else None
        if path is not None and path.is_file():
            self.problems += map_problems(path)
        elif path is not None:
            self._report(("map",), f"no such file: {path}")
        return path

    def plugin_dirs(self) -> tuple[Path, ...]:
        """Return the folders to search for plugins, each once."""
        folders: list[Path] = []
        for index, target in enumerate(_texts(self._tree.root.get("plugin_dirs"))):
            folder = _beside(self._tree.mark_at(("plugin_dirs", index)), target)
            if not folder.is_dir():
                self._report(("plugin_dirs", index), f"no such folder: {folder}")
            folders.append(folder.resolve())
        return tuple(dict.fromkeys(folders))

    def _report(self, path: YamlPath, message: str, *, key: bool = False) -> None:
        self.problems.append(self._tree.problem(path, message, key=key))

    def _check_types(self) -> None:
        looped: set[str] = set()
        for name, entry in self._types.items():
            parent = _type_of(entry)
            if parent is not None and parent not in self._types:
                self._report_unknown_type(("types", name, "type"), parent)
            chain = [name]
            while (parent := _type_of(self._types.get(chain[-1]))) in self._types and parent is not None:
                chain.append(parent)
                if parent in chain[:-1]:
                    break
            if len(chain) > 1 and chain[-1] == name and name not in looped:
                looped.update(chain)
                self._report(("types", name, "type"), f"type loop: {' -> '.join(chain)}")

    def _report_unknown_type(self, path: YamlPath, name: str) -> None:
        if self._sound:
            self._report(path, f"unknown type '{name}'{did_you_mean(name, self._types)}")

    def _numbered(self, key: str, entry: MarkedDict) -> list[tuple[str, MarkedDict]]:
        """Return the robots that an entry makes, with `{n}` replaced."""
        if entry.get("count") is None and entry.get("range") is None:
            if "{n}" in key:
                self._report(("robots", key), "the name holds {n}, but neither 'count' nor 'range' is given", key=True)
                return []
            return [(key, entry)]
        numbers = self._numbers(key, entry)
        if "{n}" not in key:
            message = f"several robots need {{n}} in their name; write '{key}{{n}}'"
            self._report(("robots", key), message, key=True)
            return []
        return [(key.replace("{n}", str(number)), _with_number(entry, number)) for number in numbers]

    def _numbers(self, key: str, entry: MarkedDict) -> range:
        """Return the numbers of an entry's robots; none if they are wrong."""
        nothing = range(0)
        count, span = entry.get("count"), entry.get("range")
        if count is not None and span is not None:
            self._report(("robots", key, "range"), "give either 'count' or 'range', not both", key=True)
            return nothing
        if span is None:
            return range(1, count + 1) if isinstance(count, int) and count <= MAX_ROBOTS_OF_ONE_ENTRY else nothing
        if not (isinstance(span, MarkedList) and len(span) == 2 and all(isinstance(number, int) for number in span)):
            return nothing
        first, last = span
        if first > last:
            self._report(("robots", key, "range"), f"runs backwards; write [{last}, {first}]")
            return nothing
        if last - first >= MAX_ROBOTS_OF_ONE_ENTRY:
            self._report(("robots", key, "range"), f"makes more than {MAX_ROBOTS_OF_ONE_ENTRY} robots")
            return nothing
        return range(first, last + 1)

    def _levels(self, key: str, robot: MarkedDict) -> tuple[MarkedDict, tuple[str, ...]]:
        """Return a robot merged over its types and the defaults, and the chain of its types."""
        own_type = _type_of(robot)
        chain: list[str] = []
        step = own_type
        while step in self._types and step is not None and step not in chain:
            chain.append(step)
            step = _type_of(self._types[step])
        if own_type is not None and not chain:
            self._report_unknown_type(("robots", key, "type"), own_type)
        entries = [self._tree.root.section("defaults"), *(self._types[name] for name in reversed(chain)), robot]
        sections = [entry for entry in entries if isinstance(entry, MarkedDict)]
        merged = sections[0]
        for section in sections[1:]:
            merged = merge(merged, section)
        is_complete = step is None and len(sections) == len(entries) and self._sound
        if is_complete and merged.get("plugins", {}) == {} and merged.get("address") is None:
            message = "the robot has no plugins; give it one under 'plugins', or a type that has one"
            message += numbered_name_meant(key, self._tree.root["robots"])
            self._report(("robots", key), message, key=True)
        return merged, tuple(chain)


def _with_number(entry: MarkedDict, number: int) -> MarkedDict:
    numbered: MarkedDict = replace_text(entry, lambda text: text.replace("{n}", str(number)))
    return numbered


def _type_of(section: object) -> str | None:
    text = section.get("type") if isinstance(section, MarkedDict) else None
    return text if isinstance(text, str) else None


def _texts(value: object) -> list[str]:
    return [item if isinstance(item, str) else "" for item in value] if isinstance(value, MarkedList) else []


def _beside(mark: Mark, target: str) -> Path:
    """Return a path that is relative to the file in which it is written."""
    return Path(mark.file).parent / target


def _find(mark: Mark, target: str, kind: Kind) -> Path:
    """Return the file that a path or a name refers to in the file in which it is written.

    Raises FileNotFoundError if there is none; the message lists similar files.
    """
    try:
        path = find_file(target, kind, Path(mark.file).parent)
    except ConfigError as error:
        raise FileNotFoundError(error.problems[0].message) from None
    if not path.is_file():
        hint = did_you_mean(path.name, [file.name for file in path.parent.glob("*.yaml")])
        raise FileNotFoundError(f"no such file: {path}{hint}")
    return path
