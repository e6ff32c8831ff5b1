"""`eal branch`, `eal bisect` and the page of `eal diff`: the past to the bit, and another future."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import eal_actors
from eal_actors.device.navigation.grid import FREE, GridOrigin, OccupancyGrid
from eal_actors.device.navigation.map_file import save_map
from eal_actors.recording import RunFolder, first_difference
from eal_actors.recording.mcap_file import read_mcap

FLEET = """\
    version: 1
    name: pair
    seed: 3
    clock: {rate: max}
    robots:
      ann: {plugins: {sim: {model: roomba, start: {x_m: -1, y_m: 0}, faults: [{at_s: 1.5, dead: true}]}}}
      bob: {plugins: {sim: {model: evbot3, start: {x_m: -1, y_m: 1}}}}
"""

SCENARIO = """\
    version: 1
    name: legs
    parameters: {leg_m: {type: double, default: 0.2, minimum: 0.1, maximum: 1}}
    roles: {all: {}}
    timeout_s: 4
    on_failure: drop
    steps:
      - on: all
        do:
          - repeat: 3
            do:
              - send_cmd: {resource: Base, cmd: "f${leg_m}"}
              - send_cmd: {resource: Base, cmd: l30}
"""


@pytest.fixture
def run(eal: Any, write: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run in which ann dies at 1.5 s."""
    monkeypatch.chdir(tmp_path)
    write("legs.yaml", SCENARIO), write("pair.yaml", FLEET)
    assert eal("run", "legs.yaml", "--fleet", "pair.yaml", "--no-plot", "--strict").exit_code == 1
    (made,) = (tmp_path / "runs").iterdir()
    return made


@pytest.mark.parametrize("kept", [slice(0, 0), slice(1, None)])
def test_events_without_their_beginning_are_refused(eal: Any, run: Path, kept: slice) -> None:
    file = run / "events.jsonl"
    file.write_text("".join(file.read_text().splitlines(keepends=True)[kept]))
    refused = eal("branch", run, "--at", "1", "--set", "leg_m=0.1")
    assert refused.exit_code != 0
    assert "does not begin with the event run_started" in " ".join(refused.output.replace("│", " ").split())


def events_before(run: Path, time_s: float) -> list[str]:
    lines = (run / "events.jsonl").read_text().splitlines()[1:]  # the first one names the files
    return [line for line in lines if json.loads(line)["time_s"] < time_s]


def samples_before(run: Path, time_s: float) -> list[tuple[str, float, Any]]:
    """Return all recorded poses and transforms before a time."""
    found = [one for one in read_mcap(run / "run.mcap").messages if one.time_s < time_s]
    poses = [one for one in found if one.topic == "/tf" or one.topic.endswith("Pose")]
    return sorted(((one.topic, one.time_s, one.message) for one in poses), key=lambda one: one[:2])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--at", "99", "--set", "leg_m=0.1"], "'--at': the run lasted"),
        (["--at", "1", "--without-fault", "stuck_left"], "'--without-fault': the run has no fault 'stuck_left'; its"),
        (["--at", "1", "--with-fault", "ann.dead=[1"], "'--with-fault': ann.dead has no value: '[1' is no YAML"),
        (
            ["--at", "1", "--with-fault", "carl.dead"],
            "'--with-fault': 'carl.dead': faults can be injected into ann, bob",
        ),
    ],
)
def test_a_refusal_names_the_option(eal: Any, run: Path, options: list[str], message: str) -> None:
    refused = eal("branch", run, *options)
    assert refused.exit_code == 2
    assert message in " ".join(refused.stderr.replace("│", " ").split())


