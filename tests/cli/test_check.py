"""`eal check` and `eal schema`."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.yaml_source import load_yaml


def shipped(pattern: str) -> list[Path]:
    root = bundled_path(".")
    return sorted(root.glob(pattern))


SHIPPED = {"fleet": "fleets/*.yaml", "scenario": "scenarios/*.yaml", "world": "fleets/worlds/*.yaml"}


@pytest.mark.parametrize("kind", SHIPPED)
def test_everything_shipped_is_right_and_told_by_its_content(eal: Any, kind: str) -> None:
    files = shipped(SHIPPED[kind])
    assert files
    result = eal("check", *files)
    assert result.exit_code == 0
    assert result.stderr == ""
    for file, line in zip(files, result.stdout.splitlines(), strict=True):
        assert line.startswith(f"{file}: ok ({kind}, ")


@pytest.mark.parametrize("kind", SHIPPED)
def test_the_schema_takes_what_is_shipped_and_refuses_unknown_keys(eal: Any, kind: str) -> None:
    schema = json.loads(eal("schema", kind).stdout)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    for file in shipped(SHIPPED[kind]):
        content = load_yaml(file).root
        assert list(validator.iter_errors(content)) == []
        assert list(validator.iter_errors({**content, "no_such_key": 1}))


def test_the_schema_of_manifests_takes_those_of_bundled_plugins(eal: Any) -> None:
    validator = jsonschema.Draft202012Validator(json.loads(eal("schema", "plugin").stdout))
    for file in bundled_path("plugins").glob("*/plugin.yaml"):
        assert list(validator.iter_errors(load_yaml(file).root)) == []


def test_the_summary_counts(eal: Any, slides: Path, move: Path) -> None:
    lines = eal("check", slides, move, bundled_path("fleets/worlds/lab.yaml")).stdout.splitlines()
    assert lines[0] == f"{slides}: ok (fleet, 2 robots)"
    assert lines[1] == f"{move}: ok (scenario, 1 role, 1 step)"
    assert lines[2].endswith("ok (world, 8 x 6 m, 5 obstacles, 1 box, 1 beacon, 8 posters, 2 lamps, 3 places)")


def told(output: str) -> list[str]:
    """Return the lines of an output without the excerpts of files."""
    return [line for line in output.splitlines() if not line.startswith("    ")]


def test_a_start_outside_the_world_is_a_problem(eal: Any, write: Any) -> None:
    start = "{plugins: {sim: {model: roomba, start: {x_m: %s, y_m: 0}}}}"
    fleet = write("far.yaml", f"version: 1\nworld: lab\nrobots:\n  a: {start % 3.8}\n  b: {start % -3.9}\n")
    result = eal("check", fleet)
    assert result.exit_code == 2
    where, what = told(result.stdout)[0].split(": ", 1)
    assert len(told(result.stdout)) == 1
    assert where == f"{fleet}:5:45"
    assert what == (
        "robots.b.plugins.sim.start: robot 'b' cannot start at x -3.9 m, y 0 m: the world 'lab' reaches from -4 to 4 m "
        "in x and from -3 to 3 m in y"
    )


def test_starts_inside_each_other_and_outside_the_default_room_are_problems(eal: Any, write: Any) -> None:
    robot = "{plugins: {sim: {model: roomba, start: {x_m: %s, y_m: 0}}}}"
    served = "{address: tcp/127.0.0.1:%s, plugins: {sim: {model: roomba, start: {x_m: 1, y_m: 0}}}}"
    robots = {"a": robot % 0, "b": robot % 0.1, "c": robot % 3, "d": served % 50001, "e": served % 50002}
    lines = "".join(f"  {name}: {text}\n" for name, text in robots.items())
    fleet = write("close.yaml", f"version: 1\nrobots:\n{lines}")
    result = eal("check", fleet)
    assert result.exit_code == 2
    start, room = (
        "plugins.sim.start: robot",
        "the world 'empty-room' reaches from -3 to 3 m in x and from -2 to 2 m in y",
    )
    assert told(result.stdout) == [
        f"{fleet}:4:45: robots.b.{start} 'b' cannot start at x 0.1 m, y 0 m: it would touch robot 'a'",
        f"{fleet}:5:45: robots.c.{start} 'c' cannot start at x 3 m, y 0 m: {room}",
    ]


def test_a_start_in_an_obstacle_is_a_problem(eal: Any, write: Any) -> None:
    write("w.yaml", "version: 1\nname: w\nsize_m: [4, 4]\nobstacles: [{kind: circle, x_m: 1, y_m: 0, radius_m: 0.2}]\n")
    robot = "{plugins: {sim: {model: roomba, start: {x_m: 1, y_m: 0.2}}}}"
    result = eal("check", write("in.yaml", f"version: 1\nworld: w.yaml\nrobots:\n  a: {robot}\n"))
    assert "cannot start at x 1 m, y 0.2 m: it would touch obstacles[0] (circle at x 1 m, y 0 m)" in result.stdout


def test_problems_are_sorted_and_good_files_are_still_told(eal: Any, write: Any, slides: Path) -> None:
    world = write("b_world.yaml", "version: 1\nname: w\nsize_m: [1, -2]\n")
    fleet = write(
        "a_fleet.yaml",
        "version: 1\nrobots:\n  a: {plugins: {sim: {model: rooomba, nix: 3}}}\n  b: {plugins: {sampel: {}}}\n",
    )
    nowhere = world.parent / "c.yaml"
    result = eal("check", world, nowhere, fleet, slides)
    assert result.exit_code == 2
    lines = told(result.stdout)
    assert lines[0] == f"{slides}: ok (fleet, 2 robots)"
    assert [line.split(": ")[:2] for line in lines[1:4]] == [
        [f"{fleet}:3:30", "robots.a.plugins.sim.model"],
        [f"{fleet}:3:39", "robots.a.plugins.sim.nix"],
        [f"{fleet}:4:17", "robots.b.plugins.sampel"],
    ]
    assert lines[4:] == [f"{world}:3:13: size_m[1]: must be at least 0.001, not -2", f"{nowhere}: no such file"]
    assert result.stderr == "5 problems in 3 files\n"


def test_plugins_are_checked_beside_the_invalid_values_of_a_fleet(eal: Any, write: Any) -> None:
    fleet = write(
        "fleet.yaml",
        "version: 1\nname: 3\nclock: {rate: fast}\nrobots:\n  a: {tags: indoor, plugins: {simm: {}}}\n"
        "  b: {plugins: {sim: {model: evbot9}}}\n  c: {plugins: 3}\n"
        "  d: {plugins: {sim: {model: roomba, x: 1}}, tag: 1}\n",
    )
    result = eal("check", fleet)
    assert result.exit_code == 2
    assert [line.split(": ")[:2] for line in told(result.stdout)] == [
        [f"{fleet}:2:7", "name"],
        [f"{fleet}:3:15", "clock.rate"],
        [f"{fleet}:5:13", "robots.a.tags"],
        [f"{fleet}:5:31", "robots.a.plugins.simm"],
        [f"{fleet}:6:30", "robots.b.plugins.sim.model"],
        [f"{fleet}:7:16", "robots.c.plugins"],
        [f"{fleet}:8:38", "robots.d.plugins.sim.x"],
        [f"{fleet}:8:46", "robots.d.tag"],
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("version: 1\nname: what\n", "unknown kind of file: a fleet has robots"),
        ("- a\n- b\n", "the top level must be a mapping"),
        ("robots: {a: {plugins: {}}\n", ":"),
    ],
)
def test_what_is_no_file_of_ours_is_a_problem(eal: Any, write: Any, text: str, words: str) -> None:
    result = eal("check", write("x.yaml", text))
    assert result.exit_code == 2
    assert words in result.stdout


def test_json_gives_every_part_of_a_problem(eal: Any, write: Any) -> None:
    world = write("w.yaml", "version: 1\nname: w\nsize_m: [1, -2]\n")
    result = eal("check", world, "--json")
    assert result.exit_code == 2
    (file,) = json.loads(result.stdout)["files"]
    assert (file["file"], file["kind"]) == (str(world), "world")
    assert file["problems"] == [
        {"file": str(world), "line": 3, "column": 13, "path": "size_m[1]", "message": "must be at least 0.001, not -2"}
    ]


def test_a_plugin_that_cannot_be_imported_here_is_a_warning(eal: Any, slides: Path) -> None:
    manifest = slides.parent / "plugins" / "slide" / "plugin.yaml"
    manifest.write_text(manifest.read_text(encoding="utf-8") + "requires: [no_such_module]\n", encoding="utf-8")
    result = eal("check", slides)
    assert result.exit_code == 0
    assert result.stdout == f"{slides}: ok (fleet, 2 robots)\n"
    assert result.stderr == "warning: plugin 'slide' needs no_such_module: pip install no_such_module\n"


BROKEN = {
    "a syntax error": ("(", "fails to import: SyntaxError"),
    "an error as it is imported": ("raise OSError('no licence')", "fails to import: OSError: no licence"),
    "no code": (None, "has no plugin.py"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_plugin_that_no_machine_can_import_is_a_problem(eal: Any, slides: Path, fault: str) -> None:
    code, words = BROKEN[fault]
    file = slides.parent / "plugins" / "slide" / "plugin.py"
    file.unlink()
    if code is not None:
        file.write_text(code, encoding="utf-8")
    result = eal("check", slides)
    assert result.exit_code == 2
    one, two = told(result.stdout)
    assert one.startswith(f"{slides}:5:33: robots.one.plugins.slide: plugin 'slide' {words}")
    assert two.startswith(f"{slides}:6:19: robots.two.plugins.slide: ")
    assert result.stderr == "2 problems in 1 file\n"


def test_a_manifest_is_checked_by_another_command(eal: Any, slides: Path) -> None:
    folder = slides.parent / "plugins" / "slide"
    result = eal("check", folder / "plugin.yaml")
    assert result.exit_code == 2
    assert result.stdout == f"{folder / 'plugin.yaml'}: a plugin: use `eal plugin check {folder}`\n"


def test_names_are_checked_as_paths_are(eal: Any, write: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    done = eal("check", "sim", "search")
    assert done.exit_code == 0
    files = [line.partition(": ")[0].removeprefix(f"{bundled_path('.')}/") for line in done.stdout.splitlines()]
    assert files == ["fleets/sim.yaml", "fleets/search.yaml", "scenarios/search.yaml", "fleets/worlds/search.yaml"]
    Path("sim.yaml").write_text("version: 1\nrobots: {}\nnonsense: 1\n")
    assert "sim.yaml:3:1: nonsense" in eal("check", "sim").stdout  # a file of one's own wins
    done = eal("check", "serch")
    assert done.exit_code == 2
    assert "no file of that name comes with the framework; did you mean 'search'?" in done.stdout


def test_a_scenario_may_run_a_bundled_one(eal: Any, write: Any) -> None:
    steps = "steps:\n  - scenario: dance\n    roles: {dancers: all}\n"
    file = write("outer.yaml", f"version: 1\nname: outer\nroles: {{all: {{}}}}\n{steps}")
    assert eal("check", file).exit_code == 0, eal("check", file).stdout


def test_a_scenario_is_checked_against_the_one_fleet(eal: Any, write: Any) -> None:
    sim = bundled_path("fleets/sim.yaml")
    dance = eal("check", "scenarios/dance.yaml", sim)
    assert dance.exit_code == 0, dance.stdout
    assert dance.stdout.splitlines()[0].endswith("1 step, fits fleet 'sim')")
    steps = """steps:
  - on: ones
    do:
      - send_cmd: {resource: Base, cmd: f0.1}
      - get_value: {resource: Rnge}
      - for: {turn: [10, 20]}
        do: [{send_cmd: {resource: Base, cmd: "q${turn}"}}]
