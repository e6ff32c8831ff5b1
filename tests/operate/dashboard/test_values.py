"""Live values: of the robots that somebody looks at, and of no other; a slow resource is asked once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard import Dashboard
from eal_actors.operate.dashboard.limits import COMMANDS_AT_ONCE
from tests.operate.dashboard.rig import Page, open_dashboard, page_of, resource_of
from tests.plugin_files import write_plugin

PLUGIN = """\
import threading

from eal_actors.plugin import DataType, EALPlugin, Resource, ResourceType, ValueInfo


class Counter(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.INT, "m")

    def __init__(self):
        self.asked = 0

    def get_value(self):
        self.asked += 1
        return self.asked


class Slow(Counter):
    def __init__(self):
        super().__init__()
        self.released = threading.Event()

    def get_value(self):
        self.asked += 1
        self.released.wait(60)
        return self.asked


class Text(Counter):
    value = ValueInfo(DataType.CHAR)

    def get_value(self):
        return "x" * 1000


class Ray(Counter):
    value = ValueInfo(DataType.DOUBLE, "m", shape=(None, 2))

    def get_value(self):
        return [float("nan"), 1 / 3, 2.0, 3.0]


class Cloud(Counter):
    value = ValueInfo(DataType.DOUBLE, shape=(None,))

    def get_value(self):
        self.asked += 1
        return [0.0] * 1000


class Lidar(Counter):
    value = ValueInfo(DataType.DOUBLE, shape=(360,))


class Broken(Counter):
    def get_value(self):
        raise RuntimeError("no <b>light</b>")


class Line(Counter):
    types = ResourceType.COMMUNICATION
"""
NAMES = ("Counter", "Slow", "Text", "Ray", "Cloud", "Lidar", "Broken", "Line")


@pytest.fixture
def sensing(tmp_path: Path) -> Iterator[Fleet]:
    """Yield a connected fleet of two robots whose sensors count their questions; only the Slow of one waits."""
    write_plugin(tmp_path, "sensing", PLUGIN, *NAMES)
    file = tmp_path / "fleet.yaml"
    names = "".join(f"  {name}: {{plugins: {{sensing: {{}}}}}}\n" for name in ("one", "two"))
    file.write_text(f"version: 1\nname: sensing\nplugin_dirs: [plugins]\nrobots:\n{names}")
    with Fleet.load(file).connect() as opened:
        slow = resource_of(opened, "one", "Slow")
        resource_of(opened, "two", "Slow").released.set()
        yield opened
        slow.released.set()


def values_of(page: Page, robot: str, resource: str) -> dict[str, object]:
    """Return what the page knows of a resource."""
    return dict(page.values.get(robot, {}).get(resource, {}))


def test_values_are_sent_to_who_looks_and_a_slow_resource_is_asked_once(sensing: Fleet) -> None:
    counter, slow = resource_of(sensing, "one", "Counter"), resource_of(sensing, "one", "Slow")
    with open_dashboard(sensing) as dashboard, page_of(dashboard) as other, page_of(dashboard) as page:
        page.hear_until(lambda: "one" in page.robots)
        assert counter.asked == slow.asked == 0  # nobody looks
        page.say(do="watch_values", robot="one")
        page.hear_until(lambda: "silent_s" in values_of(page, "one", "Slow") and counter.asked >= 3)
        assert slow.asked == 1
        assert set(page.values["one"]) == {"Counter", "Slow", "Text", "Ray", "Broken"}
        assert values_of(page, "one", "Text")["value"] == "x" * 200
        assert values_of(page, "one", "Ray")["value"] == [None, 0.333333, 2.0, 3.0]
        assert values_of(page, "one", "Broken")["error"] == "get_value raised RuntimeError: no <b>light</b>"
        assert resource_of(sensing, "one", "Cloud").asked == 1
        slow.released.set()
        page.hear_until(lambda: "value" in values_of(page, "one", "Slow"))
        assert "silent_s" not in values_of(page, "one", "Slow")
        page.say(do="watch_values", robot="two")
        page.hear_until(lambda: "value" in values_of(page, "two", "Counter"))
        seen = counter.asked
        newest = resource_of(sensing, "two", "Counter")
        page.hear_until(lambda: newest.asked >= 4)
        assert counter.asked == seen
        other.ask(do="stop")
        assert other.values == {}


def test_a_second_browser_gets_all_values_and_the_last_one_ends_the_questions(sensing: Fleet) -> None:
    counter = resource_of(sensing, "two", "Counter")
    with open_dashboard(sensing) as dashboard, page_of(dashboard) as page:
        with page_of(dashboard) as first, page_of(dashboard) as second:
            first.say(do="watch_values", robot="two")
            first.hear_until(lambda: "value" in values_of(first, "two", "Text"))
            second.say(do="watch_values", robot="two")
            second.hear_until(lambda: "value" in values_of(second, "two", "Text"))  # though it has not changed
        page.hear_until(lambda: dashboard.store.get("values", "two") is None)  # nobody looks any more
        seen = counter.asked
        page.ask(do="stop")
        assert counter.asked == seen


def test_a_robot_that_is_not_there_is_named(sensing: Fleet) -> None:
    with open_dashboard(sensing) as dashboard, page_of(dashboard) as page:
        page.say(do="watch_values", robot="nobody")
        page.hear_until(lambda: None in page.answers)
        assert page.answers[None]["error"] == "there is no robot 'nobody'"


def test_the_last_choice_of_a_hasty_page_counts(dashboard: Dashboard) -> None:
    """Somebody flicks through the robots: the choice that remains is not lost to the limit of commands."""
    with page_of(dashboard) as page:
        for number in range(2 * int(COMMANDS_AT_ONCE) + 1):
            page.say(do="watch_values", robot="one" if number % 2 else "two")
        page.hear_until(lambda: "two" in page.values)
        assert not page.answers


MUTE_PLUGIN = """\
import threading

