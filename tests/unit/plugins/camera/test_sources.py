"""Video files, folders of images and streams over a network, through the plugin's resource."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import ArgumentError, NotReadyError, PluginError, UnavailableError
from eal_actors.plugin import EALData
from plugins.camera.camera import Camera
from plugins.camera.files import ImageFolder
from plugins.camera.stream import open_stream
from tests.unit.plugins.camera.rig import (
    PATIENCE_S,
    MjpegServer,
    camera_on,
    number_in,
    picture,
    run,
    wait_until_ready,
    write_folder,
    write_video,
)


def numbers(camera: Camera, count: int) -> list[int]:
    return [number_in(run(camera.get_value()).value) for _ in range(count)]


def rises(found: list[int]) -> bool:
    return all(one < other for one, other in itertools.pairwise(found))


# Video files.


def test_a_video_plays_at_its_own_rate(tmp_path: Path) -> None:
    clock = SystemClock()
    with camera_on(
        {"source": str(write_video(tmp_path / "a.avi", 200, 50.0)), "timeout_s": PATIENCE_S}, clock
    ) as camera:
        first, last = run(camera.get_value()), [run(camera.get_value()) for _ in range(10)][-1]
        assert run(camera.fps()) == 50.0
    shown = number_in(last.value) - number_in(first.value)
    assert shown >= 10
    assert first.stamp_s is not None
    assert last.stamp_s is not None
    assert last.stamp_s - first.stamp_s > (shown - 1) / 50.0  # a reading may be late, and never early


def test_a_video_that_has_ended_says_so(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", 3, 50.0)
    with camera_on({"source": str(path)}) as camera:
        camera._reader._thread.join(PATIENCE_S)
        message = f"{path}: it has ended after 3 pictures; with `loop: true` it restarts"
        assert camera.not_ready() == message
        with pytest.raises(NotReadyError) as raised:
            run(camera.get_value())
        assert raised.value.message == message


def test_a_video_begins_anew_where_it_is_to_loop(tmp_path: Path) -> None:
    source = str(write_video(tmp_path / "a.avi", 5, 200.0))
    with camera_on({"source": source, "loop": True, "timeout_s": PATIENCE_S}) as camera:
        found = numbers(camera, 12)
    assert not rises(found)
    assert set(found) <= set(range(5))


def test_a_file_that_is_no_video_is_a_wrong_configuration(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no video")
    with (
        pytest.raises(PluginError, match=r"notes.txt': it is not a video that FFmpeg can read"),
        camera_on({"source": str(tmp_path / "notes.txt")}),
    ):
        pass


def test_a_file_that_is_missing_is_a_wrong_configuration() -> None:
    with (
        pytest.raises(PluginError, match=r"source 'nowhere.avi' does not exist; the working directory is /"),
        camera_on({"source": "nowhere.avi"}),
    ):
        pass


# Folders.


def test_images_come_in_natural_order_and_begin_anew_with_what_is_there_then(tmp_path: Path) -> None:
    folder = ImageFolder(write_folder(tmp_path, range(8, 12)), loop=True, fps=1.0)
    assert [number_in(folder.read()) for _ in range(3)] == [8, 9, 10]
    write_folder(tmp_path, range(12, 13))
    assert [number_in(folder.read()) for _ in range(7)] == [11, 8, 9, 10, 11, 12, 8]


def test_a_folder_is_shown_in_its_order(tmp_path: Path) -> None:
    source = str(write_folder(tmp_path, range(1000)))
    with camera_on({"source": source, "fps": 100, "timeout_s": PATIENCE_S}) as camera:
        assert rises(numbers(camera, 5))


def test_a_folder_ends_unless_it_loops(tmp_path: Path) -> None:
    with camera_on({"source": str(write_folder(tmp_path, range(2))), "fps": 100}) as camera:
        camera._reader._thread.join(PATIENCE_S)
        assert "has ended after 2 images" in (camera.not_ready() or "")


def test_a_folder_without_images_is_a_wrong_configuration(tmp_path: Path) -> None:
    with (
        pytest.raises(PluginError, match="it contains no image; images end in"),
        camera_on({"source": str(tmp_path)}),
    ):
        pass


def test_a_broken_image_is_named(tmp_path: Path) -> None:
    (write_folder(tmp_path, range(1)) / "shot1.png").write_bytes(b"no image")
    settings = {"source": str(tmp_path), "fps": 100, "timeout_s": PATIENCE_S}
    reason = r"OpenCV cannot read its image shot1\.png; next try in"
    with camera_on(settings) as camera, pytest.raises(NotReadyError, match=reason):
        numbers(camera, 3)


def test_a_folder_takes_another_rate_and_no_other_size(tmp_path: Path) -> None:
    with camera_on({"source": str(write_folder(tmp_path, range(3))), "loop": True, "timeout_s": PATIENCE_S}) as camera:
        assert run(camera.fps()) == 1.0
        run(camera.set_config("fps", EALData.of(80)))
        assert run(camera.fps()) == 80.0
        run(camera.set_config("width", EALData.of(64)))
        with pytest.raises(ArgumentError, match="height: a folder of images has a fixed value, 48, and cannot have 50"):
            run(camera.set_config("height", EALData.of(50)))
        assert (run(camera.width()), run(camera.height())) == (64, 48)


# What a value is.


def colours(folder: Path) -> str:
    image = np.zeros((32, 40, 3), np.uint8)
    image[:, :, 0], image[:, :, 2] = 16, 240  # blue first: red
    folder.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "red.png"), image)
    return str(folder)


@pytest.mark.parametrize("form", ["raw", "jpeg", "png"])
def test_a_value_is_as_its_format_says(form: str, tmp_path: Path) -> None:
    settings: dict[str, Any] = {"source": colours(tmp_path), "fps": 50, "loop": True, "timeout_s": PATIENCE_S}
    with camera_on({**settings, "format": form}) as camera:
        data = run(camera.get_value())
        info = camera.info()
        assert camera.get_config("format") == form
    assert info.value is not None
    info.value.check(data, "the picture")
    assert data.frame_id == "rob/camera"
    image = data.value
    if form != "raw":
        assert data.value[:3] == {"jpeg": b"\xff\xd8\xff", "png": b"\x89PN"}[form]
        image = cv2.imdecode(np.frombuffer(data.value, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert image.shape == (32, 40, 3)
    assert np.abs(image.astype(int) - [240, 0, 16]).max() <= 4


def test_a_camera_matrix_is_that_of_the_field_of_view(tmp_path: Path) -> None:
    settings = {"source": colours(tmp_path), "fps": 50, "loop": True, "timeout_s": PATIENCE_S}
    with camera_on(settings) as camera:
        with pytest.raises(UnavailableError, match="the field of view of this camera is unknown"):
            run(camera.send_req("intrinsics"))
        run(camera.set_config("fov_deg", EALData.of(90)))
        assert np.allclose(
            run(camera.send_req("intrinsics")).value, np.array([[20, 0, 19.5], [0, 20, 15.5], [0, 0, 1]])
        )


# Streams.


def test_a_stream_shows_what_is_now() -> None:
    with MjpegServer() as server, camera_on({"source": server.url, "timeout_s": PATIENCE_S}) as camera:
        clock = camera._reader._clock
        assert rises(numbers(camera, 10))
        called_s = clock.now()
        stamp_s = run(camera.get_value()).stamp_s
        assert stamp_s is not None
        assert called_s < stamp_s <= clock.now()


def test_a_stream_keeps_no_picture_for_later() -> None:
    with MjpegServer() as server, camera_on({"source": server.url, "timeout_s": PATIENCE_S}) as camera:
        before = number_in(run(camera.get_value()).value)
        with camera._reader._changed:  # nobody asks for a picture, and 20 of them pass
            limit = camera._reader._begun + 20
            assert camera._reader._changed.wait_for(lambda: camera._reader._begun >= limit, PATIENCE_S)
        assert number_in(run(camera.get_value()).value) >= before + 20


def test_a_stream_that_is_stalled_is_not_ready_and_comes_back() -> None:
    with MjpegServer() as server, camera_on({"source": server.url, "timeout_s": 1.0}) as camera:
        wait_until_ready(camera._reader)
        run(camera.get_value())
        server.stall(stalled=True)
        with pytest.raises(NotReadyError, match=r"frozen|timed out"):
            numbers(camera, 1000)
        server.stall(stalled=False)
        wait_until_ready(camera._reader)
        assert number_in(run(camera.get_value()).value) > 0


def test_a_stream_that_is_unplugged_is_not_ready_and_comes_back() -> None:
    with MjpegServer() as server, camera_on({"source": server.url, "timeout_s": PATIENCE_S}) as camera:
        last = number_in(run(camera.get_value()).value)
        server.unplug()
        with pytest.raises(NotReadyError, match=r"has ended or timed out|no stream that FFmpeg can read"):
            numbers(camera, 1000)
        server.plug_in()
        wait_until_ready(camera._reader)
        assert number_in(run(camera.get_value()).value) > last


def test_a_stream_that_is_stuck_is_frozen_and_comes_back() -> None:
    settings = {"timeout_s": PATIENCE_S, "frozen_after_s": 0.2}
    with MjpegServer() as server, camera_on({"source": server.url, **settings}) as camera:
        run(camera.get_value())
        server.stick(stuck=True)
        with pytest.raises(NotReadyError, match="is frozen: an identical picture for"):
            numbers(camera, 10_000)
        server.stick(stuck=False)
        wait_until_ready(camera._reader)
        run(camera.get_value())


def test_a_stream_has_its_own_size() -> None:
    with MjpegServer() as server, camera_on({"source": server.url, "timeout_s": PATIENCE_S}) as camera:
        with pytest.raises(ArgumentError, match="width: a stream has a fixed value, 64, and cannot have 640"):
            run(camera.set_config("width", EALData.of(640)))
        assert (run(camera.width()), run(camera.height())) == (64, 48)


def test_a_host_that_does_not_answer_is_not_ready_and_holds_nobody_up() -> None:
    with MjpegServer() as server:
        url = server.url
        server.stall(stalled=True)
        with pytest.raises(OSError, match=r"no stream that FFmpeg can read answers within 0\.1 s"):
            open_stream(url, 0.1)
        with camera_on({"source": url, "timeout_s": 0.1}) as camera, pytest.raises(NotReadyError):
            run(camera.get_value())


def test_the_picture_tells_its_number() -> None:
    assert [number_in(picture(number)) for number in (0, 15, 16, 4711, 65535)] == [0, 15, 16, 4711, 65535]
