"""Checks of the robots' pose estimates against the whole fleet: trackers and markers."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_tree import MarkedDict, MarkedList, YamlPath, YamlTree
from eal_actors.managers.fleet_model import ODOMETRY


def pose_problems(tree: YamlTree, robots: Mapping[str, tuple[str, MarkedDict]]) -> Iterator[Problem]:
    """Yield the contradictions between the `pose:` sections and the robots, as `network_problems`."""
    owners: dict[tuple[str, str], str] = {}
    for name, (key, levels) in robots.items():
        pose = levels.get("pose")
        if not isinstance(pose, MarkedDict):
            continue
        at: YamlPath = ("robots", key, "pose")
        sources, marker = pose.get("from"), pose.get("marker")
        named = [one for one in sources if isinstance(one, str)] if isinstance(sources, MarkedList) else []
        trackers = [one for one in named if one != ODOMETRY]
        for message in _source_problems(named, trackers, robots):
            yield tree.problem((*at, "from"), message)
        if trackers and marker is None:
            yield tree.problem(at, f"a tracker knows '{name}' by its marker: give its number under 'marker'", key=True)
        for tracker in trackers if marker is not None else ():
            owner = owners.setdefault((tracker, str(marker)), name)
            if owner != name:
                yield tree.problem((*at, "marker"), f"marker {marker} is on '{owner}' already")


def _source_problems(named: Sequence[str], trackers: Sequence[str], robots: Collection[str]) -> Iterator[str]:
    for tracker in trackers:
        if tracker not in robots:
            yield f"the fleet has no robot '{tracker}'{did_you_mean(tracker, (ODOMETRY, *robots))}"
    if named and ODOMETRY not in named:
        yield f"'{ODOMETRY}' must be among the sources: fixes only correct it"