from eal_actors.plugin import DataType, EALPlugin, Resource, ResourceType, ValueInfo


class Pose(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,))
    reading = [1.0, 2.0, 0.0]

    def __init__(self):
        self.released = threading.Event()
        self.released.set()

    def get_value(self):
        self.released.wait(60)
        return self.reading


class Battery(Pose):
    value = ValueInfo(DataType.DOUBLE)
    reading = 0.5
"""


def test_a_pose_and_a_charge_that_are_no_longer_known_are_not_shown_as_new(tmp_path: Path) -> None:
    write_plugin(tmp_path, "mute", MUTE_PLUGIN, "Pose", "Battery")
    file = tmp_path / "fleet.yaml"
    file.write_text("version: 1\nplugin_dirs: [plugins]\nrobots: {one: {plugins: {mute: {}}}}\n")
    with Fleet.load(file).connect() as mute, open_dashboard(mute) as dashboard, page_of(dashboard) as page:
        page.hear_until(lambda: "one" in page.poses and page.robots["one"]["battery"] == 0.5)
        assert page.robots["one"]["pose_seen"] is None
        asked = [resource_of(mute, "one", name).released for name in ("Pose", "Battery")]
        for released in asked:
            released.clear()
        page.hear_until(lambda: bool(page.robots["one"]["pose_seen"]) and page.robots["one"]["battery"] is None)
        assert page.robots["one"]["state"] == "ready"
        for released in asked:
            released.set()
        page.hear_until(lambda: page.robots["one"]["pose_seen"] is None and page.robots["one"]["battery"] == 0.5)


STRAY_PLUGIN = MUTE_PLUGIN.replace("import DataType", "import DataType, EALData").replace(
    "return self.reading", "return EALData.of(self.reading, stamp_s=-1e300)"
)


def test_a_pose_with_a_time_of_no_calendar_stops_no_other_robot(tmp_path: Path) -> None:
    """The age of the pose was no date, and no page had news of any robot."""
    write_plugin(tmp_path, "mute", MUTE_PLUGIN, "Pose", "Battery")
    write_plugin(tmp_path, "stray", STRAY_PLUGIN, "Pose", "Battery")
    file = tmp_path / "fleet.yaml"
    robots = "{stray: {plugins: {stray: {}}}, one: {plugins: {mute: {}}}}"
    file.write_text(f"version: 1\nplugin_dirs: [plugins]\nrobots: {robots}\n")
    with Fleet.load(file).connect() as mixed, open_dashboard(mixed) as dashboard, page_of(dashboard) as page:
        page.hear_until(lambda: bool(page.robots.get("stray", {}).get("pose_seen")))
        page.hear_until(lambda: page.robots["one"]["battery"] == 0.5)
