from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from eal_actors.data import EALData
from eal_actors.errors import ScenarioError
from eal_actors.scenario.files import check_file_name, image_writer, save_answer

RED = np.zeros((2, 3, 3), dtype=np.uint8)
RED[..., 0] = 200


@pytest.mark.parametrize(
    ("value", "content"),
    [
        (EALData.of("hello"), b"hello"),
        (EALData.of(b"\x00\xff"), b"\x00\xff"),
        (EALData.of(1.5), b"1.5"),
        (EALData.of(True), b"true"),
        (EALData.of([1, 2]), b"[1, 2]"),
        (EALData.of(np.array([[1.0, 2.0]])), b"[[1.0, 2.0]]"),
        (EALData.of(None), b"null"),
    ],
)
def test_an_answer_is_saved(tmp_path: Path, value: EALData, content: bytes) -> None:
    assert save_answer(value, tmp_path / "robot", "deep/answer.txt") is None
    assert (tmp_path / "robot" / "deep" / "answer.txt").read_bytes() == content


def test_an_image_is_a_png_with_its_colours(tmp_path: Path) -> None:
    from matplotlib.image import imread

    assert save_answer(EALData.of(RED), tmp_path, "frame.0.png") is None

    image = np.rint(imread(tmp_path / "frame.0.png")[..., :3] * 255).astype(np.uint8)
    assert np.array_equal(image, RED)


def test_matplotlib_serves_where_opencv_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    image_writer.cache_clear()
    try:
        test_an_image_is_a_png_with_its_colours(tmp_path)
    finally:
        image_writer.cache_clear()


def test_without_either_an_image_is_an_array(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    monkeypatch.setitem(sys.modules, "matplotlib.image", None)
    image_writer.cache_clear()
    try:
        note = save_answer(EALData.of(RED), tmp_path, "frame.0.png")
    finally:
        image_writer.cache_clear()

    assert note is not None
    assert note.startswith("saved frame.0.npy in place of a PNG, which needs OpenCV or matplotlib")
    assert not (tmp_path / "frame.0.png").exists()
    assert np.array_equal(np.load(tmp_path / "frame.0.npy"), RED)


def test_an_array_can_be_kept_whole(tmp_path: Path) -> None:
    save_answer(EALData.of(np.array([0.1, 0.2], dtype=np.float32)), tmp_path, "a.npy")
    save_answer(EALData.of(RED), tmp_path, "a.json")

    assert np.load(tmp_path / "a.npy").dtype == np.float32
    assert json.loads((tmp_path / "a.json").read_text()) == RED.tolist()


@pytest.mark.parametrize("name", ["a.png", "a.npy"])
@pytest.mark.parametrize("value", [EALData.of("text"), EALData.of(b"x"), EALData.of(1), EALData.of([1, 2])])
def test_what_is_no_picture_gets_no_picture_file(tmp_path: Path, value: EALData, name: str) -> None:
    with pytest.raises(ScenarioError, match=rf"^{name} cannot hold this value: it is no (image|array)$"):
        save_answer(value, tmp_path, name)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("name", ["", ".", "/etc/x", "../x", "a/../../x", "a\0b"])
def test_a_name_stays_in_the_folder(name: str) -> None:
    with pytest.raises(ScenarioError, match="is no name of a file inside the run's folder"):
        check_file_name(name)
