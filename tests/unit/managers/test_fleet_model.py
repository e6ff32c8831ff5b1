from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import PositiveFloat

from eal_actors.kernel.strict_model import StrictModel, model_of
from eal_actors.managers.fleet_loader import load_fleet
from eal_actors.managers.fleet_model import FleetConfig
from tests.problems import problem_texts


class Fleets:
    """A folder of fleet files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment: dict[str, str] = {}

    def write(self, name: str, text: str) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def load(self, text: str) -> FleetConfig:
        self.write("f.yaml", f"version: 1\n{text}")
        return load_fleet("f.yaml", self.environment)

    def problems(self, text: str) -> list[str]:
        return problem_texts(lambda: self.load(text))


@pytest.fixture
def fleets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fleets:
    monkeypatch.chdir(tmp_path)
    return Fleets(tmp_path)


PLUGINS = "plugins: {s: {}}"


class TestResolving:
    def test_what_is_left_out_has_its_default(self, fleets: Fleets) -> None:
        fleet = fleets.load(f"robots: {{r: {{{PLUGINS}}}}}")
        robot = fleet.robots["r"]

        assert (fleet.name, fleet.rate, fleet.seed, fleet.world) == ("f", 1.0, 0, None)
        assert fleet.source == Path("f.yaml")
        assert fleet.plugin_dirs == ()
        assert (robot.name, robot.type, robot.types, robot.tags) == ("r", None, (), ())
        assert (robot.timeout_s, robot.mailbox) == (10.0, 256)
        assert (robot.restart, robot.max_restarts, robot.restart_window_s) == ("permanent", 3, 5.0)

    def test_levels_override_each_other_key_by_key(self, fleets: Fleets) -> None:
        fleet = fleets.load("""
defaults: {timeout_s: 1, mailbox: 1, max_restarts: 1, restart_window_s: 1, tags: [default]}
types:
  child: {type: parent, max_restarts: 3, restart_window_s: 3, tags: [child], plugins: {s: {b: 2, in: {y: 2}}}}
  parent: {mailbox: 2, max_restarts: 2, restart_window_s: 2, tags: [parent], plugins: {s: {a: 1, b: 1, in: {x: 1}}}}
robots:
  r: {type: child, restart_window_s: 4, plugins: {s: {c: 3, in: {z: [3]}}, t: {}}}
""")
        robot = fleet.robots["r"]

        assert (robot.timeout_s, robot.mailbox, robot.max_restarts, robot.restart_window_s) == (1.0, 2, 3, 4.0)
        assert (robot.type, robot.types, robot.tags) == ("child", ("child", "parent"), ("child",))
        assert robot.plugins["s"].settings == {"a": 1, "b": 2, "c": 3, "in": {"x": 1, "y": 2, "z": [3]}}
        assert list(robot.plugins) == ["s", "t"]

    def test_an_instance_may_have_another_name_than_its_plugin(self, fleets: Fleets) -> None:
        plugins = fleets.load("robots: {r: {plugins: {arm: {plugin: servo, id: 1}, servo: {}}}}").robots["r"].plugins

        assert [(entry.instance, entry.plugin, entry.settings) for entry in plugins.values()] == [
            ("arm", "servo", {"id": 1}),
            ("servo", "servo", {}),
        ]

    def test_numbered_robots_get_their_number_in_every_text(self, fleets: Fleets) -> None:
        fleet = fleets.load("""
robots:
  "bot{n}": {count: 2, tags: ["line{n}"], plugins: {s: {port: "/dev/tty{n}", list: ["{n}", 5]}}}
  "sim{n}b": {range: [9, 10], plugins: {s: {}}}
  single: {plugins: {s: {text: "{n}"}}}
