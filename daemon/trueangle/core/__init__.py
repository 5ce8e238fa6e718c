"""Pure rules of the running daemon: bytes and time come in as arguments."""
