"""Programs that write JPEG pictures, as `rpicam-vid` does, through the plugin's resource."""

from __future__ import annotations

import os
import random
import sys
from pathlib import Path
from typing import Any

import cv2
import pytest

from eal_actors.kernel.errors import ArgumentError, NotReadyError, PluginError
from eal_actors.plugin import EALData
from plugins.camera.camera import Camera
from plugins.camera.plugin import Settings
from plugins.camera.program import MAX_PICTURE_BYTES, JpegSplitter, ProgramStream
from plugins.camera.source import PictureSource
from tests.unit.plugins.camera.rig import PATIENCE_S, camera_on, number_in, picture, run, wait_until_ready

CAMERA = """
import sys, time
files = [open(path, "rb").read() for path in sys.argv[2:]]
for number in range(int(sys.argv[1])):
    sys.stdout.buffer.write(files[number % len(files)])
    sys.stdout.flush()
    time.sleep(0.01)
"""
"""It writes a number of pictures, a hundred a second."""


def jpeg(number: int) -> bytes:
    return bytes(cv2.imencode(".jpg", picture(number))[1])


def program(text: str, *arguments: object) -> list[str]:
    return [sys.executable, "-c", text, *map(str, arguments)]


def read_on(camera: Camera) -> None:
    """Read pictures until that fails."""
    while True:
        run(camera.get_value())


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / f"{number}.jpg" for number in range(200)]
    for number, path in enumerate(paths):
        path.write_bytes(jpeg(number))
    return paths


class TestSplitter:
    @pytest.mark.parametrize("seed", range(5))
    def test_files_are_cut_apart_wherever_the_bytes_are(self, seed: int) -> None:
        generator = random.Random(seed)  # noqa: S311  # lengths
        wanted = [jpeg(number) for number in range(20)]
        stream, found, splitter = b"".join(wanted), [], JpegSplitter()
        while stream:
            length = generator.choice((1, 2, 3, 100, 5000))
            found += splitter.feed(stream[:length])
            stream = stream[length:]
        assert found == wanted

    def test_the_end_of_a_preview_is_not_that_of_the_picture(self) -> None:
        inner, whole = jpeg(1), jpeg(2)
        segment = b"\xff\xe1" + (len(inner) + 2).to_bytes(2, "big") + inner
        with_preview = whole[:2] + segment + whole[2:]
        assert JpegSplitter().feed(with_preview + whole) == [with_preview, whole]

    def test_restarts_and_several_scans_belong_to_the_picture(self) -> None:
        image = picture(7)
        for flag in ((cv2.IMWRITE_JPEG_RST_INTERVAL, 1), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)):
            file = bytes(cv2.imencode(".jpg", image, flag)[1])
            assert JpegSplitter().feed(file + file) == [file, file]

    def test_fill_bytes_before_a_marker_are_skipped(self) -> None:
        file = jpeg(3)
        filled = file[:2] + b"\xff\xff" + file[2:-2] + b"\xff" + file[-2:]
        assert JpegSplitter().feed(filled) == [filled]

    @pytest.mark.parametrize("stream", [b"\x00\x00\x00\x01\x67", b"\xff\xd9", jpeg(1) + b"no picture"])
    def test_other_streams_are_told(self, stream: bytes) -> None:
        with pytest.raises(OSError, match=r"not a series of JPEG pictures; rpicam-vid needs `--codec mjpeg`"):
            JpegSplitter().feed(stream)

    def test_a_broken_segment_is_told(self) -> None:
        with pytest.raises(OSError, match="contains a broken JPEG picture"):
            JpegSplitter().feed(jpeg(1)[:20] + bytes(20))

    def test_a_picture_without_an_end_is_told(self) -> None:
        splitter = JpegSplitter()
        splitter.feed(jpeg(1)[:-2])
        with pytest.raises(OSError, match="a picture has more than 16 MiB"):
            splitter.feed(bytes(MAX_PICTURE_BYTES))


