"""Records with a flipped bit in every kind of place: they are refused, and a repair keeps the rest."""

from __future__ import annotations

import shutil
import struct
import zlib
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from structlog.testing import capture_logs
from typer.testing import CliRunner

from eal_actors.cli.app import app
from eal_actors.kernel.errors import ScenarioError
from eal_actors.recording import RunFolder, compare_runs, repair_record
from eal_actors.recording.mcap_file import RECORD_FILE, read_mcap
from eal_actors.recording.recorded_run import RecordedRun

FOOTER = 9 + 20 + 8
"""Bytes of the last record and of the magic after it."""
OF_EVENTS = "/events", "/log", "/roomba-1/commands", "/evbot3-1/commands"
KINDS = [kind for kind in Opcode if kind not in (Opcode.MESSAGE, Opcode.METADATA)]  # messages are in chunks


class Place(NamedTuple):
    """A record in a file."""

    start: int
    kind: int
    length: int


def places_in(content: bytes) -> list[Place]:
    found, start = [], 8
    while start < len(content) - 8:
        kind, length = struct.unpack_from("<BQ", content, start)
        found.append(Place(start, kind, 9 + length))
        start += 9 + length
    return found


def chunks_in(content: bytes) -> list[Place]:
    return [place for place in places_in(content) if place.kind == Opcode.CHUNK]


def flipped(content: bytes, place: int, bit: int = 0) -> bytes:
    return content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :]


def by_chunk(file: Path) -> list[Counter[tuple[str, int, bytes]]]:
    """Return the messages of each chunk, by the library's own reader."""
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        stream.seek(0)
        chunks = [one for one in StreamReader(stream, emit_chunks=True).records if isinstance(one, Chunk)]
    return [
        Counter(
            (summary.channels[one.channel_id].topic, one.log_time, one.data)
            for one in breakup_chunk(chunk)
            if isinstance(one, Message)
        )
        for chunk in chunks
    ]


def messages_in(file: Path) -> Counter[tuple[str, int, bytes]]:
    return sum(by_chunk(file), Counter())


@pytest.fixture
def damaged(run: Path, tmp_path: Path) -> Path:
    """Return a copy of the run, to be damaged."""
    return Path(shutil.copytree(run, tmp_path / "damaged"))


def repaired(folder: Path) -> list[Any]:
    """Repair a record, and return what was logged."""
    with capture_logs() as logs:
        repair_record(folder)
    assert read_mcap(folder / RECORD_FILE).is_complete
    return list(logs)


