"""A text of numbers as its author left it: encoding, delimiter, decimal sign, title and header.

What is read is told in words, so that a person sees what was taken for what.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vidphys.data.formats.bounded import LONGEST_NAME, MOST_COLUMNS, require_text
from vidphys.data.formats.headed import beneath
from vidphys.data.formats.names import is_unit
from vidphys.data.formats.wrapped import semicolons, unwrapped
from vidphys.errors import InputError

COMMENTS = ("#", "%", "//")
SYMBOL = re.compile(r"[^\W\d]\w{0,2}")  # such as x, y1 or θ2
SETTING = re.compile(r":\s*[-+]?\d")  # a name and its value, which name no column
MISSING = frozenset({"", "na", "n/a", "#n/a", "nan", "null", "none", "-", "--", "?", "inf", "-inf"})
MINUS = "\N{MINUS SIGN}"  # as it is printed
SAMPLE = 200  # lines that the delimiter is told from
LEAST = 0.5  # share of numbers in a row of data, or in a column of numbers


@dataclass(frozen=True)
class Dialect:
    """What stands between numbers (``None``: blanks), and within them."""

    delimiter: str | None
    decimal: str

    def __str__(self) -> str:
        names = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", None: "blanks"}
        comma = ", decimal commas" if self.decimal == "," else ""
        return f"numbers between {names[self.delimiter]}{comma}"

    def cells(self, line: str) -> list[str]:
        """The cells of a line, without quotes."""
        if self.delimiter is None:
            quoted = re.findall(r'"([^"]*)"|(\S+)', line)
            return [a or b for a, b in quoted]
        try:
            row = next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), [])
        except csv.Error as error:
            raise InputError(f"not a table ({error})") from error
        return [cell.strip() for cell in row]

    def number(self, cell: str) -> float | None:
        """A cell as a number, as :func:`number` has it, with this decimal sign."""
        return number(cell.replace(",", ".") if self.decimal == "," else cell)


def number(cell: str) -> float | None:
    """A cell as a number, NaN where it says that there is none, ``None`` where it is a word."""
    if cell.lower() in MISSING:
        return np.nan
    try:
        return float(cell.replace(MINUS, "-"))
    except ValueError:
        return None


DIALECTS = tuple(
    Dialect(delimiter, decimal)
    for delimiter, decimals in ((";", ".,"), ("\t", ".,"), (",", "."), ("|", ".,"), (None, ".,"))
    for decimal in decimals
)


@dataclass(frozen=True)
class Sheet:
    """Columns of a text.

    Args:
        names: of the first columns; none in a text of numbers alone.
        labels: whom a column is of, where a line above the names says so; as many as names.
        columns: ``(rows,)`` each: numbers, or words.
        body: of each row, where the text has a block under a title for each; else ``None``.
        notes: how it was read.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    columns: tuple[np.ndarray, ...]
    body: np.ndarray | None
    notes: tuple[str, ...]


