"""Random messages and their round trip as a stream, for the protocols of both EvBots."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from plugins.evbot2.codec import Codec
from plugins.evbot2.messages import ARGUMENTS, BaseReply, BaseRequest, Code, Verb

TAGS = st.integers(0, 65535)


@st.composite
def requests(draw: st.DrawFn, least: int = -(2**31)) -> BaseRequest:
    verb = draw(st.sampled_from(sorted(ARGUMENTS)))
    numbers = st.lists(st.integers(least, 2**31 - 1), min_size=ARGUMENTS[verb], max_size=ARGUMENTS[verb])
    return BaseRequest(verb, draw(TAGS), draw(TAGS), tuple(draw(numbers)))


def replies(most: int, least: int = -(2**31)) -> st.SearchStrategy[BaseReply]:
    """Return replies with up to `most` numbers."""
    numbers = st.lists(st.integers(least, 2**31 - 1), max_size=most).map(tuple)
    return st.builds(BaseReply, st.sampled_from(Verb), TAGS, st.sampled_from(Code), numbers)


def assert_survives(sent: list[Any], sender: Codec[Any, Any], receiver: Codec[Any, Any], data: st.DataObject) -> None:
    """Check that messages arrive in pieces of any size."""
    stream = b"".join(sender.encode(message) for message in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    got = []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += receiver.feed(stream[begin:end])
    assert got == sent


def damaged(message: bytes, data: st.DataObject) -> bytes:
    """Return a message with one changed byte."""
    changed = bytearray(message)
    at = data.draw(st.integers(0, len(changed) - 1))
    changed[at] = data.draw(st.integers(0, 255).filter(lambda byte: byte != changed[at]))
    return bytes(changed)