@pytest.mark.parametrize("number", [0, 7, -1])
def test_a_record_without_a_damaged_chunk_keeps_the_others(run: Path, damaged: Path, number: int) -> None:
    """It was refused as a whole. The first chunk has the schemas and topics of the others."""
    good = (run / RECORD_FILE).read_bytes()
    chunk = chunks_in(good)[number]
    bad = flipped(good, chunk.start + chunk.length // 2, 3)
    (damaged / RECORD_FILE).write_bytes(bad)
    with pytest.raises(ScenarioError, match=r"run\.mcap is damaged: .*: eal records repair .*damaged$"):
        RecordedRun.open(damaged / RECORD_FILE)
    (log,) = repaired(damaged)
    size = chunk.length - 9 - 40 - len("zstd")
    start_ns, end_ns = struct.unpack_from("<QQ", good, chunk.start + 9)
    first_ns = min(time_ns for _, time_ns, _ in messages_in(run / RECORD_FILE))
    times_s = [f"{(time_ns - first_ns) / 1e9:.2f} s" for time_ns in (start_ns, end_ns)]
    assert log["lost"] == f"{size} bytes, from {times_s[0]} to {times_s[1]}"
    assert Path(log["original"]).read_bytes() == bad

    before, after = messages_in(run / RECORD_FILE), messages_in(damaged / RECORD_FILE)
    assert before - by_chunk(run / RECORD_FILE)[number] <= after
    for topic, many in Counter(topic for topic, _, _ in before.elements()).items():
        left = sum(of == topic for of, _, _ in after.elements())
        assert left == many or topic not in (*OF_EVENTS, "/tf", "/roomba-1/TruePose")
        assert left <= many
    assert not {message for message in before - after if message[0] in OF_EVENTS}
    one, other = (read_mcap(folder / RECORD_FILE) for folder in (run, damaged))
    assert (one.attachments, one.metadata) == (other.attachments, other.metadata)
    assert not list(compare_runs(RunFolder.open(run), RunFolder.open(damaged)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_flipped_bit_in_any_place_is_refused_or_changes_nothing(run: Path, damaged: Path, kind: Opcode) -> None:
    """A chunk whose kind was damaged was skipped, and so was what followed a length: the rest counted as the whole."""
    good, whole = (run / RECORD_FILE).read_bytes(), read_mcap(run / RECORD_FILE)
    before = messages_in(run / RECORD_FILE)
    place = next(place for place in places_in(good) if place.kind == kind)
    lost = by_chunk(run / RECORD_FILE)[0] if kind is Opcode.CHUNK else Counter()
    head = range(place.start, place.start + min(place.length, 60), 3)
    for number, at in enumerate([*head, place.start + place.length - 1]):
        bad = flipped(good, at, number % 8)
        (damaged / RECORD_FILE).write_bytes(bad)
        with suppress(ScenarioError):
            content = read_mcap(damaged / RECORD_FILE)
            assert content.attachments == whole.attachments
            assert content.messages == whole.messages
        logs = repaired(damaged)
        after = messages_in(damaged / RECORD_FILE)
        assert before - lost <= after
        assert logs or after == before


def test_a_damaged_start_fails_the_repair(run: Path, damaged: Path) -> None:
    """Nothing else tells when the run started."""
    good = (run / RECORD_FILE).read_bytes()
    clock = next(place for place in places_in(good) if place.kind == Opcode.METADATA)
    for place in (clock.start, clock.start + 1, good.index(b"start_ns"), good.index(b"start_ns") + 15):
        bad = flipped(good, place, 6)
        (damaged / RECORD_FILE).write_bytes(bad)
        with pytest.raises(ScenarioError):
            repair_record(damaged)
        assert (damaged / RECORD_FILE).read_bytes() == bad


def test_a_lost_list_of_resources_is_named(run: Path, damaged: Path) -> None:
    """It was read with another value, or the record was refused."""
    good = (run / RECORD_FILE).read_bytes()
    (damaged / RECORD_FILE).write_bytes(flipped(good, good.index(b'"evbot2-1"') + 2))
    with pytest.raises(ScenarioError, match="crc validation failed in Attachment"):
        read_mcap(damaged / RECORD_FILE)
    (log,) = repaired(damaged)
    assert log["lost"] == "resources.json"
    assert messages_in(damaged / RECORD_FILE) == messages_in(run / RECORD_FILE)


def test_the_first_and_the_last_bytes_may_be_damaged(run: Path, damaged: Path) -> None:
    good = (run / RECORD_FILE).read_bytes()
    for place in (1, len(good) - 3):
        (damaged / RECORD_FILE).write_bytes(flipped(good, place))
        done = CliRunner().invoke(app, ["records", "repair", str(damaged)])
        assert "repaired" in done.output
        assert (damaged / RECORD_FILE).read_bytes() == good


def test_a_damaged_index_loses_nothing(run: Path, damaged: Path) -> None:
    good = (run / RECORD_FILE).read_bytes()
    (index,) = (place for place in places_in(good) if place.kind == Opcode.STATISTICS)
    (damaged / RECORD_FILE).write_bytes(flipped(good, index.start + 12))
    with pytest.raises(ScenarioError, match=r"is damaged: its index is not as it was written"):
        read_mcap(damaged / RECORD_FILE)
    assert not repaired(damaged)
    assert (damaged / RECORD_FILE).read_bytes() == good


def test_without_an_index_a_damaged_length_ends_the_record(run: Path, damaged: Path) -> None:
    """As a crash does; what follows cannot be found, except what the other files have."""
    good = (run / RECORD_FILE).read_bytes()
    chunk = chunks_in(good)[5]
    cut = flipped(good, chunk.start + 5)[: -FOOTER - 500]
    (damaged / RECORD_FILE).write_bytes(cut)
    (log,) = repaired(damaged)
    assert log["lost"].startswith(f"{len(cut) - chunk.start} bytes, from ")
    before, after = messages_in(run / RECORD_FILE), messages_in(damaged / RECORD_FILE)
    assert sum(by_chunk(run / RECORD_FILE)[:5], Counter()) <= after
    assert not {message for message in before - after if message[0] in OF_EVENTS}


def test_without_an_index_the_topics_of_a_damaged_chunk_are_lost(run: Path, damaged: Path) -> None:
    good = (run / RECORD_FILE).read_bytes()
    last = chunks_in(good)[-1]
    first = chunks_in(good)[0]
    bad = flipped(good, first.start + first.length // 2)[: last.start]
    (damaged / RECORD_FILE).write_bytes(bad)
    (log,) = repaired(damaged)
    assert log["lost"].endswith(" s")
    assert Path(log["original"]).read_bytes() == bad
    before, after = messages_in(run / RECORD_FILE), messages_in(damaged / RECORD_FILE)
    assert not {message for message in before - after if message[0] in OF_EVENTS}


def test_damaged_files_are_kept_side_by_side(run: Path, damaged: Path) -> None:
    """A link of a stranger is not followed."""
    good = (run / RECORD_FILE).read_bytes()
    mine = damaged.parent / "mine.txt"
    (damaged / "run.mcap.damaged").symlink_to(mine)
    for number, chunk in zip((1, 2), chunks_in(good), strict=False):
        bad = flipped(good, chunk.start + chunk.length // 2)
        (damaged / RECORD_FILE).write_bytes(bad)
        repaired(damaged)
        assert (damaged / f"run.mcap.damaged{number}").read_bytes() == bad
    assert not mine.exists()


def test_a_repair_unpacks_no_more_than_a_reader(run: Path, damaged: Path) -> None:
    """The size that a chunk claims is no reason to refuse the others, but one that it has is."""
    good = (run / RECORD_FILE).read_bytes()
    chunk = chunks_in(good)[3]
    (damaged / RECORD_FILE).write_bytes(flipped(good, chunk.start + 9 + 16 + 6, 7))
    assert repaired(damaged)
    head = struct.Struct("<QQQII4sQ")
    zeros = bytes(150 * 1024 * 1024)
    packed = zstandard.compress(zeros)
    body = head.pack(0, 1, len(zeros), 0, 4, b"zstd", len(packed)) + packed
    exploding = good[: chunk.start] + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body
    exploding = exploding[: chunks_in(good)[0].start] + exploding[chunk.start :]
    (damaged / RECORD_FILE).write_bytes(exploding)
    with pytest.raises(ScenarioError, match="unpacks to more than"):
        repair_record(damaged)
    assert (damaged / RECORD_FILE).read_bytes() == exploding


def test_an_index_that_lists_a_place_twice_is_refused(run: Path, damaged: Path) -> None:
    """Each of a million entries could name the same chunk."""
    content = bytearray((run / RECORD_FILE).read_bytes())
    one, other = [place for place in places_in(bytes(content)) if place.kind == Opcode.CHUNK_INDEX][:2]
    content[other.start + 25 : other.start + 33] = content[one.start + 25 : one.start + 33]
    (start,) = struct.unpack_from("<Q", content, len(content) - FOOTER + 9)
    struct.pack_into("<I", content, len(content) - 12, zlib.crc32(content[start:-12]))
    (damaged / RECORD_FILE).write_bytes(flipped(bytes(content), chunks_in(bytes(content))[4].start))
    with pytest.raises(ScenarioError, match="its index lists places that cannot be"):
        repair_record(damaged)


def test_a_time_that_no_record_can_have_fails_the_repair(damaged: Path) -> None:
    """It ended with a traceback."""
    with (damaged / "trajectory.csv").open("a", encoding="utf-8") as table:
        table.write("roomba-1,1e12,0,0,0\n")
    with pytest.raises(ScenarioError, match="has a time that no record can have"):
        repair_record(damaged)
    assert not (damaged / f"{RECORD_FILE}.tmp").exists()