def decoded(path: Path) -> str:
    """The text of a file, by its byte order mark, as UTF-8, or as Latin-1.

    Raises:
        InputError: no text.
    """
    require_text(path)
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    elif b"\x00" in data[1:200:2] and b"\x00" not in data[:200:2]:
        text = data.decode("utf-16-le", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    if "\x00" in text:
        raise InputError("not a text of numbers, but bytes; write a table as CSV, Parquet or NPZ")
    return text


def holds_numbers(path: Path) -> bool:
    """Whether a text looks like a table: most of its lines are rows of numbers."""
    try:
        lines = beneath([line for line in decoded(path).splitlines() if line.strip()])
        return _mostly_numbers(lines[:SAMPLE])
    except InputError:
        return False


def is_table(path: Path) -> bool:
    """Whether a file, whatever it is called, is a text that looks like a table."""
    return path.is_file() and holds_numbers(path)


def _mostly_numbers(lines: Sequence[str]) -> bool:
    rows = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    dialect = _dialect(rows)
    good = sum(_is_data(dialect, dialect.cells(line)) for line in rows)
    return good >= 2 and good > LEAST * len(rows)


def read_sheet(lines: Iterable[str]) -> Sheet:
    """Read the lines of a text of numbers in whatever dialect.

    Raises:
        InputError: no rows of numbers, or more names than columns.
    """
    lines = [line.rstrip("\r\n") for line in lines if line.strip(" ;,\t\r\n")]
    if lines and re.fullmatch(r"sep=.", lines[0].strip()):
        lines = lines[1:]
    lines = semicolons(unwrapped(beneath(lines)))
    plain = [line for line in lines if not line.lstrip(' "').startswith(COMMENTS)]
    dialect = _dialect(plain)
    blocks = _blocks(lines, dialect)
    if not blocks:
        seen = lines[0][:60] if lines else "nothing"
        raise InputError(
            f"no rows of numbers ('{seen}'); a table has a line of names such as t,x,y and a row "
            "of numbers for each time"
        )
    rows = [row for _, block in blocks for row in block]
    width = _width(rows)
    if width > MOST_COLUMNS:
        raise InputError(f"{width} columns, more than {MOST_COLUMNS}")
    names, labels = _named(blocks[0][0], dialect, width)
    long = next((name for name in names if len(name) > LONGEST_NAME), None)
    if long is not None:
        raise InputError(f"the name of a column, '{long[:40]} ...', is no name")
    if len(names) > width:
        if not any(len(row) == len(names) for row in rows):
            raise InputError(
                f"{width} numbers in a row, but {len(names)} names: {', '.join(names)}; "
                "give each column one name"
            )
        width = len(names)
        rows = [row + [""] * (width - len(row)) for row in rows]
    notes = [str(dialect)]
    even = [len(row) >= width for row in rows]
    titles = [_title(head, dialect) for head, _ in blocks]
    whom = [title for title, (_, block) in zip(titles, blocks, strict=True) for _ in block]
    if not all(even):
        notes.append(f"{len(even) - sum(even)} incomplete rows left out")
    kept = [row[:width] for row, good in zip(rows, even, strict=True) if good]
    columns = [_column(cells, dialect) for cells in zip(*kept, strict=True)]
    body = None
    if len(blocks) > 1 and len(set(titles)) == len(blocks):
        body = np.array([w for w, good in zip(whom, even, strict=True) if good])
    used = [k for k, c in enumerate(columns) if k < len(names) or not _empty(c)]
    return Sheet(names, labels, tuple(columns[k] for k in used), body, tuple(notes))


def _width(rows: Sequence[Sequence[str]]) -> int:
    """Cells of a usual row; one cell beside rows of several is a row whose others are missing."""
    widths = Counter(len(row) for row in rows)
    several = Counter({width: count for width, count in widths.items() if width > 1})
    usual = several if several.total() > 1 else widths
    return usual.most_common(1)[0][0]


def _dialect(lines: Sequence[str]) -> Dialect:
    """The one that makes numbers of most cells; where several do, of most of them."""
    picked = lines[:: max(1, len(lines) // SAMPLE)]

    def score(dialect: Dialect) -> tuple[float, int, int]:
        rows = [dialect.cells(line) for line in picked]
        usual = Counter(len(row) for row in rows if row).most_common(1)
        width = usual[0][0] if usual else 0
        told, count = 0.0, 0
        for row in rows:
            numbers = [dialect.number(cell) for cell in row]
            share = sum(n is not None for n in numbers) / max(len(row), 1)
            count += len(row) if share == 1 else 0
            if (
                len(row) == width
                and share >= LEAST
                and any(n == n for n in numbers if n is not None)
            ):
                told += share
        return round(told / max(len(picked), 1), 6), width, count

    return max(DIALECTS, key=score)


def _is_data(dialect: Dialect, row: Sequence[str]) -> bool:
    numbers = [dialect.number(cell) for cell in row if cell.lower() not in MISSING]
    return sum(n is not None for n in numbers) > 0.3 * max(len(numbers), 1)


def _blocks(lines: Sequence[str], dialect: Dialect) -> list[tuple[list[str], list[list[str]]]]:
    """Runs of rows of numbers, each with the lines above it."""
    blocks: list[tuple[list[str], list[list[str]]]] = []
    above: list[str] = []
    first: list[str] | None = None
    for line in lines:
        row = dialect.cells(line)
        comment = line.lstrip(' "').startswith(COMMENTS)
        if comment or not _is_data(dialect, row):
            above.append(line)
            continue
        if not blocks or (first is not None and first[-1] in above):
            blocks.append((above, []))
            first = above if above else None
        above = []
        blocks[-1][1].append(row)
    return blocks


def _header_cells(line: str, dialect: Dialect, width: int) -> list[str]:
    """A line of names, cut as the numbers are, or else as it gives as many names as numbers."""
    text = line.strip(" \r\n")
    for mark in COMMENTS:
        text = text.removeprefix(mark).lstrip(" ") if mark != "//" else text.removeprefix(mark)
    ways = [dialect.cells(text), *(d.cells(text) for d in DIALECTS if d.decimal == ".")]
    ways.append([cell for cell in re.split(r"\s{2,}", text.strip()) if cell])
    joined = re.sub(r"(?<!\s)\s+(?=[\[(])", "_", text.strip())
    ways.append([cell.replace("_", " ") if "[" in cell else cell for cell in joined.split()])
    ways = [_trimmed(way) for way in ways]
    symbols = text.split()  # of some columns, with blanks between them where the numbers have tabs
    apart = len(ways[0]) == 1 < len(symbols) <= width and all(map(SYMBOL.fullmatch, symbols))
    return next((way for way in ways if len(way) == width), symbols if apart else ways[0])


def _trimmed(cells: list[str]) -> list[str]:
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _named(
    above: Sequence[str], dialect: Dialect, width: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the columns and labels of whom they are, from the lines above the numbers."""
    spoken = [line for line in above if not line.lstrip(' "').startswith(COMMENTS)]
    candidates = spoken or list(above)
    heads = [_header_cells(line, dialect, width) for line in candidates]
    if not spoken:  # a comment names columns only if it has about as many words as there are
        heads = [head for head in heads if head and len(head) <= width]
        heads = heads[-2:] if heads and _are_units(heads[-1]) else heads[-1:]
        words = [word for head in heads for word in head]
        if any(len(word) > 24 or SETTING.search(word) for word in words):
            heads = []
    if not heads:
        return (), ()
    names, rest = heads[-1], heads[:-1]
    if rest and _are_units(names):
        units, names, rest = names, rest[-1], rest[:-1]
        units += [""] * (len(names) - len(units))
        pairs = zip(names, (u.strip("[](){} ") for u in units), strict=False)
        names = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
    labels = [""] * len(names)
    if rest and sum(bool(cell) for cell in rest[-1]) > 1:
        whom = ""
        for k in range(len(names)):
            whom = (rest[-1][k] if k < len(rest[-1]) else "") or whom
            labels[k] = whom
    return tuple(names), tuple(labels)


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a line below the names says their units."""
    return len(cells) > 1 and any(cells) and all(is_unit(cell) for cell in cells)


def _title(above: Sequence[str], dialect: Dialect) -> str:
    """What stands alone above the names of a block."""
    spoken = [line for line in above if not line.lstrip().startswith(COMMENTS)]
    alone = [cells for line in spoken[:-1] if len(cells := _trimmed(dialect.cells(line))) == 1]
    return alone[-1][0] if alone else ""


def _column(cells: Sequence[str], dialect: Dialect) -> np.ndarray:
    """Numbers, where most are; words otherwise."""
    numbers = [dialect.number(cell) for cell in cells]
    words = sum(n is None for n in numbers)
    if words > LEAST * len(cells):
        return np.array(cells)
    return np.array([np.nan if n is None else n for n in numbers])


def _empty(column: np.ndarray) -> bool:
    return column.dtype.kind == "f" and not np.isfinite(column).any()
