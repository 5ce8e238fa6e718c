"""Tables of numbers as an operator writes them: CSV in, columns with their file lines out, all faults at once.

UTF-8, comma, decimal point, header required; blank lines and lines beginning with # are left out; an empty cell is
a missing value.
"""

import csv
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_FAULTS = 20
"""More faults than this are counted, not listed."""
LARGEST = 1e18
"""No instrument gives more, and sums and squares of numbers below it stay finite, so nobody else need ask."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NumberTable:
    """The known columns of a file; every array has shape [rows]."""

    columns: dict[str, Floats]
    """By name; NaN where the cell is empty, arrays having no other way. A column without any value is left out."""
    row: Integers
    """1-based line of the file, for messages."""
    ignored: tuple[str, ...]
    """Columns that are not known here."""
    source: str

    def where(self, index: int, column: str) -> str:
        """The place of one cell as a person looks for it."""
        return f"{self.source} line {self.row[index]}, column {column}"


def read_number_table(
    data: bytes, *, source: str, required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> NumberTable:
    """Parse a table; ContractError lists by line what is wrong with its form and its numbers."""
    header, header_where, rows, faults = _cells(data, source)
    known = (*required, *optional)
    raise_faults(_header_faults(header, required, known, header_where) + faults, source)
    if not rows:
        raise ContractError([Fault(where=source, expected="at least one reading", found="only a header")])
    lines = np.array([line for line, _ in rows], dtype=np.int64)
    columns: dict[str, Floats] = {}
    for place, name in enumerate(header):
        texts = [cells[place] for _, cells in rows]
        if name in known and (name in required or any(texts)):
            columns[name] = _numbers(name, texts, lines, source, faults)
    raise_faults(faults, source)
    ignored = tuple(name for name in header if name not in known)
    return NumberTable(columns=columns, row=lines, ignored=ignored, source=source)


def integer_faults(
    table: NumberTable, name: str, *, lowest: int | None = None, highest: int | None = None
) -> list[Fault]:
    """One fault for each cell of the column that is empty, no whole number or outside the limits."""
    span = "" if lowest is None else f" from {lowest}" + ("" if highest is None else f" to {highest}")
    return [
        Fault(
            where=table.where(index, name),
            expected=f"a whole number{span}",
            found="an empty cell" if math.isnan(value) else f"{value:g}",
        )
        for index, value in enumerate(table.columns[name].tolist())
        if math.isnan(value)
        or value != round(value)
        or (lowest is not None and value < lowest)
        or (highest is not None and value > highest)
    ]


def raise_faults(faults: list[Fault], source: str) -> None:
    """ContractError with all faults, the overflow counted; nothing where there is none."""
    if not faults:
        return
    if len(faults) > MAX_FAULTS:
        found = f"{len(faults) - MAX_FAULTS} more like these"
        faults = [*faults[:MAX_FAULTS], Fault(where=source, expected="no further faults", found=found)]
    raise ContractError(faults)


def _cells(data: bytes, source: str) -> tuple[list[str], str, list[tuple[int, list[str]]], list[Fault]]:
    """The header and its place, the rows with their line numbers, and what is wrong with their form."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        where = f"{source} line {line}"
        found = f"byte 0x{data[error.start]:02x}"
        raise ContractError([Fault(where=where, expected="UTF-8 text", found=found)]) from error
    header: list[str] | None = None
    header_where = source
    rows: list[tuple[int, list[str]]] = []
    faults: list[Fault] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where = f"{source} line {number}"
        try:
            cells = [cell.strip() for cell in next(csv.reader([line], strict=True))]
        except csv.Error as error:
            faults.append(Fault(where=where, expected="a line of CSV", found=str(error)))
            continue
        if header is None:
            header, header_where = cells, where
        elif len(cells) != len(header):
            advice = "is a decimal comma in it?" if len(cells) > len(header) else ""
            expected = f"{len(header)} cells"
            faults.append(Fault(where=where, expected=expected, found=f"{len(cells)} cells", advice=advice))
        elif any(cells):
            rows.append((number, cells))
    if header is None:
        found = "an empty file"
        faults.insert(0, Fault(where=source, expected="a header line with column names", found=found))
        raise_faults(faults, source)
    return header or [], header_where, rows, faults


def _header_faults(
    header: list[str], required: tuple[str, ...], known: tuple[str, ...], where: str
) -> list[Fault]:
    faults: list[Fault] = []
    missing = [name for name in required if name not in header]
    if missing:
        advice = "columns are separated by commas" if any(";" in n or "\t" in n for n in header) else ""
        expected = f"the columns {', '.join(missing)}"
        faults.append(Fault(where=where, expected=expected, found=", ".join(header), advice=advice))
    faults += [
        Fault(
            where=where,
            expected="each column once",
            found=f"{name} {header.count(name)} times",
        )
        for name in known
        if header.count(name) > 1
    ]
    return faults


def _numbers(name: str, texts: list[str], lines: Integers, source: str, faults: list[Fault]) -> Floats:
    values = np.full(len(texts), np.nan)
    for index, text in enumerate(texts):
        if text == "":
            continue
        try:
            # float() takes 1_000 for a number; no instrument writes that.
            number = float(text) if "_" not in text else math.nan
        except ValueError:
            number = math.nan
        where = f"{source} line {lines[index]}, column {name}"
        if not math.isfinite(number):
            faults.append(Fault(where=where, expected="a finite number", found=repr(text)))
        elif abs(number) > LARGEST:
            faults.append(Fault(where=where, expected=f"a number from -{LARGEST:g} to {LARGEST:g}", found=text))
        values[index] = number
    return values
