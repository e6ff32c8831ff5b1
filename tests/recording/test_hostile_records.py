"""Records of strangers: each is read or refused, within bounded memory."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard

from eal_actors.kernel.errors import ScenarioError
from eal_actors.recording import RunFolder, compare_runs, path_deviations, render_report, repair_record
from eal_actors.recording.mcap_file import read_mcap

MAGIC = b"\x89MCAP0\r\n"
CHUNK, ATTACHMENT = 6, 9
MB = 1024 * 1024


def compressed_zeros(begin: bytes, megabytes: int) -> bytes:
    stream = zstandard.ZstdCompressor().compressobj()
    pieces = [stream.compress(begin), *(stream.compress(bytes(MB)) for _ in range(megabytes)), stream.flush()]
    return b"".join(pieces)


def lz4_zeros(begin: bytes, megabytes: int) -> bytes:
    stream = lz4.frame.LZ4FrameCompressor()
    pieces = [stream.begin(), stream.compress(begin), *(stream.compress(bytes(MB)) for _ in range(megabytes))]
    return b"".join([*pieces, stream.flush()])


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def write_record(file: Path, opcode: int, body: bytes) -> Path:
    file.write_bytes(MAGIC + bytes([opcode]) + struct.pack("<Q", len(body)) + body)
    return file


@pytest.mark.parametrize(("name", "compress"), [("zstd", compressed_zeros), ("lz4", lz4_zeros)])
def test_a_chunk_that_explodes_is_refused(tmp_path: Path, name: str, compress: Callable[[bytes, int], bytes]) -> None:
    """It was unpacked, whatever its size: 3 GB came out of 90 kB."""
    size = 150 * MB
    data = compress(b"\x80" + struct.pack("<Q", size), 150)  # one record of a kind that readers skip
    body = struct.pack("<QQQI", 0, 1, size + 9, 0) + text(name) + struct.pack("<Q", len(data)) + data
    file = write_record(tmp_path / "run.mcap", CHUNK, body)
    assert file.stat().st_size < 2 * MB
    with pytest.raises(ScenarioError, match=r"run\.mcap is no record of a run: .* unpacks to more than"):
        read_mcap(file)


def test_a_chunk_of_another_content_is_refused(run: Path, tmp_path: Path) -> None:
    """Its values came out changed: the checksum of the file was not compared."""
    packed = (run / "run.mcap").read_bytes()
    place = packed.index(b"zstd") + len(b"zstd") + 8
    file = tmp_path / "run.mcap"
    damaged = 0
    for offset in range(40, 1040, 10):
        file.write_bytes(packed[: place + offset] + bytes([packed[place + offset] ^ 1]) + packed[place + offset + 1 :])
        with pytest.raises(ScenarioError, match=r"run\.mcap is ") as caught:
            read_mcap(file)
        damaged += "is damaged" in str(caught.value)
    assert damaged > 90


def test_texts_that_are_nested_too_deeply_are_refused(run: Path, tmp_path: Path) -> None:
    """They ended with a traceback."""
    deep = "[" * 100_000
    body = struct.pack("<QQ", 0, 0) + text("resources.json") + text("application/json")
    body += struct.pack("<Q", len(deep)) + deep.encode() + bytes(4)
    with pytest.raises(ScenarioError, match="RecursionError"):
        read_mcap(write_record(tmp_path / "run.mcap", ATTACHMENT, body))
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "events.jsonl").write_text(f"{deep}\n{json.dumps({'event': 'danced', 'time_s': 9})}\n")
    with pytest.raises(ScenarioError, match=r"events\.jsonl:1: is no event"):
        render_report(RunFolder.open(folder))


def test_a_scenario_that_is_no_text_has_no_outline(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "scenario.yaml").write_bytes(b"\xff\xfe")
    assert 'id="outline"' not in render_report(RunFolder.open(folder))


@pytest.mark.parametrize("value", ["nan", "inf", "1e400"])
@pytest.mark.parametrize("column", [1, 2, 4])
def test_numbers_of_paths_are_finite(run: Path, tmp_path: Path, column: int, value: str) -> None:
    """`eal diff` found no difference to a path of NaN."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    table = folder / "trajectory.csv"
    lines = table.read_text(encoding="utf-8").splitlines()
    row = lines[9].split(",")
    row[column] = value
    table.write_text("\n".join([*lines[:9], ",".join(row), *lines[10:], ""]), encoding="utf-8")
    broken, whole = RunFolder.open(folder), RunFolder.open(run)
    for use in (
        lambda: render_report(broken),
        lambda: list(compare_runs(broken, whole)),
        lambda: path_deviations(broken, whole),
        lambda: repair_record(folder),
    ):
        with pytest.raises(ScenarioError, match=r"trajectory\.csv:10: is no table of paths: .* must be finite"):
            use()
