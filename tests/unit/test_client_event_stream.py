"""Reading of text/event-stream, in pieces of any size."""

import pytest

from chamfer_morph.client.event_stream import EventStreamDecoder, Message

STREAM = (
    b": a comment\r\n"
    b"retry: 1000\n\n"
    b"event: frame\nid: 1\ndata: {\"frame\": 0}\n\n"
    b"data:one\rdata: two\r\r"
    b"id\nevent: empty\n\n"
    b"id: 7\r\ndata: \xe2\x80\xa8 is no line end\r\n\r\n"
    b"data: never finished\n"
)  # fmt: skip
MESSAGES = [
    Message("1", "frame", '{"frame": 0}'),
    Message("1", "message", "one\ntwo"),
    Message("7", "message", "\u2028 is no line end"),
]


@pytest.mark.parametrize("size", [1, 2, 3, 7, len(STREAM)])
def test_messages_do_not_depend_on_how_the_bytes_arrive(size):
    """All three line ends, comments, fields without a value, and text beyond ASCII."""
    stream = EventStreamDecoder()
    found = []
    for start in range(0, len(STREAM), size):
        found += stream.feed(STREAM[start : start + size])
    assert found == MESSAGES


def test_a_message_comes_as_soon_as_it_is_whole():
    """The empty line completes it; nothing waits for the next message."""
    stream = EventStreamDecoder()
    assert stream.feed(b"data: x\n") == []
    assert stream.feed(b"\n") == [Message("", "message", "x")]
