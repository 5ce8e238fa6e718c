"""Errors that daemon and laboratory share; the type says who must act."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

LONGEST_WORD = 100
"""Quoted from an input, without a space; a cell may hold thousands of digits, which would push all else away."""
WORD_SHOWN = 40


class TrueangleError(Exception):
    """The root of every error that trueangle raises on purpose."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One thing wrong with one input: where it is, what belongs there, what stands there, what to try."""

    where: str
    """File with line or row, or the dotted path inside it."""
    expected: str
    found: str
    advice: str = ""

    def __str__(self) -> str:
        text = f"{self.where}: expected {self.expected}, found {_cut(self.found)}"
        return f"{text}; {self.advice}" if self.advice else text


def _cut(text: str) -> str:
    """The text with overlong words shortened."""
    return re.sub(
        rf"\S{{{LONGEST_WORD},}}", lambda word: f"{word[0][:WORD_SHOWN]}... ({len(word[0])} characters)", text
    )


class ContractError(TrueangleError):
    """An input that breaks its contract: the operator or the trainer must mend it. All faults at once."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))