def test_a_branch_without_the_fault_has_the_same_past_and_ends_well(eal: Any, run: Path, tmp_path: Path) -> None:
    result = eal("branch", run, "--at", "1.2", "--without-fault", "ann.dead", "--json")
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    made = Path(facts["run"])
    assert samples_before(run, 1.2) == samples_before(made, 1.2)  # copied at first, then sampled at the same times
    assert len(samples_before(run, 0.2)) > 5
    assert facts["outcome"] == "done"
    assert events_before(run, 1.2) == events_before(made, 1.2)
    assert "ann at 1.6" in facts["first_difference"]
    page = tmp_path / "difference.html"
    shown = eal("diff", run, made, "--page", page)
    assert shown.exit_code == 1
    assert f"{made.name}: done after" in shown.stdout
    assert "<svg" in page.read_text()
    assert "ann B" in page.read_text()

    before = set((tmp_path / "runs").iterdir())
    refused = eal("branch", run, "--at", "1.2", "--with-fault", "bob.deaf")
    assert refused.exit_code == 2
    assert "unknown key 'deaf'; did you mean 'dead'?" in refused.output
    assert set((tmp_path / "runs").iterdir()) == before, "what is refused leaves no folder"
    (tmp_path / "empty").mkdir()
    refused = eal("branch", tmp_path / "empty", "--at", "1", "--set", "leg_m=0.1")
    assert refused.exit_code == 2
    assert "is no folder of a run: it has no events.jsonl" in " ".join(refused.output.replace("│", " ").split())
    assert first_difference(RunFolder.open(run), RunFolder.open(run)) is None

    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps({**summary, "rate": 2.0}))
    refused = eal("branch", run, "--at", "1", "--set", "leg_m=0.1")
    assert refused.exit_code != 0
    assert "only a run with --rate max repeats" in " ".join(refused.output.split())


@pytest.mark.slow
def test_a_branch_changes_parameters_faults_and_the_scenario(eal: Any, run: Path, write: Any) -> None:
    made = json.loads(eal("branch", run, "--at", "1", "--set", "leg_m=0.1", "--json").stdout)
    assert "'send_cmd Base f0.2', now 'send_cmd Base f0.1'" in made["first_difference"]
    made = json.loads(eal("branch", run, "--at", "1", "--with-fault", "bob.stuck_left", "--json").stdout)
    assert "at 1.000 s" in made["first_difference"]
    other = write("other.yaml", SCENARIO.replace("l30", "l60"))
    made = json.loads(eal("branch", run, "--at", "0.5", "--scenario", other, "--json").stdout)
    assert "l60" in made["first_difference"]
    late = eal("branch", run, "--at", "1.4", "--scenario", other)
    assert late.exit_code != 0
    assert "the past of the branch" in " ".join(late.output.split())


@pytest.mark.slow
def commit(repository: Path, title: str, *names: str) -> None:
    """Commit files, or all of them, to a repository, which is made first."""
    identity = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    for words in (
        ("init", "-q"),
        (
            "add",
            *(names or "."),
        ),
        (*identity, "commit", "-q", "-m", title),
    ):
        subprocess.run(["git", *words], cwd=repository, check=True)


