"""What HTTP itself asks for: bodies, encodings, cursors, conditional requests, problems."""
