"""Loading a world file, and the checks of a whole world, whose parts are valid each by itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, islice
from pathlib import Path
from typing import Final, TypeAlias

from eal_actors.device.markers import FAMILIES
from eal_actors.device.world.geometry import area_m2, corners, covers, crossing_edges, encloses, overlap
from eal_actors.device.world.model import (
    Beacon,
    FloorItem,
    Formation,
    MovableBox,
    NamedPlace,
    Partition,
    Poster,
    StartPose,
    WorldModel,
)
from eal_actors.kernel.bundled import find_file, require_kind
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.strict_model import model_of
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.kernel.yaml_tree import YamlPath

WorldProblem: TypeAlias = tuple[YamlPath, str]
"""The path of a value and the error there."""

_MOST_PROBLEMS: Final = 1000  # nobody reads more, and a million things in one place take the memory
_ROUNDING_M: Final = 1e-9


def validate(world: WorldModel) -> Iterator[WorldProblem]:
    """Yield every problem of a world."""
    yield from _unknown_textures(world)
    yield from _repeated_names(world)
    yield from _outside(world)
    yield from _too_high(world)
    yield from _misplaced_posters(world)
    yield from _misplaced_boxes(world)
    yield from _hidden_beacons(world)
    yield from _bad_starts(world)
    yield from _bad_markers(world)
    yield from _misplaced_cameras(world)
    yield from _bad_zones(world)
    yield from _bad_places(world)


def _unknown_textures(world: WorldModel) -> Iterator[WorldProblem]:
    used: list[tuple[YamlPath, str | None]] = [
        (("surfaces", part), getattr(world.surfaces, part)) for part in ("floor", "walls", "ceiling")
    ]
    for kind, things in (("posters", world.posters), ("obstacles", world.obstacles), ("boxes", world.boxes)):
        used += [((kind, number, "texture"), thing.texture) for number, thing in enumerate(things)]
    for path, name in used:
        if name is not None and name not in world.textures:
            hint = did_you_mean(name, world.textures) if world.textures else ", which is empty"
            yield path, f"no texture {name!r} in textures{hint}"


def _repeated_names(world: WorldModel) -> Iterator[WorldProblem]:
    named: tuple[tuple[str, Sequence[MovableBox | Beacon]], ...] = (("boxes", world.boxes), ("beacons", world.beacons))
    for kind, things in named:
        first: dict[str, int] = {}
        for number, thing in enumerate(things):
            if first.setdefault(thing.name, number) != number:
                yield (kind, number, "name"), f"{kind}[{first[thing.name]}] is named {thing.name!r} already"


def _outside(world: WorldModel) -> Iterator[WorldProblem]:
    for number, obstacle in enumerate(world.obstacles):
        if isinstance(obstacle, Partition):
            for end in ("start_m", "end_m"):
                if _is_outside(world, *getattr(obstacle, end)):
                    yield ("obstacles", number, end), f"is outside {_room(world)}"
        elif _is_outside(world, obstacle.x_m, obstacle.y_m):
            yield ("obstacles", number), f"its middle is outside {_room(world)}"
    others: Iterable[tuple[YamlPath, Sequence[FloorItem]]] = (
        (("boxes",), world.boxes),
        (("beacons",), world.beacons),
        (("drops",), world.drops),
        (("lighting", "lamps"), world.lighting.lamps),
    )
    for path, things in others:
        for number, thing in enumerate(things):
            if _is_outside(world, thing.x_m, thing.y_m):
                yield (*path, number), f"its middle is outside {_room(world)}"


def _is_outside(world: WorldModel, x_m: float, y_m: float) -> bool:
    half_x_m, half_y_m = (size_m / 2 + _ROUNDING_M for size_m in world.size_m)
    return abs(x_m) > half_x_m or abs(y_m) > half_y_m


def _room(world: WorldModel) -> str:
    x_m, y_m = (size_m / 2 for size_m in world.size_m)
    return f"the room, which reaches from {-x_m:g} to {x_m:g} m in x and from {-y_m:g} to {y_m:g} m in y"


def _ceiling(world: WorldModel) -> str:
    return f"the ceiling, which is {world.height_m:g} m high"


def _too_high(world: WorldModel) -> Iterator[WorldProblem]:
    for kind, things in (("obstacles", world.obstacles), ("boxes", world.boxes), ("beacons", world.beacons)):
        for number, thing in enumerate(things):
            if thing.height_m > world.height_m:
                yield (kind, number, "height_m"), f"with {thing.height_m:g} m it does not fit under {_ceiling(world)}"
    for number, lamp in enumerate(world.lighting.lamps):
        if lamp.z_m > world.height_m:
            yield ("lighting", "lamps", number, "z_m"), f"with {lamp.z_m:g} m it is above {_ceiling(world)}"


def _misplaced_posters(world: WorldModel) -> Iterator[WorldProblem]:
    for number, poster in enumerate(world.posters):
        length_m = world.size_m[0 if poster.wall in ("north", "south") else 1]
        left_m, right_m, _, top_m = _extent(poster)
        if max(-left_m, right_m) > length_m / 2 + _ROUNDING_M:
            wall = f"the {poster.wall} wall, which reaches from {-length_m / 2:g} to {length_m / 2:g} m"
            yield ("posters", number), f"from {left_m:g} to {right_m:g} m it does not fit on {wall}"
        if top_m > world.height_m + _ROUNDING_M:
            yield ("posters", number), f"with its top at {top_m:g} m it does not fit under {_ceiling(world)}"
    for (first, poster), (second, other) in combinations(enumerate(world.posters), 2):
        if poster.wall == other.wall and _share_wall(_extent(poster), _extent(other)):
            yield ("posters", second), f"it overlaps posters[{first}] on the {other.wall} wall"


def _extent(poster: Poster) -> tuple[float, float, float, float]:
    """Return its extent along its wall, and its lower and upper edge, in metres."""
    width_m, height_m = poster.size_m
    return poster.at_m - width_m / 2, poster.at_m + width_m / 2, poster.bottom_m, poster.bottom_m + height_m


def _share_wall(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> bool:
    along_m = min(one[1], other[1]) - max(one[0], other[0])
    up_m = min(one[3], other[3]) - max(one[2], other[2])
    return along_m > _ROUNDING_M and up_m > _ROUNDING_M


def _misplaced_boxes(world: WorldModel) -> Iterator[WorldProblem]:
    for number, box in enumerate(world.boxes):
        if _is_outside(world, box.x_m, box.y_m):
            continue
        if any(_is_outside(world, x_m, y_m) for x_m, y_m in corners(box)):
            yield ("boxes", number), f"it reaches out of {_room(world)}"
        for other, obstacle in enumerate(world.solid_obstacles):
            if overlap(box, obstacle):
                yield ("boxes", number), f"it overlaps obstacles[{other}]"
        for other, drop in enumerate(world.drops):
            if covers(drop, box.x_m, box.y_m):
                yield ("boxes", number), f"its middle is over drops[{other}]"
    for (first, box), (second, other_box) in combinations(enumerate(world.boxes), 2):
        if overlap(box, other_box):
            yield ("boxes", second), f"it overlaps boxes[{first}]"


def _hidden_beacons(world: WorldModel) -> Iterator[WorldProblem]:
    for number, beacon in enumerate(world.beacons):
        for other, obstacle in enumerate(world.solid_obstacles):
            if covers(obstacle, beacon.x_m, beacon.y_m):
                yield ("beacons", number), f"it is inside obstacles[{other}], through which no robot finds it"


def _bad_starts(world: WorldModel) -> Iterator[WorldProblem]:
    """Yield start poses where no robot of any size can stand; of a formation only the first."""
    is_formation = isinstance(world.starts, Formation)
    for number, pose in enumerate(world.start_poses):
        if reason := _position_problem(world, pose):
            if is_formation:
                yield ("starts",), f"place {number + 1} of the formation, x {pose.x_m:g} m, y {pose.y_m:g} m, {reason}"
                return
            yield ("starts", number), f"it {reason}"
    if not is_formation:
        first: dict[tuple[float, float], int] = {}
        for number, pose in enumerate(world.start_poses):
            same = first.setdefault((pose.x_m, pose.y_m), number)
            if same != number:
                yield ("starts", number), f"it is at the same place as starts[{same}]"


def _bad_zones(world: WorldModel) -> Iterator[WorldProblem]:
    for number, zone in enumerate(world.keep_out):
        for corner, point in enumerate(zone):
            if _is_outside(world, *point):
                yield ("keep_out", number, corner), f"is outside {_room(world)}"
        if crossing := crossing_edges(zone):
            message = "its edges from corner {} and from corner {} cross; list the corners in order".format(*crossing)
            yield ("keep_out", number), message
        elif area_m2(zone) < _ROUNDING_M:
            yield ("keep_out", number), "its corners are on one line, so it encloses nothing"


def _bad_places(world: WorldModel) -> Iterator[WorldProblem]:
    for name, place in world.places.items():
        if reason := _position_problem(world, place):
            yield ("places", name), f"it {reason}"
        for number, zone in enumerate(world.keep_out):
            if encloses(zone, place.x_m, place.y_m):
                yield ("places", name), f"it is inside keep_out[{number}]"


def _position_problem(world: WorldModel, pose: StartPose | NamedPlace) -> str | None:
    """Return the reason why no robot of any size can stand there, or None."""
    if _is_outside(world, pose.x_m, pose.y_m):
        return f"is outside {_room(world)}"
    for verb, kind, things in (
        ("is inside", "obstacles", world.solid_obstacles),
        ("is inside", "boxes", world.boxes),
        ("is inside", "beacons", world.beacons),
        ("is over", "drops", world.drops),
    ):
        for number, thing in enumerate(things):
            if covers(thing, pose.x_m, pose.y_m):
                return f"{verb} {kind}[{number}]"
    return None


def _bad_markers(world: WorldModel) -> Iterator[WorldProblem]:
    family = FAMILIES[world.markers.family]
    first: dict[int, int] = {}
    for number, marker in enumerate(world.markers.floor):
        path: YamlPath = ("markers", "floor", number)
        if marker.id >= family.count:
            yield (*path, "id"), f"the family {world.markers.family} has the markers 0 to {family.count - 1}"
        if first.setdefault(marker.id, number) != number:
            yield (*path, "id"), f"markers.floor[{first[marker.id]}] is marker {marker.id} already"
        if _is_outside(world, marker.x_m, marker.y_m):
            yield path, f"its middle is outside {_room(world)}"


def _misplaced_cameras(world: WorldModel) -> Iterator[WorldProblem]:
    for name, camera in world.cameras.items():
        if camera.z_m > world.height_m:
            yield ("cameras", name, "z_m"), f"with {camera.z_m:g} m it is above {_ceiling(world)}"
        if _is_outside(world, camera.x_m, camera.y_m):
            yield ("cameras", name), f"it is outside {_room(world)}"


def load_world(path: str | Path) -> WorldModel:
    """Load a world file, or a bundled one such as `lab`. It is the same on every machine: no environment counts.

    Raises ConfigError with every problem of the file.
    """
    tree = load_yaml(find_file(path, "world"))
    require_kind(tree, "world")
    world = model_of(WorldModel, tree)
    if problems := [tree.problem(path, message) for path, message in islice(validate(world), _MOST_PROBLEMS)]:
        raise ConfigError(problems)
    return world
