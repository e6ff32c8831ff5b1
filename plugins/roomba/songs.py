"""The songs of a Roomba: the interface of a real and of a simulated one."""

from __future__ import annotations

from typing import Final

from eal_actors.plugin import (
    ArgumentError,
    DataType,
    Resource,
    ResourceType,
    UnavailableError,
    ValueInfo,
    request,
    setting,
)

NOTES: Final = ValueInfo(
    DataType.CHAR, description="MIDI notes 31..127, or 0 for a rest, each with 1/64 s 1..255: 72:16 0:16 79:32"
)

_NUMBER: Final = ValueInfo(DataType.INT, None, 0, 15)
_MOST_NOTES: Final = 16
_PITCHES: Final = (0, *range(31, 128))


class SongBook(Resource):
    """Stored songs of notes; get_status: 0 is silent, 1 plays."""

    types = ResourceType.ACTUATOR

    number: int = setting(_NUMBER, "Number of the song that the commands and the request use.")

    def __init__(self) -> None:
        self.number = 0
        self._songs: dict[int, str] = {}

    def remaining_s(self) -> float:
        """Return the time until the playing song ends; 0 or less if none plays."""
        raise NotImplementedError

    def get_status(self) -> int:
        """Return 0 while it is silent, 1 while it plays."""
        return int(self.remaining_s() > 0)

    def halt(self) -> None:
        """Do nothing: a song moves nothing, and a playing song cannot be stopped."""

    @request("notes", ValueInfo(DataType.CHAR))
    def notes(self) -> str:
        """Return the stored notes of the song; empty for none."""
        return self._songs.get(self.number, "")

    def playable_notes(self) -> list[tuple[int, int]]:
        """Return the notes of the selected song.

        Raises:
            ArgumentError: it has no notes.
            UnavailableError: a song plays.
        """
        if self.number not in self._songs:
            raise ArgumentError(f"song {self.number} has no notes yet; the command notes sets them")
        if (left_s := self.remaining_s()) > 0:
            raise UnavailableError(f"a song plays for another {left_s:.2f} s, and cannot be stopped")
        return parse_notes(self._songs[self.number])


def duration_s(notes: list[tuple[int, int]]) -> float:
    """Return the duration of a song."""
    return sum(duration for _, duration in notes) / 64


def parse_notes(text: str) -> list[tuple[int, int]]:
    """Return the pairs of note, 0 for a rest, and duration in 1/64 s of a text such as `72:16 0:16 76:32`.

    Raises:
        ArgumentError: the text has another form, a number is out of range, or there are too few or too many notes.
    """
    notes = []
    for word in text.split():
        note, _, duration = word.partition(":")
        if not (note.isdecimal() and duration.isdecimal() and int(note) in _PITCHES and 1 <= int(duration) <= 255):
            raise ArgumentError(f"{word!r} is no note 31..127, or rest 0, with its 1/64 s 1..255, as in 72:16")
        notes.append((int(note), int(duration)))
    if not 1 <= len(notes) <= _MOST_NOTES:
        raise ArgumentError(f"a song has 1..{_MOST_NOTES} notes, not {len(notes)}")
    return notes
