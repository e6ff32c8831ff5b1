from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ValueInfo
from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.report.files import answer_problem, check_file_name, image_writer, save_answer, suffix_problem

RED = np.zeros((2, 3, 3), dtype=np.uint8)
RED[..., 0] = 200


@pytest.mark.parametrize(
    ("name", "value", "content"),
    [
        ("a.txt", EALData.of("hello"), b"hello"),
        ("a.txt", EALData.of(b"\x00\xff"), b"\x00\xff"),
        ("a.json", EALData.of("hello"), b'"hello"'),
        ("a.json", EALData.of(1.5), b"1.5"),
        ("a.json", EALData.of(True), b"true"),
        ("a.json", EALData.of([1, 2]), b"[1, 2]"),
        ("a.json", EALData.of(np.array([[1.0, 2.0]])), b"[[1.0, 2.0]]"),
        ("a.json", EALData.of(None), b"null"),
    ],
)
def test_an_answer_is_saved(tmp_path: Path, name: str, value: EALData, content: bytes) -> None:
    assert save_answer(value, tmp_path / "robot", f"deep/{name}", 1.5) is None
    assert (tmp_path / "robot" / "deep" / name).read_bytes() == content


def check_image(tmp_path: Path, *, is_kept: bool) -> None:
    from matplotlib.image import imread

    assert save_answer(EALData.of(RED), tmp_path, "frame.0.png", 1.5, is_kept=is_kept) is None

    image = np.rint(imread(tmp_path / "frame.0.png")[..., :3] * 255).astype(np.uint8)
    assert np.array_equal(image, RED)


@pytest.mark.parametrize("is_kept", [True, False])
def test_an_image_is_a_png_with_its_colours(tmp_path: Path, is_kept: bool) -> None:
    check_image(tmp_path, is_kept=is_kept)


def test_matplotlib_serves_where_opencv_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    image_writer.cache_clear()
    try:
        check_image(tmp_path, is_kept=True)
    finally:
        image_writer.cache_clear()


def test_without_either_an_image_is_an_array(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    monkeypatch.setitem(sys.modules, "matplotlib.image", None)
    image_writer.cache_clear()
    try:
        note = save_answer(EALData.of(RED), tmp_path, "frame.0.png", 1.5)
    finally:
        image_writer.cache_clear()

    assert note is not None
    assert note.startswith("saved frame.0.npy in place of a PNG, which needs OpenCV or matplotlib")
    assert not (tmp_path / "frame.0.png").exists()
    assert np.array_equal(np.load(tmp_path / "frame.0.npy"), RED)


def test_an_array_can_be_kept_whole(tmp_path: Path) -> None:
    save_answer(EALData.of(np.array([0.1, 0.2], dtype=np.float32)), tmp_path, "a.npy", 1.5)
    save_answer(EALData.of([1.5, 2]), tmp_path, "list.npy", 1.5)
    save_answer(EALData.of(RED), tmp_path, "a.json", 1.5)

    assert np.array_equal(np.load(tmp_path / "list.npy"), [1.5, 2.0])
    assert np.load(tmp_path / "a.npy").dtype == np.float32
    assert json.loads((tmp_path / "a.json").read_text()) == RED.tolist()


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("a.png", EALData.of("text"), r"no image of \(h, w, 3\) unsigned bytes"),
        ("a.png", EALData.of([1, 2]), r"no image of \(h, w, 3\) unsigned bytes"),
        ("a.png", EALData.of(RED[..., :2].copy()), r"no image of \(h, w, 3\) unsigned bytes"),
        ("a.png", EALData.of(RED.astype(float)), r"no image of \(h, w, 3\) unsigned bytes"),
        ("a.npy", EALData.of("text"), "no array"),
        ("a.npy", EALData.of(1), "no array"),
        ("a.txt", EALData.of(1), "no text"),
        ("a.txt", EALData.of(RED), "no text"),
        ("a.json", EALData.of(b"x"), "bytes, which JSON has no form for; save them as .txt"),
    ],
)
def test_what_does_not_go_into_a_file_is_refused(tmp_path: Path, name: str, value: EALData, what: str) -> None:
    with pytest.raises(ScenarioError, match=rf"^{name} cannot hold this value: it is {what}$"):
        save_answer(value, tmp_path, name, 1.5)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a.json", None),
        ("deep/a.${i}.png", None),
        ("a.jpg", "saves as .csv, .json, .npy, .png or .txt, not .jpg; did you mean '.png'?"),
        ("a.PNG", "saves as .csv, .json, .npy, .png or .txt, not .PNG; did you mean '.png'?"),
        ("a.csv", None),
        ("a.xls", "saves as .csv, .json, .npy, .png or .txt, not .xls"),
        ("a.${i}", "saves as .csv, .json, .npy, .png or .txt, not .${i}"),
        ("a.b/c", "saves as .csv, .json, .npy, .png or .txt, and 'a.b/c' has no such ending"),
    ],
)
def test_a_name_ends_as_it_is_saved(name: str, expected: str | None) -> None:
    assert suffix_problem(name) == expected


@pytest.mark.parametrize(
    ("name", "answer", "fits"),
    [
        ("a.png", ValueInfo(DataType.CHAR, shape=(240, 320, 3)), True),
        ("a.png", ValueInfo(DataType.CHAR, shape=(None, None, None)), True),
        ("a.png", ValueInfo(DataType.CHAR, shape=(240, 320, 4)), False),
        ("a.png", ValueInfo(DataType.CHAR, shape=(240, 3)), False),
        ("a.png", ValueInfo(DataType.DOUBLE, shape=(240, 320, 3)), False),
        ("a.png", ValueInfo(DataType.CHAR), False),
        ("a.npy", ValueInfo(DataType.DOUBLE, shape=(3,)), True),
        ("a.npy", ValueInfo(DataType.DOUBLE), False),
        ("a.txt", ValueInfo(DataType.CHAR), True),
        ("a.txt", ValueInfo(DataType.CHAR, shape=(240, 320, 3)), False),
        ("a.txt", ValueInfo(DataType.INT), False),
        ("a.json", ValueInfo(DataType.INT), True),
    ],
)
def test_announced_answers_go_into_their_files(name: str, answer: ValueInfo, fits: bool) -> None:
    assert (answer_problem(name, answer) is None) == fits


@pytest.mark.parametrize("name", ["", ".", "/etc/x", "../x", "a/../../x", "a\0b"])
def test_a_name_stays_in_the_folder(name: str) -> None:
    with pytest.raises(ScenarioError, match="is not a file name inside the run's folder"):
        check_file_name(name)