""")
        assert list(fleet.robots) == ["bot1", "bot2", "sim9b", "sim10b", "single"]
        assert fleet.robots["bot2"].tags == ("line2",)
        assert fleet.robots["bot2"].plugins["s"].settings == {"port": "/dev/tty2", "list": ["2", 5]}
        assert fleet.robots["single"].plugins["s"].settings == {"text": "{n}"}

    def test_includes_are_overridden_by_later_ones_and_by_the_file(self, fleets: Fleets) -> None:
        fleets.write("one.yaml", "version: 1\nseed: 1\nclock: {rate: 1}\ndefaults: {mailbox: 1, timeout_s: 1}\n")
        fleets.write("parts/two.yaml", "version: 1\nseed: 2\ninclude: [deep.yaml]\ndefaults: {mailbox: 2}\n")
        fleets.write("parts/deep.yaml", "version: 1\nname: deep\ntypes: {t: {plugins: {s: {a: 1}}}}\nseed: 9\n")

        fleet = fleets.load("include: [one.yaml, parts/two.yaml]\nclock: {rate: 3}\nrobots: {r: {type: t}}\n")

        assert (fleet.name, fleet.seed, fleet.rate) == ("deep", 2, 3.0)
        robot = fleet.robots["r"]
        assert (robot.mailbox, robot.timeout_s, robot.plugins["s"].settings) == (2, 1.0, {"a": 1})

    def test_one_file_may_be_included_twice(self, fleets: Fleets) -> None:
        fleets.write("base.yaml", f"version: 1\nrobots: {{r: {{{PLUGINS}}}}}\n")
        fleets.write("a.yaml", "version: 1\ninclude: [base.yaml]\n")
        fleets.write("b.yaml", "version: 1\ninclude: [base.yaml]\n")

        assert list(fleets.load("include: [a.yaml, b.yaml]").robots) == ["r"]

    def test_paths_are_relative_to_the_file_that_names_them(self, fleets: Fleets) -> None:
        fleets.write("parts/room.yaml", "version: 1\nname: room\nsize_m: [1, 2]\n")
        fleets.write("parts/p.yaml", "version: 1\nworld: room.yaml\nplugin_dirs: [extra, ../own, extra/]\n")
        (fleets.folder / "parts/extra").mkdir()
        (fleets.folder / "own").mkdir()

        fleet = fleets.load(f"include: [parts/p.yaml]\nrobots: {{r: {{{PLUGINS}}}}}")

        assert fleet.world is not None
        assert fleet.world.size_m == (1.0, 2.0)
        assert fleet.plugin_dirs == (fleets.folder / "parts/extra", fleets.folder / "own")

    def test_values_may_come_from_the_environment(self, fleets: Fleets) -> None:
        fleets.environment = {"BOX": "7", "PORT": "50000"}

        robot = fleets.load("""
robots:
  r:
    mailbox: ${BOX}
    timeout_s: ${TIMEOUT:-2.5}
    plugins:
      s:
        port: ${PORT}
        url: socket://localhost:${PORT}
""").robots["r"]

        assert (robot.mailbox, robot.timeout_s) == (7, 2.5)
        assert robot.plugins["s"].settings == {"port": 50000, "url": "socket://localhost:50000"}


class TestPluginSettings:
    class Model(StrictModel):
        port: str
        speed_m_s: PositiveFloat = 1.0

    TEXT = """
types:
  t: {plugins: {arm: {plugin: servo, speed_m_s: -1}}}
robots:
  r1: {type: t, plugins: {arm: {prot: x}}}
  r2: {plugins: {servo: {}}}
