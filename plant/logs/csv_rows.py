"""The rows of a CSV file, read line by line: text in, numbers out, and the line where it went wrong."""

from __future__ import annotations

import array as packed

import numpy as np

__all__ = ["read_rows"]

_LONGEST = 1 << 20  # characters of a line
_MOST = 1 << 25  # numbers of a file, 256 MiB


def read_rows(path, *, comment=None, table=False):
    """Read the numbers of a CSV file.

    Parameters
    ----------
    path : str or Path
    comment : callable, optional
        Called with the number and the text of every line that starts with #.
    table : bool
        A log of others: cells may be empty (NaN), and may be separated by semicolons or tabs, as in the heading.

    Returns
    -------
    names : list of str, or None
        From the heading, if there is one.
    rows : (N, columns) numpy.ndarray

    Raises
    ------
    ValueError
        A cell that is no number, a short row, no row; with the line, without the path.
    """
    names, width, separator, values = None, None, ",", packed.array("d")
    with open(path, encoding="utf-8-sig") as file:
        for count, line in enumerate(_lines(file), 1):
            line = line.strip() if not table else line.strip(" \r\n")
            if not line:
                continue
            if line.startswith("#"):
                if comment is not None:
                    comment(count, line)
                continue
            if table and width is None and names is None:
                separator = max(",;\t", key=line.count)
            cells = line.split(separator)
            if names is None and not values and any(_is_name(cell, table) for cell in cells):
                names, width = [cell.strip().strip('"') for cell in cells], len(cells)
                continue
            try:
                values.extend([float(cell) if not table or cell.strip() else np.nan for cell in cells])
            except ValueError:
                raise ValueError(f"line {count} must be numbers; got {line[:60]!r}. Correct it.") from None
            width = width or len(cells)
            if len(cells) != width:
                raise ValueError(f"line {count} must have {width} cells; got {len(cells)}. Complete it.")
            if len(values) > _MOST:
                raise ValueError(f"must hold at most {_MOST} numbers; got more. Cut the log into several files.")
    if not values:
        raise ValueError("must hold samples; got no row of numbers. Check that it was written to the end.")
    return names, np.array(values).reshape(-1, width)


def _lines(file):
    """Lines of bounded length: a file without line ends must not be taken into memory as one."""
    count = 0
    try:
        while line := file.readline(_LONGEST):
            count += 1
            if len(line) == _LONGEST:
                raise ValueError(f"line {count} must be shorter than {_LONGEST} characters. Check the line ends.")
            yield line
    except UnicodeDecodeError as error:
        got = f"byte 0x{error.object[error.start]:02x}"
        raise ValueError(f"must be text in UTF-8; got {got}. Save it as CSV in UTF-8.") from None


def _is_name(cell, table):
    """Whether a cell of the first line is a name: it is no number, and in a file of ours begins with a letter."""
    cell = cell.strip()
    try:
        float(cell or "nan")
    except ValueError:
        return table or cell[0].isalpha()
    return False