def test_its_pictures_are_of_now(files: list[Path]) -> None:
    settings = {"source": program(CAMERA, 100_000, *files), "timeout_s": PATIENCE_S}
    with camera_on(settings) as camera:
        clock = camera._reader._clock
        for _ in range(5):
            called_s = clock.now()
            data = run(camera.get_value())
            assert data.stamp_s is not None
            assert called_s < data.stamp_s <= clock.now()
        assert (run(camera.width()), run(camera.height())) == (64, 48)
        with pytest.raises(ArgumentError, match="width: a program has a fixed value, 64, and cannot have 640"):
            run(camera.set_config("width", EALData.of(640)))


def test_what_it_wrote_before_is_thrown_away(files: list[Path]) -> None:
    """They fit into the pipe, and would all be of the past."""
    text = "import sys\nfor path in sys.argv[1:4]: sys.stdout.buffer.write(open(path, 'rb').read())\n"
    text += "sys.stdout.flush()\nopen(sys.argv[6], 'w').write('ready')\n"
    text += "open(sys.argv[5]).read()\nsys.stdout.buffer.write(open(sys.argv[4], 'rb').read())\n"
    ready, go = files[0].parent / "ready", files[0].parent / "go"
    os.mkfifo(ready)
    os.mkfifo(go)
    stream = ProgramStream(program(text, *files[:4], go, ready), PATIENCE_S)
    try:
        ready.read_text()
        for _ in range(3):  # as at the beginning of a reading
            stream._receive(0.0)
        go.write_text("")
        assert number_in(stream.read()) == 3
    finally:
        stream.release()


def test_one_that_ends_is_named_with_its_last_words_and_started_again(files: list[Path]) -> None:
    failing = CAMERA + "sys.exit('no cameras available')"
    settings = {"source": program(failing, 3, *files), "timeout_s": PATIENCE_S}
    with camera_on(settings) as camera:
        wait_until_ready(camera._reader)
        with pytest.raises(NotReadyError, match="the program has ended with exit code 1: no cameras available; next"):
            read_on(camera)
        wait_until_ready(camera._reader)


def test_one_that_writes_nothing_is_told() -> None:
    text = "import sys, time; print('waiting', file=sys.stderr, flush=True); time.sleep(1000)"
    stream = ProgramStream(program(text), 0.5)
    try:
        with pytest.raises(OSError, match=r"has written no picture for 0\.5 s"):
            stream.read()
    finally:
        stream.release()


@pytest.mark.parametrize("start", ["", "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); "])
def test_it_ends_with_the_resource_and_so_does_what_it_has_started(start: str, files: list[Path]) -> None:
    alive = files[0].parent / "alive"
    os.mkfifo(alive)
    camera = f"held = open({str(alive)!r}, 'w')\n{CAMERA}"
    text = f"{start}import subprocess, sys; subprocess.run([sys.executable, '-c', *sys.argv[1:]])"
    stream = ProgramStream(program(text, camera, 100_000, *files), PATIENCE_S)
    with alive.open() as ends:
        stream.read()
        stream.release()
        assert stream._process.poll() is not None
        assert ends.read() == ""  # no process has it open


def test_one_that_is_not_installed_is_a_wrong_configuration() -> None:
    with (
        pytest.raises(PluginError, match="source: this machine has no program 'no-such-camera'"),
        camera_on({"source": ["no-such-camera", "--codec", "mjpeg"]}),
    ):
        pass


def test_its_arguments_may_be_numbers_and_its_name_has_no_password() -> None:
    settings = Settings.model_validate({"source": ["vid", "--width", 640, "--url", "rtsp://me:secret@cam/"]})
    source: Any = PictureSource.of(settings.source)
    assert source.arguments == ("vid", "--width", "640", "--url", "rtsp://me:secret@cam/")
    assert source.name == "vid --width 640 --url rtsp://me:***@cam/"


@pytest.mark.parametrize(("settings", "says"), [({"source": []}, "or a program"), ({"width": 640}, "width is for")])
def test_wrong_settings_are_told(settings: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Settings.model_validate({"source": ["rpicam-vid"], **settings})
