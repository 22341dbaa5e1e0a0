"""What a worker sends its engine process on standard input, a byte each."""

HEARTBEAT = b"."
"""The worker lives."""

STOP = b"s"
"""Make a result of the finished frames and end."""