def test_bisect_finds_the_commit_that_changed_the_record(eal: Any, run: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "legs.yaml"
    for number in range(6):
        text = scenario.read_text()
        text = text.replace("l30", "l45") if number == 3 else text + f"# comment {number}\n"
        scenario.write_text(text)
        commit(tmp_path, f"change {number}", "legs.yaml")
    result = eal("bisect", run, "--good", "HEAD~5", "--bad", "HEAD")
    assert result.exit_code == 1, result.output
    assert "change 3" in result.stdout
    assert "'send_cmd Base l30', now 'send_cmd Base l45'" in " ".join(result.stdout.split())


def test_bisect_runs_the_framework_of_each_commit(
    eal: Any, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The working directory is the framework's repository, whose own files are those of the newest commit."""
    repository = tmp_path / "framework"
    package = repository / "eal_actors"
    package.mkdir(parents=True)
    real = Path(eal_actors.__file__).parent
    content = f"import sys\n__path__ = [{str(real)!r}]\nexec(open({str(real / '__init__.py')!r}).read())\n"
    (package / "__main__.py").write_text((real / "__main__.py").read_text())
    for number in range(3):
        changed = f"sys.argv += ['--seed', '9']  # {number}\n" if number else ""
        (package / "__init__.py").write_text(content + changed)
        commit(repository, f"change {number}")
    monkeypatch.chdir(repository)
    result = eal("bisect", run, "--good", "HEAD~2", "--bad", "HEAD")
    assert result.exit_code == 1, result.output
    assert "change 1" in result.stdout
    assert "seed" in result.stdout


STEPS = """\
    def greet(context):
        context.log("hello")
"""


def test_a_run_with_a_map_and_python_steps_repeats(
    eal: Any, write: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are beside the fleet file, and not beside the copy in the run's folder."""
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path / "sub")
    save_map(OccupancyGrid(np.full((80, 80), FREE, np.int8), 0.05, GridOrigin(-2.0, -2.0)), tmp_path / "floor.yaml")
    text = SCENARIO.replace("{leg_m: ", "{quick: {type: bool, default: true}, leg_m: ") + "      - python: ms:greet\n"
    write("legs.yaml", text), write("other.yaml", f"{text}# the same\n")
    write("pair.yaml", FLEET + "    map: floor.yaml\n    python_steps: [ms:greet]\n"), write("ms.py", STEPS)
    done = eal("run", tmp_path / "legs.yaml", "--fleet", tmp_path / "pair.yaml", "--no-plot", "--bind", "all=bob")
    assert done.exit_code == 0, done.output
    (run,) = Path("runs").iterdir()
    done = eal("branch", run, "--at", "1", "--set", "leg_m=0.3")
    assert done.exit_code == 0, done.output
    done = eal("bisect", run, "--good", tmp_path / "legs.yaml", "--bad", tmp_path / "other.yaml")
    assert done.exit_code == 0, done.output
    assert "no difference" in done.stdout
    commit(tmp_path, "good", "legs.yaml", "ms.py")
    write("ms.py", STEPS.replace("hello", "bye"))
    commit(tmp_path, "bad", "ms.py")
    done = eal("bisect", run, "--good", "HEAD~1", "--bad", "HEAD")  # in a folder of the repository
    assert done.exit_code == 1, done.output
    assert "'hello', now 'bye'" in done.stdout


TRACKED = """\
    version: 1
    name: tracked
    include: [ceiling]
    seed: 2
    clock: {rate: max}
    world: hall
    robots:
      ann: {type: roomba, pose: {marker: 10}, plugins: {sim: {start: {x_m: -1, y_m: 0}}}}
"""


@pytest.mark.slow
def test_a_branch_draws_no_picture_of_its_past_again(
    eal: Any, write: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tracker's pictures took 12.2 of the 13.7 s of a branch."""
    monkeypatch.chdir(tmp_path)
    write("legs.yaml", SCENARIO.replace("repeat: 3", "repeat: 8")), write("tracked.yaml", TRACKED)
    searched: list[Any] = []
    convert = cv2.cvtColor

    def counted(picture: Any, code: int) -> Any:
        searched.append(code)  # each picture that is searched becomes grey first
        return convert(picture, code)

    monkeypatch.setattr(cv2, "cvtColor", counted)
    result = eal("run", "legs.yaml", "--fleet", "tracked.yaml", "--no-plot", "--bind", "all=ann")
    assert result.exit_code == 0, result.output
    (run,) = (tmp_path / "runs").iterdir()
    pictures = searched.count(cv2.COLOR_BGR2GRAY)
    assert pictures > 8

    def branch(at_s: float, change: str) -> Any:
        searched.clear()
        result = eal("branch", run, "--at", at_s, "--set", f"leg_m={change}", "--json")
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    same = branch(8.0, "0.2")
    assert same["first_difference"] is None  # every bit after the change is that of a run that draws all
    assert searched.count(cv2.COLOR_BGR2GRAY) < pictures / 2
    other = branch(8.0, "0.4")
    assert "now 'send_cmd Base f0.4'" in other["first_difference"]
    again = json.loads(eal("branch", same["run"], "--at", "8", "--set", "leg_m=0.4", "--json").stdout)
    assert first_difference(RunFolder.open(Path(other["run"])), RunFolder.open(Path(again["run"]))) is None
