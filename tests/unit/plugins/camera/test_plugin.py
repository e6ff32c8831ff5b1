"""The plugin's settings, and its camera in a fleet."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from eal_actors import Fleet, gather
from eal_actors.kernel.errors import ConfigError, DeadlineError, NotReadyError
from plugins.camera.plugin import Settings
from plugins.camera.source import PictureSource, SourceKind
from tests.unit.plugins.camera.rig import (
    PATIENCE_S,
    MjpegServer,
    number_in,
    wait_until_ready,
    wait_until_shown,
    write_folder,
)

SOURCES = [
    (0, SourceKind.DEVICE, "/dev/video0"),
    ("/dev/v4l/by-id/usb-cam", SourceKind.DEVICE, "/dev/v4l/by-id/usb-cam"),
    ("rtsp://10.0.0.7:554/live", SourceKind.STREAM, "rtsp://10.0.0.7:554/live"),
    ("https://cam.lab/video.mjpg", SourceKind.STREAM, "https://cam.lab/video.mjpg"),
    ("rtsp://admin:secret@cam.lab/1", SourceKind.STREAM, "rtsp://admin:***@cam.lab/1"),
    ("http://cam.lab/live?user=me&pwd=secret", SourceKind.STREAM, "http://cam.lab/live?***"),
    ("what?.avi", SourceKind.FILE, "what?.avi"),
    ("video.avi", SourceKind.FILE, "video.avi"),
    ("/tmp", SourceKind.FOLDER, "/tmp"),  # noqa: S108  # a folder that every system has
]


@pytest.mark.parametrize(("source", "kind", "name"), SOURCES)
def test_a_source_is_known_by_its_look(source: int | str, kind: SourceKind, name: str) -> None:
    found = PictureSource.of(source)
    assert (found.kind, found.name) == (kind, name)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({}, "source\n  Field required"),
    ({"source": -1}, "use a number from 0, a device path, a URL, the path of a file or folder, or a program"),
    ({"source": ""}, "use a number from 0"),
    ({"source": "ftp://cam.lab/x"}, "use a URL with rtsp://, rtsps://, http://, https:// and a host"),
    ({"source": "ftp://me:secret@cam.lab"}, "source 'ftp://me:***@cam.lab'"),
    ({"source": "http:///x"}, "and a host"),
    ({"source": "http://["}, "source 'http://[': invalid URL: Invalid IPv6 URL"),
    ({"source": 0, "width": 8}, "greater than or equal to 16"),
    ({"source": 0, "fps": 0.5}, "greater than or equal to 1"),
    ({"source": 0, "exposure": 17}, "less than or equal to 16"),
    ({"source": 0, "fourcc": "MJPEG"}, "fourcc"),
    ({"source": 0, "format": "bmp"}, "'raw', 'jpeg' or 'png'"),
    ({"source": "a.avi", "width": 640}, "width is for a camera, but this source is a video file"),
    ({"source": __file__, "fps": 30}, "fps is for a camera or a folder of images, but this source is a video file"),
    ({"source": "http://h/x", "exposure": 2}, "exposure is for a camera, but this source is a stream"),
    ({"source": "a.avi", "frozen_after_s": 3}, "frozen_after_s is for a camera or a stream"),
]


@pytest.mark.parametrize(("settings", "reason"), WRONG)
def test_wrong_settings_are_told(settings: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError) as raised:
        Settings.model_validate(settings)
    assert reason in str(raised.value)


def fleet_file(folder: Path, settings: str, head: str = "") -> Path:
    path = folder / "fleet.yaml"
    path.write_text(f"version: 1\n{head}robots:\n  rob:\n    plugins:\n      camera: {settings}\n")
    return path


def test_a_fleet_file_names_the_line_of_a_wrong_setting(tmp_path: Path) -> None:
    place = r"fleet\.yaml:5:34: robots\.rob\.plugins\.camera\.width: must be at least 16, not 5$"
    with pytest.raises(ConfigError, match=place), Fleet.load(fleet_file(tmp_path, "{source: 0, width: 5}")):
        pass


def test_callers_at_once_all_get_pictures_of_their_own_time(tmp_path: Path) -> None:
    source = write_folder(tmp_path / "shots", range(20))
    path = fleet_file(tmp_path, f"{{source: {source}, fps: 100, loop: true, timeout_s: {PATIENCE_S}}}")
    found: list[tuple[float, float | None]] = []
    with Fleet.load(path) as fleet:
        camera = fleet["rob"]["Camera"]

        def look() -> None:
            for _ in range(5):
                called_s = fleet.clock.now()
                found.append((called_s, camera.get_value(timeout_s=PATIENCE_S).get().stamp_s))

        threads = [threading.Thread(target=look) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE_S)
    assert len(found) == 40
    assert all(stamp_s is not None and stamp_s > called_s for called_s, stamp_s in found)


@contextlib.contextmanager
def stalled_stream(folder: Path) -> Iterator[tuple[MjpegServer, Any]]:
    """Have a camera whose stream is open, and stalled."""
    with MjpegServer() as server, contextlib.ExitStack() as stack:
        settings = f"{{source: '{server.url}', timeout_s: {PATIENCE_S}}}"
        camera = stack.enter_context(Fleet.load(fleet_file(folder, settings)))["rob"]["Camera"]
        resource: Any = camera.resource()
        camera.get_value(timeout_s=PATIENCE_S).get()
        server.stall(stalled=True)
        stack.callback(server.stall, stalled=False)
        wait_until_shown(resource._reader, server.sent)
        yield server, camera


def test_callers_of_one_moment_share_a_picture_and_nothing_waits_behind_them(tmp_path: Path) -> None:
    with stalled_stream(tmp_path) as (server, camera):
        asked = [camera.get_value(timeout_s=PATIENCE_S) for _ in range(20)]
        assert camera.get_config("format", timeout_s=PATIENCE_S).get().value == "raw"  # answered meanwhile
        assert not any(one.done() for one in asked)
        server.stall(stalled=False)
        assert len({one.get().stamp_s for one in asked}) <= 5  # another picture may come while they are served


def test_a_call_with_a_short_deadline_ends_by_it_and_harms_nobody(tmp_path: Path) -> None:
    with stalled_stream(tmp_path) as (server, camera):
        resource = camera.resource()
        assert isinstance(camera.get_value(timeout_s=0.1).exception(), DeadlineError)
        server.stall(stalled=False)
        assert number_in(camera.get_value(timeout_s=PATIENCE_S).get().value) > 0
        assert camera.resource() is resource


def test_an_unplugged_camera_is_not_ready_and_works_on_without_a_restart(tmp_path: Path) -> None:
    with MjpegServer() as server:
        server.unplug()
        with Fleet.load(fleet_file(tmp_path, f"{{source: '{server.url}', timeout_s: {PATIENCE_S}}}")) as fleet:
            camera = fleet["rob"]["Camera"]
            resource: Any = camera.resource()
            error = camera.get_value(timeout_s=PATIENCE_S).exception()
            assert isinstance(error, NotReadyError)
            assert f"rob/Camera: {server.url}: no stream that FFmpeg can read answers" in str(error)
            server.plug_in()
            wait_until_ready(resource._reader)
            assert number_in(camera.get_value(timeout_s=PATIENCE_S).get().value) > 0
            assert camera.resource() is resource


@pytest.mark.parametrize("rate", ["max", "5"])
def test_a_camera_keeps_real_time_whatever_the_fleets_clock_does(rate: str, tmp_path: Path) -> None:
    source = write_folder(tmp_path / "shots", range(50))
    settings = f"{{source: {source}, fps: 50, loop: true, timeout_s: {PATIENCE_S}}}"
    with Fleet.load(fleet_file(tmp_path, settings, f"clock: {{rate: {rate}}}\n")) as fleet:
        camera = fleet["rob"]["Camera"]
        before_s = fleet.clock.now()
        frames = [camera.get_value(timeout_s=1000).get() for _ in range(5)]
        assert len({number_in(frame.value) for frame in frames}) == 5
        stamps_s = [frame.stamp_s or 0.0 for frame in frames]
        assert stamps_s == sorted(stamps_s)
        assert before_s <= stamps_s[0]
        assert stamps_s[-1] <= fleet.clock.now()


def test_two_robots_have_a_camera_each(tmp_path: Path) -> None:
    source = write_folder(tmp_path / "shots", range(10))
    path = tmp_path / "fleet.yaml"
    path.write_text(
        "version: 1\n"
        f"defaults: {{plugins: {{camera: {{source: {source}, fps: 50, loop: true, timeout_s: {PATIENCE_S}}}}}}}\n"
        "robots: {one: {}, two: {plugins: {camera: {format: jpeg}}}}\n"
    )
    with Fleet.load(path) as fleet:
        one, two = gather(robot["Camera"].get_value(timeout_s=PATIENCE_S) for robot in fleet.values()).get()
    assert one.value.shape == (48, 64, 3)
    assert two.value[:2] == b"\xff\xd8"
    assert (one.frame_id, two.frame_id) == ("one/camera", "two/camera")
