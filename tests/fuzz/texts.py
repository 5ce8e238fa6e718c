"""Configurations, presets, certificates and models that somebody wrote: taken, or refused by name."""

import random
import time
from collections.abc import Callable
from pathlib import Path

from tests.fuzz.mutation import CORPUS, Mutator

from trueangle.config import DaemonConfig, parse_config
from trueangle.contract.errors import ContractError
from trueangle.core.certificate_role import MAX_ROLE_CHARACTERS, role_of_certificate
from trueangle.core.presets import MAX_PRESETS_BYTES, read_presets
from trueangle.edges.onnx_model import load_model

MODELS = Path(__file__).parents[1] / "data" / "models"
MAX_SECONDS = 20.0
"""Processor time for one text; ordinary ones take 10 ms, so this is only passed by what does not end."""
MAX_TEXT = 20_000

TOKENS = (
    *("0", "-1", "1", "010", "0x10", "0b1", "0o17", "1:10", "1e3", "1e400", "-1e400", "1.5", ".5", "5.", "-.inf"),
    *(".inf", ".nan", ".NaN", "~", "null", "true", "no", "''", '""', "text", "[]", "{}", "[[]]", "{a: {b: [c]}}"),
    *(
        "2026-02-30",
        "2026-01-01",
        "2026-01-01 25:00:00",
        "9" * 400,
        "9" * 5000,
        "0x" + "f" * 5000,
        "1" * 30 + ".5",
    ),
    *(
        "&a 1",
        "*a",
        "*second",
        "&x [*x]",
        "&x {y: *x}",
        "<<: *second",
        "<<: [*second]",
        "<<: 1",
        "? [a]",
        "? {a: b}",
    ),
    *("!!int x", '!!int ""', '!!float ""', "!!bool x", "!!null x", "!!timestamp x", "!!binary x", "!!binary é"),
    *("!!str 5", "!!set {a}", "!!omap [a: 1]", "!!pairs [a]", "!!python/object:os.system x", "!x y", "!<tag> z"),
    *("\0", "\ufeff", "\u2028", "\ud800", "é", "\U0001f600", "\u202e", "\x85", "\x7f", '"\\0"', '"\\ud800"'),
    *(
        '"\\U0001f600"',
        "|\n  a",
        ">\n  b",
        "%YAML 9.9\n---",
        "---",
        "...",
        "- - - -",
        "\t",
        "# x",
        ": :",
        "@",
        "`",
    ),
)


class TextMutator:
    """Changes lines, characters and values of texts that are right."""

    def __init__(self, rng: random.Random, corpus: list[str]) -> None:
        self._rng = rng
        self._corpus = corpus

    def made(self) -> str:
        """One mutated text."""
        rng = self._rng
        text = rng.choice(self._corpus)
        for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
            text = self._changed(text)
        return text[:MAX_TEXT]

    def _changed(self, text: str) -> str:
        rng = self._rng
        at = rng.randrange(len(text) + 1)
        kind = rng.randrange(8)
        if kind == 0:
            return text[:at] + rng.choice(TOKENS) + text[at:]
        if kind == 1:
            return text[:at] + chr(rng.randrange(1, 256)) + text[at + 1 :]
        if kind == 2:
            return text[:at] + text[at + rng.randrange(1, 20) :]
        if kind in (3, 4):
            colon = text.find(": ", at)
            end = min((i for i in (text.find(mark, colon + 2) for mark in "\n,}") if i > 0), default=len(text))
            return text if colon < 0 else text[: colon + 2] + rng.choice(TOKENS) + text[end:]
        lines = text.split("\n")
        row = rng.randrange(len(lines))
        if kind == 5:
            lines.insert(rng.randrange(len(lines)), lines[row])
        elif kind == 6:
            del lines[row]
        else:
            lines[row] = " " * rng.randrange(8) + lines[row].lstrip()
        return "\n".join(lines)


def try_config(text: str) -> DaemonConfig | None:
    """The configuration or None where it is refused; any other error, and a text without end, is the finding."""
    begun_s = time.process_time()
    try:
        config = parse_config(text, source="fuzz.yaml")
    except ContractError as error:
        told, config = str(error), None
    else:
        told = "taken"
    assert told
    assert time.process_time() - begun_s < MAX_SECONDS
    return config


class TextFuzz:
    """One of each kind a call."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._configs = TextMutator(
            rng, [path.read_text("utf-8") for path in sorted((CORPUS / "config").iterdir())]
        )
        self._presets = TextMutator(rng, [(CORPUS / "presets.json").read_text("utf-8")])
        self._certificates = Mutator(rng, [bytes.fromhex((CORPUS / "certificate.hex").read_text("ascii"))])
        self._models = Mutator(rng, [(MODELS / "good.onnx").read_bytes()])
        self.taken = 0
        """Configurations that were still right."""

    def one_config(self) -> None:
        """A mutated configuration."""
        self.taken += try_config(self._configs.made()) is not None

    def one_preset_file(self) -> None:
        """A mutated file of presets: refused, or all of it in range."""
        text = self._presets.made()[:MAX_PRESETS_BYTES]
        try:
            presets = read_presets(text, source="presets.json")
        except ContractError:
            return
        assert all(1 <= one.slot <= 32 and 0 <= one.user_zero_mas < 1_296_000_000 for one in presets)

    def one_certificate(self) -> None:
        """A mutated certificate: a role that its bytes hold, or none."""
        der = self._certificates.made(2000)
        role = role_of_certificate(der)
        assert role is None or (1 <= len(role) <= MAX_ROLE_CHARACTERS and role.encode() in der)

    def one_model(self, path: Path) -> None:
        """A damaged model file: refused whatever the damage, because it carries its own hash."""
        rng = self._rng
        data = bytearray((MODELS / "good.onnx").read_bytes())
        for _ in range(rng.choice((1, 1, 2, 5, 20))):
            at = rng.randrange(len(data))
            if rng.random() < 0.7:
                data[at] ^= rng.randrange(1, 256)
            elif rng.random() < 0.5:
                del data[at : at + rng.randrange(1, 200)]
            else:
                data[at:at] = rng.randbytes(rng.randrange(1, 20))
        if bytes(data) == (MODELS / "good.onnx").read_bytes():
            return
        path.write_bytes(data)
        refused(lambda: load_model(path))


def refused(call: Callable[[], object]) -> None:
    """ContractError and nothing else."""
    try:
        call()
    except ContractError:
        return
    raise AssertionError("damaged, and taken")