"""

    def test_problems_of_settings_point_to_the_level_they_come_from(self, fleets: Fleets) -> None:
        settings = fleets.load(self.TEXT).robots["r1"].plugins["arm"]

        assert problem_texts(lambda: model_of(self.Model, settings.tree)) == [
            "f.yaml:4:31: robots.r1.plugins.arm.port: is missing",
            "f.yaml:4:49: robots.r1.plugins.arm.speed_m_s: must be over 0, not -1",
            "f.yaml:6:33: robots.r1.plugins.arm.prot: unknown key 'prot'; did you mean 'port'?",
        ]

    def test_problems_of_the_plugin_point_to_where_it_is_named(self, fleets: Fleets) -> None:
        robots = fleets.load(self.TEXT).robots

        assert [
            str(robots["r1"].plugins["arm"].problem((), "is unknown")),
            str(robots["r2"].plugins["servo"].problem((), "is unknown")),
        ] == [
            "f.yaml:4:31: robots.r1.plugins.arm: is unknown",
            "f.yaml:7:18: robots.r2.plugins.servo: is unknown",
        ]


NOT_A_NAME = "is not a name: a name is a letter (A-Z, a-z), then letters, digits, '_', '.' or '-'"
A_FILE_S, IN_RECORDS = "a robot's name must not end in", ", as the files in a run's record do"
NO_PLUGINS = "the robot has no plugins; give it one under 'plugins', or a type that has one"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name: f", ["1:1: robots: the fleet has no robots; name at least one under 'robots'"]),
        ("robots: {}", ["2:9: robots: the fleet has no robots; name at least one under 'robots'"]),
        ("robots: []", ["2:9: robots: must be a mapping, not a list"]),
        ("robots: {r: {}}", [f"2:10: robots.r: {NO_PLUGINS}"]),
        (f"robots: {{summary.json: {{{PLUGINS}}}}}", [f"2:10: robots.summary.json: {A_FILE_S} .json{IN_RECORDS}"]),
        (
            f"robots: {{'r{{n}}.mcap': {{count: 2, {PLUGINS}}}}}",
            [f"2:10: robots.r{{n}}.mcap: {A_FILE_S} .mcap{IN_RECORDS}"],
        ),
        ("types: {t: {}}\nrobots: {r: {type: t}}", [f"3:10: robots.r: {NO_PLUGINS}"]),
        ("robots: {r: {plugins: {}}}", [f"2:10: robots.r: {NO_PLUGINS}"]),
        (
            "types: {roomba: {}}\nrobots: {r: {type: romba}}",
            ["3:20: robots.r.type: unknown type 'romba'; did you mean 'roomba'?"],
        ),
        (
            f"types: {{a: {{type: bb}}, bbb: {{}}}}\nrobots: {{r: {{{PLUGINS}}}}}",
            ["2:19: types.a.type: unknown type 'bb'; did you mean 'bbb'?"],
        ),
        (
            f"types: {{a: {{type: b}}, b: {{type: a}}, c: {{type: a}}}}\nrobots: {{r: {{type: c, {PLUGINS}}}}}",
            ["2:19: types.a.type: type loop: a -> b -> a"],
        ),
        (
            f"types: {{a: {{type: a}}}}\nrobots: {{r: {{type: a, {PLUGINS}}}}}",
            ["2:19: types.a.type: type loop: a -> a"],
        ),
        (
            f"robots: {{'b{{n}}': {{count: 2, range: [1, 2], {PLUGINS}}}}}",
            ["2:29: robots.b{n}.range: give either 'count' or 'range', not both"],
        ),
        (
            f"robots: {{b: {{count: 2, {PLUGINS}}}}}",
            ["2:10: robots.b: several robots need {n} in their name; write 'b{n}'"],
        ),
        (
            f"robots: {{'b{{n}}': {{{PLUGINS}}}}}",
            ["2:10: robots.b{n}: the name holds {n}, but neither 'count' nor 'range' is given"],
        ),
        (
            f"robots: {{'b{{n}}': {{count: null, {PLUGINS}}}}}",
            ["2:10: robots.b{n}: the name holds {n}, but neither 'count' nor 'range' is given"],
        ),
        (
            "robots: {'b{n}': {count: 3, type: t}}",
            ["2:35: robots.b{n}.type: unknown type 't'"],
        ),
        (
            f"robots: {{'b{{n}}': {{count: 2, {PLUGINS}}}, b2: {{{PLUGINS}}}}}",
            ["2:48: robots.b2: the robot 'b2' is there already, from f.yaml:2"],
        ),
        (
            f"robots: {{'b{{n}}': {{range: [3, 1], {PLUGINS}}}}}",
            ["2:26: robots.b{n}.range: runs backwards; write [1, 3]"],
        ),
        (
            f"robots: {{'b{{n}}': {{range: [1, 10001], {PLUGINS}}}}}",
            ["2:26: robots.b{n}.range: makes more than 10000 robots"],
        ),
        (
            f"robots: {{'b{{n}}': {{range: [-1, x], {PLUGINS}}}}}",
            [
                "2:27: robots.b{n}.range[0]: must be at least 0, not -1",
                "2:31: robots.b{n}.range[1]: must be a whole number, not 'x'",
            ],
        ),
        (f"robots: {{'b{{n}}': {{range: [1], {PLUGINS}}}}}", ["2:26: robots.b{n}.range[1]: is missing"]),
        (
            f"robots: {{'b{{n}}': {{count: 1000000000, {PLUGINS}}}}}",
            ["2:26: robots.b{n}.count: must be at most 10000, not 1000000000"],
        ),
        (f"robots: {{'b{{n}}': {{count: 0, {PLUGINS}}}}}", ["2:26: robots.b{n}.count: must be at least 1, not 0"]),
        (f"robots: {{1st: {{{PLUGINS}}}}}", [f"2:10: robots.1st: '1st' {NOT_A_NAME}, with {{n}} for a number"]),
        ("robots: {r: {plugins: {a/b: {}}}}", [f"2:24: robots.r.plugins.a/b: 'a/b' {NOT_A_NAME}"]),
        ("robots: {r: {plugins: {s: }}}", ["2:26: robots.r.plugins.s: must be a mapping; write {} for an empty one"]),
        (
            f"robots: {{r: {{{PLUGINS}, timout_s: 5}}}}",
            ["2:32: robots.r.timout_s: unknown key 'timout_s'; did you mean 'timeout_s'?"],
        ),
        (
            f"plugin_dirs: [nowhere]\nrobots: {{r: {{{PLUGINS}}}}}",
            ["2:15: plugin_dirs[0]: no such folder: nowhere"],
        ),
        (
            f"world: worlds/labb.yaml\nrobots: {{r: {{{PLUGINS}}}}}",
            ["2:8: world: no such file: worlds/labb.yaml; did you mean 'lab.yaml'?"],
        ),
        (
            "include: [comon.yaml]\nrobots: {r: {type: perhaps_there}}",
            ["2:11: include[0]: no such file: comon.yaml; did you mean 'common.yaml'?"],
        ),
    ],
)
def test_what_is_wrong_with_a_fleet(fleets: Fleets, text: str, expected: list[str]) -> None:
    fleets.write("common.yaml", "version: 1\n")
    fleets.write("worlds/lab.yaml", "version: 1\n")

    assert fleets.problems(text) == [f"f.yaml:{line}" for line in expected]


def test_five_mistakes_are_five_problems(fleets: Fleets) -> None:
    assert fleets.problems("""clock: {rate: -1}
