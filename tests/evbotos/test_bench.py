"""`evbotos bench` and `evbotos times`: the thesis's tables with current results."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos.bench import BOARDS, OPERATIONS, Benchmark, read_results, run_by, run_here
from evbotos.bench_chart import draw_chart
from evbotos.bench_command import bench, times
from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.model import Local
from tests.evbotos.proof import require_tools

LINES: list[dict[str, object]] = [
    {"engine": "Octave 7.3.0"},
    *({"operation": name, "seconds": 0.5} for name in OPERATIONS),
]


def printed(lines: list[dict[str, object]]) -> str:
    return "".join(f"{json.dumps(line)}\n" for line in lines)


def test_the_boards_are_those_of_the_thesis() -> None:
    totals = {name: round(sum(seconds), 2) for name, seconds in BOARDS.items()}
    assert totals == {"MZ104": 8831.96, "SBC1496": 10978.63, "BeagleBoard": 2531.25}  # as the table itself says
    assert all(len(seconds) == len(OPERATIONS) for seconds in BOARDS.values())


def test_numpy_computes_all_operations_and_every_answer_is_examined() -> None:
    pytest.importorskip("numpy")
    measured = run_here("numpy", 60, sys.executable, 100)
    assert measured.engine.startswith("numpy ")
    assert list(measured.seconds) == list(OPERATIONS)
    assert all(0 < seconds < 60 for seconds in measured.seconds.values())
    assert measured.total_s == pytest.approx(sum(measured.seconds.values()))


def test_octave_computes_all_operations() -> None:
    if find_tool("octave-cli") is None:
        pytest.skip("octave-cli is not installed on this machine; the octave image has it")
    measured = run_here("octave", 60, "octave-cli", 100)
    assert list(measured.seconds) == list(OPERATIONS)


def test_results_are_read() -> None:
    measured = read_results(printed(LINES), 1000, "a board")
    assert measured == Benchmark("Octave 7.3.0", "a board", 1000, dict.fromkeys(OPERATIONS, 0.5))
    assert measured.as_json()["thesis"]["boards"]["BeagleBoard"]["lu"] == 105.51


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the benchmark is incomplete"),
        (printed(LINES[:-1]), "missing: rank"),
        (printed(LINES[1:]), "missing: the engine"),
        ("h\n", "printed an invalid line: 'h'"),  # all that the thesis's first Octave ever answered, table 3.1
        ('{"operation": "lu"}\n', "invalid line"),
    ],
)
def test_what_is_no_result_is_told(text: str, words: str) -> None:
    with pytest.raises(BuildError, match=re.escape(words)):
        read_results(text, 10, "here")


def test_a_failing_engine_is_told_with_its_words() -> None:
    with pytest.raises(BuildError, match="no-such-octave is not installed"):
        run_here("octave", 10, "no-such-octave", 10)
    failing = "import sys; sys.exit('inverse: wrong result: its error is 1')"
    with pytest.raises(BuildError, match="the benchmark failed: inverse: wrong result"):
        run_by([sys.executable, "-c", failing], None, 10, "here", 60)


def test_a_wrong_answer_ends_the_benchmark(tmp_path: Path) -> None:
    """A numpy whose inverse is wrong, as a broken library would compute it."""
    pytest.importorskip("numpy")
    script = tmp_path / "broken.py"
    script.write_text(
        "import sys, numpy\n"
        "right = numpy.linalg.inv\n"
        "numpy.linalg.inv = lambda a: right(a) * 1.001\n"
        "from evbotos.benchmark import numpy_engine\n"
        "numpy_engine.main(40)\n"
    )
    root = Path(__file__).parents[2]
    code = f"import sys, runpy; sys.path.insert(0, {str(root)!r}); runpy.run_path({str(script)!r})"
    with pytest.raises(BuildError, match="inverse: wrong result"):
        run_by([sys.executable, "-c", code], None, 40, "here", 60)


@pytest.mark.parametrize("ending", ["svg", "png"])
def test_a_chart_is_drawn(tmp_path: Path, ending: str) -> None:
    pytest.importorskip("matplotlib")
    path = tmp_path / f"chart.{ending}"
    draw_chart(read_results(printed(LINES), 1000, "a board"), path)
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG" if ending == "png" else b"<?xml")
    if ending == "svg":
        draw_chart(read_results(printed(LINES), 1000, "a board"), path)
        assert path.read_bytes() == content


def test_the_command_shows_the_table_and_keeps_the_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("numpy")
    pytest.importorskip("matplotlib")
    bench(engine="numpy", n=50, output=tmp_path)
    said = capsys.readouterr().out
    assert "8831.96" in said
    assert "not comparable" in said
    kept = json.loads((tmp_path / "bench-numpy-50.json").read_text())
    assert kept["n"] == 50
    assert list(kept["seconds"]) == list(OPERATIONS)
    assert (tmp_path / "bench-numpy-50.svg").is_file()


def test_an_image_that_is_not_built_is_told(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="evbotos build qemu-amd64 octave"):
        bench(in_image=True, output=tmp_path)


def test_build_times_stand_beside_the_thesis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BuildError, match="nothing is built in"):
        times(output=tmp_path)
    steps = [
        {"name": "kernel", "key": "1", "seconds": 0.0, "cached": True, "made_s": 749.4},
        {"name": "squash", "key": "2", "seconds": 21.5, "cached": False},
    ]
    (tmp_path / "a-robot").mkdir()
    manifest = {"platform": "a", "image": "robot", "steps": steps}
    (tmp_path / "a-robot/manifest.json").write_text(json.dumps(manifest))
    times(output=tmp_path)
    said = capsys.readouterr().out
    assert "(749.4)" in said
    assert "770.9" in said
    assert "21.5" in said
    assert "7:38:51" in said
    times(output=tmp_path, as_json=True)
    assert json.loads(capsys.readouterr().out)["thesis"]["BeagleBoard"] == [28227, 4718]


@pytest.mark.slow
@pytest.mark.evbotos
@pytest.mark.timeout(1200)
def test_the_octave_image_runs_the_benchmark(tmp_path: Path) -> None:
    found = load_definitions()
    platform, image = found.platform("qemu-amd64"), found.image("octave")
    require_tools(platform)
    Build(platform, image, Local(version=1), found.lock_path(platform, image), get_logger().info).run(tmp_path)
    bench(engine="octave", n=100, in_image=True, output=tmp_path)
    kept = json.loads((tmp_path / "bench-octave-100-qemu-amd64.json").read_text())
    assert kept["engine"].startswith("Octave ")
    assert list(kept["seconds"]) == list(OPERATIONS)
