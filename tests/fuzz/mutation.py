"""Random bytes and mutations of a corpus, fast enough for a million streams; every choice comes from one seed."""

import random
from collections.abc import Sequence
from pathlib import Path

CORPUS = Path(__file__).parent / "corpus"
_EDGES = (b"\0", b"\xff", b"\x7f", b"\x80", b"\0\0", b"\xff\xff", b"\x7f\xff", b"\x80\0", b"\xff" * 4, b"\0" * 4)


def corpus_bytes(name: str) -> list[bytes]:
    """The entries of one corpus file: hex, one a line; `#` begins a comment."""
    lines = (CORPUS / name).read_text("ascii").splitlines()
    entries = [bytes.fromhex(line.partition("#")[0]) for line in lines]
    return [entry for entry in entries if entry]


class Mutator:
    """Makes bytes from a corpus, by a few changes at places drawn evenly."""

    def __init__(self, rng: random.Random, corpus: Sequence[bytes]) -> None:
        self.rng = rng
        self._corpus = list(corpus)

    def random_bytes(self, most: int) -> bytes:
        """0 to `most` even bytes."""
        return self.rng.randbytes(self.rng.randrange(most + 1))

    def made(self, most: int = 600) -> bytes:
        """One in eight wholly random, the others mutated entries of the corpus."""
        rng = self.rng
        if rng.random() < 0.125:
            return self.random_bytes(most // 4)
        data = bytearray(rng.choice(self._corpus))
        while rng.random() < 0.4:
            data += rng.choice(self._corpus)
        while rng.random() < 0.7:
            self._change(data)
        return bytes(data[:most])

    def _change(self, data: bytearray) -> None:
        rng = self.rng
        kind = rng.randrange(8)
        at = rng.randrange(len(data) + 1)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and at < len(data):
            data[at] = rng.randrange(256)
        elif kind == 2:
            data[at:at] = rng.randbytes(rng.randrange(1, 8))
        elif kind == 3:
            del data[at : at + rng.randrange(1, 8)]
        elif kind == 4:
            edge = rng.choice(_EDGES)
            data[at : at + len(edge)] = edge
        elif kind == 5:
            end = at + rng.randrange(1, 24)
            data[at:at] = data[at:end]
        elif kind == 6:
            del data[at:]
        else:
            data[at:at] = rng.choice(self._corpus)
