"""`eal tracker print` and `eal calibrate camera`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from eal_actors.lab.markers.prints import BoardSize
from eal_actors.managers.config import EALConfigManager
from tests.cli.conftest import Program
from tests.unit.lab.markers.board_pictures import board_picture, pdf_pixels


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pictures of a board, and one without it."""
    folder = tmp_path_factory.mktemp("board")
    for seed in range(10):
        cv2.imwrite(str(folder / f"{seed}.png"), board_picture(BoardSize(), seed))
    cv2.imwrite(str(folder / "empty.png"), np.full((480, 640), 128, np.uint8))
    return folder


def test_markers_are_printed_to_scale(eal: Program, tmp_path: Path) -> None:
    out = tmp_path / "markers.pdf"
    done = eal("tracker", "print", out, "--ids", "1-2,40", "--size", 60)
    assert done.exit_code == 0, done.output
    assert "1 sheet, print at 100 %" in done.stdout
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    assert sorted(np.ravel(detector.detectMarkers(pdf_pixels(out.read_bytes()))[1])) == [1, 2, 40]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["m.svg", "--ids", "1-30"], "sheets, and an SVG file has one"),
        (["m.png", "--ids", "1"], "ends in .pdf or .svg"),
        (["m.pdf", "--ids", "5-2"], "such as 1-6,40"),
        (["m.pdf", "--ids", "60"], "the markers 0 to 49"),
        (["m.pdf"], "use either --ids or --board"),
        (["m.pdf", "--board", "--squares", "9"], "such as 7x5"),
        (["m.pdf", "--ids", "1", "--paper", "a9"], "use a4, a3, letter"),
        (["m.pdf", "--ids", "1", "--family", "5x5"], "use 4x4_50, 36h11"),
        (["no/such/folder/m.pdf", "--ids", "1"], "cannot be written"),
    ],
)
def test_prints_that_cannot_be_are_refused(
    eal: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = eal("tracker", "print", *arguments)
    assert done.exit_code == 2
    assert problem in " ".join(done.output.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


def test_a_lens_is_found_from_a_folder_of_pictures(eal: Program, pictures: Path) -> None:
    done = eal("calibrate", "camera", pictures)
    assert done.exit_code == 0, done.output
    assert "empty.png: left out, the board is not in it" in done.stdout
    block = done.stdout[done.stdout.index("lens:") : done.stdout.index("10 pictures")]
    assert yaml.safe_load(block)["lens"]["focal_px"] == pytest.approx([512, 512], rel=0.01)


@pytest.mark.slow
def test_a_lens_is_found_with_the_camera_of_a_robot(eal: Program, pictures: Path, tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    source = json.dumps(str(pictures))
    fleet.write_text(
        "version: 1\nname: one\nrobots:\n  eye:\n    plugins:\n"
        f"      camera: {{source: {source}, loop: true, fps: 50}}\n",
        encoding="utf-8",
    )
    done = eal("calibrate", "camera", "--fleet", fleet, "--robot", "eye", "--count", 8, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["pictures"] == 8
    assert found["focal_px"] == pytest.approx([512, 512], rel=0.02)


TRACKED = """\
version: 1
name: hall
robots:
  eyes:  # under the roof
    plugins:
      tracker:
        cameras:
          # The one with the wide lens.
          roof:
            source: 0
            lens:
              size_px: [640, 480]
              focal_px:  # of the data sheet
                - 500.0  # along the columns
                - 500.0
              centre_px: [319.5, 239.5]
          side: {source: 1, lens: {size_px: [640, 480], focal_px: [5, 5], centre_px: [0, 0]}}  # a spare
        markers: [{ids: [1], size_m: 0.1, height_m: 0.1}]
"""


def _lens(file: Path, camera: str) -> dict[str, Any]:
    settings = EALConfigManager.load(file).robot("eyes").plugins["tracker"].settings
    return dict(settings["cameras"][camera]["lens"])


@pytest.mark.parametrize("camera", ["roof", pytest.param("eyes.side", marks=pytest.mark.slow)])
def test_a_lens_is_written_into_the_fleet_file_whose_comments_stay(
    eal: Program, pictures: Path, tmp_path: Path, camera: str
) -> None:
    fleet, name = tmp_path / "hall.yaml", camera.removeprefix("eyes.")
    fleet.write_text(TRACKED, encoding="utf-8")
    done = eal("calibrate", "camera", pictures, "--write", "--fleet", fleet, "--camera", camera, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["file"] == str(fleet)
    assert list(tmp_path.iterdir()) == [fleet]
    lens = _lens(fleet, name)
    assert lens["focal_px"] == pytest.approx(found["focal_px"], abs=0.01)
    assert lens["distortion"] == pytest.approx(found["distortion"], abs=1e-6)
    text = fleet.read_text(encoding="utf-8")
    for comment in ("# under the roof", "# The one with the wide lens.", "# of the data sheet", "# along", "# a spare"):
        assert comment in text
    other = "side" if name == "roof" else "roof"
    assert _lens(fleet, other)["focal_px"] == ([5, 5] if other == "side" else [500, 500])


@pytest.mark.slow
def test_a_lens_of_an_included_file_is_written_beside_the_fleet_file(
    eal: Program, pictures: Path, tmp_path: Path
) -> None:
    (tmp_path / "base.yaml").write_text(
        TRACKED.replace(", lens: {size_px: [640, 480], focal_px: [5, 5], centre_px: [0, 0]}", ""), encoding="utf-8"
    )
    fleet = tmp_path / "hall.yaml"
    fleet.write_text("version: 1\ninclude: [base.yaml]  # ours\n", encoding="utf-8")
    for name in ("roof", "side"):
        done = eal("calibrate", "camera", pictures, "--write", "--fleet", fleet, "--camera", name)
        assert done.exit_code == 0, done.output
        assert f"The lens is in {tmp_path}/hall-eyes-{name}.lens.yaml" in done.output
        assert _lens(fleet, name)["focal_px"] == pytest.approx([512, 512], rel=0.01)
    assert "# ours" in fleet.read_text(encoding="utf-8")
    assert "focal_px:  # of the data sheet" in (tmp_path / "base.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ([], "has several cameras: choose one with --camera: eyes.roof, eyes.side"),
        (["--camera", "roofs"], "has no camera 'roofs'; did you mean 'roof'?"),
        (["--squares", "6x8", "--camera", "roof"], "at least 8 are needed"),
    ],
)
def test_a_lens_that_cannot_be_written_changes_nothing(
    eal: Program, pictures: Path, tmp_path: Path, arguments: list[str], problem: str
) -> None:
    fleet = tmp_path / "hall.yaml"
    fleet.write_text(TRACKED, encoding="utf-8")
    done = eal("calibrate", "camera", pictures, "--write", "--fleet", fleet, *arguments)
    assert done.exit_code == 2
    assert problem in " ".join(done.output.split())
    assert fleet.read_text(encoding="utf-8") == TRACKED
    done = eal("calibrate", "camera", pictures, "--write")
    assert (done.exit_code, "--fleet" in done.output) == (2, True)


def test_pictures_without_a_board_are_refused(eal: Program, pictures: Path, tmp_path: Path) -> None:
    done = eal("calibrate", "camera", pictures, "--squares", "6x8")
    assert done.exit_code == 2
    assert "at least 8 are needed" in done.output
    done = eal("calibrate", "camera", tmp_path / "nothing")
    assert done.exit_code == 2
    assert "is no folder" in done.output
    assert eal("calibrate", "camera").exit_code == 2


def test_calibrate_without_a_fleet_names_the_option(eal: Program) -> None:
    done = eal("calibrate")
    assert done.exit_code == 2
    assert "--fleet" in done.output


def test_a_resource_that_gives_no_picture_is_reported(eal: Program) -> None:
    done = eal("calibrate", "camera", "--fleet", "sim", "--robot", "roomba-1", "--resource", "Battery")
    assert done.exit_code == 2, done.output
    assert "roomba-1/Battery: its value is no picture" in done.output