"""
    wrong = write("wrong.yaml", f"version: 1\nname: wrong\nroles: {{ones: {{types: [sim]}}}}\n{steps}")
    fleet = write("own.yaml", "version: 1\nrobots: {one: {type: a}}\ntypes: {a: {plugins: {sim: {model: roomba}}}}\n")
    assert f"{wrong}:3:24: roles.ones.types[0]: " in eal("check", wrong, fleet).stdout
    assert eal("check", wrong, fleet, sim).exit_code == 0  # which of the two it is for is not known
    wrong.write_text(wrong.read_text().replace("[sim]", "[a]"))
    done = eal("check", wrong, fleet)
    assert done.exit_code == 2
    places = dict.fromkeys(line.split(": ")[0] for line in told(done.stdout)[1:])  # q10 and q20 have one place
    assert list(places) == [f"{wrong}:8:31", f"{wrong}:10:47"]


def test_problems_of_one_stage_do_not_hide_those_of_the_next(eal: Any, write: Any) -> None:
    """Unknown keys, variables, roles, robots, resources and settings are found by different stages."""
    text = """version: 1
name: wrong
roles: {all: {}, gone: {robots: [two]}, few: {min: 2}}
steps:
  - on: all
    do:
      - {log: here, colour: red}
      - log: "${nothing}"
      - get_value: {resource: Rnge}
  - on: al
    do: [{log: misspelt}]
  - on: rover-7
    do: [{log: not there}]