seeed: 7
types: {roomba: {plugins: {sim: {}}}}
robots:
  r1: {type: rooomba}
  r2: {}
  r3: {type: roomba, restart: allways}
""") == [
        "f.yaml:2:15: clock.rate: must be over 0 or 'max', not -1",
        "f.yaml:3:1: seeed: unknown key 'seeed'; did you mean 'seed'?",
        "f.yaml:6:14: robots.r1.type: unknown type 'rooomba'; did you mean 'roomba'?",
        f"f.yaml:7:3: robots.r2: {NO_PLUGINS}",
        ("f.yaml:8:31: robots.r3.restart: must be 'permanent', 'transient' or 'temporary', not 'allways'"),
    ]


def test_problems_of_all_files_are_told_together(fleets: Fleets) -> None:
    fleets.write("part.yaml", "version: 3\nnmae: x\n")
    fleets.write("room.yaml", "version: 1\nname: room\nsize_m: [1]\n")
    fleets.write("broken.yaml", "version: [\n")

    assert fleets.problems(
        "include: [part.yaml, broken.yaml]\nworld: room.yaml\nrobots: {r: {type: t}}\nseed: x\n"
    ) == [
        (
            "broken.yaml:2:1: not valid YAML: expected the node content, but found '<stream end>', "
            "while parsing a flow node from line 2"
        ),
        "f.yaml:5:7: seed: must be a whole number, not 'x'",
        "part.yaml:1:10: version: must be 1, not 3",
        "part.yaml:2:1: nmae: unknown key 'nmae'; did you mean 'name'?",
        "room.yaml:3:9: size_m[1]: is missing",
    ]


def test_an_include_loop_is_shown(fleets: Fleets) -> None:
    fleets.write("a.yaml", "version: 1\ninclude: [parts/b.yaml]\n")
    fleets.write("parts/b.yaml", "version: 1\ninclude: [../a.yaml]\n")

    assert fleets.problems(f"include: [a.yaml]\nrobots: {{r: {{{PLUGINS}}}}}") == [
        "parts/b.yaml:2:11: include[0]: include loop: a.yaml -> parts/b.yaml -> parts/../a.yaml"
    ]


def test_a_missing_variable_is_told_at_its_place(fleets: Fleets) -> None:
    assert fleets.problems("robots:\n  r:\n    plugins:\n      s:\n        port: ${PORT}\n") == [
        (
            "f.yaml:6:15: robots.r.plugins.s.port: the environment variable PORT is not set; "
            "set it, or give a default: ${PORT:-default}"
        )
    ]