"""
    settings = "{model: roomba, colour: red}"
    wrong = write("wrong.yaml", text)
    fleet = write(
        "own.yaml", f"version: 1\nrobots: {{one: {{type: a}}}}\ntypes: {{a: {{plugins: {{sim: {settings}}}}}}}\n"
    )
    done = eal("check", wrong, fleet)
    assert done.exit_code == 2
    assert "own.yaml:3:44: " in done.stdout
    fleet.write_text(fleet.read_text().replace(", colour: red", ""))
    lines = [line.removeprefix(f"{wrong}:") for line in told(eal("check", wrong, fleet).stdout)[1:]]
    assert {line.split(": ")[0]: line.split(": ")[1] for line in lines} == {
        "3:34": "roles.gone.robots[0]",
        "3:41": "roles.few",
        "7:21": "steps[0].do[0].colour",
        "8:17": "steps[0].do[1].log",
        "9:31": "steps[0].do[2].get_value.resource",
        "10:9": "steps[1].on",
        "12:9": "steps[2].on",
    }
    assert "there is no role 'rover-7', so it is a robot, and the fleet 'own' has no robot 'rover-7'" in lines[-1]


def test_a_step_names_its_robot(eal: Any, write: Any) -> None:
    """`scout-1` is no misspelt `scouts`; a robot may have roles, and steps of its own."""
    robots = "{scout-1: {type: a}, scout-2: {type: a}}"
    fleet = write("own.yaml", f"version: 1\nrobots: {robots}\ntypes: {{a: {{plugins: {{sim: {{model: roomba}}}}}}}}\n")
    part = "version: 1\nname: part\nsteps: [{on: scout-1, do: [{send_cmd: {resource: Base, cmd: l90}}]}]\n"
    write("part.yaml", part)
    steps = "steps: [{on: scout-2, do: [{send_cmd: {resource: Base, cmd: f0.1}}]}, {scenario: part.yaml}]"
    own = write("named.yaml", f"version: 1\nname: named\nroles: {{scouts: {{}}}}\n{steps}\n")
    assert eal("check", own, fleet).exit_code == 0
    done = eal("run", own, "--fleet", fleet, "--rate", "max", "--json")
    assert done.exit_code == 0, done.stderr
    report = json.loads(done.stdout)
    assert [(step["robot"], step["command"]) for step in report["steps"]] == [("scout-2", "f0.1"), ("scout-1", "l90")]
    alone = write(
        "alone.yaml", own.read_text().replace("{scenario: part.yaml}", "{on: scouts, do: [scenario: part.yaml]}")
    )
    assert "by itself, but it names the robot 'scout-1'" in eal("check", alone).stdout
    nobody = write("nobody.yaml", "version: 1\nname: nobody\nsteps: [{log: x}]\n")
    assert "no robots take part" in eal("check", nobody).stdout


def test_what_cannot_be_simulated_is_said(eal: Any, slides: Path, move: Path) -> None:
    done = eal("check", slides, move)
    assert done.exit_code == 0
    assert f"warning: {move} on {slides}: the calls were not checked: " in done.stderr
