"""Tables as programs print them: bars round the rows, brackets, or long rows in pieces."""

import re
from collections.abc import Sequence

from imgloc.errors import ScanError

Line = tuple[str, str]  #: where a line stands, and its text

_RULE = re.compile(r"[-+|:=\s]*--[-+|:=\s]*|[(\[]\d+ rows?\b.*|\w+ *=")
# MATLAB and Octave have a line before rows that go on, R has a number in front.
_BLOCK = re.compile(
    r"Columns? (\d+)(?: (?:through|to|and) \d+)?:? *$|\[(\d+)\](?=[-+.\seE\dInfaNA]+$)"
)
_ARRAY = re.compile(r"(?i)\w+ *= *(\[|(np\.)?array|$)")
_FACTOR = re.compile(r"\d\.0*e[-+]\d+ *\*", re.IGNORECASE)
_LEFT_OUT = re.compile(r"(?<![^\s,\[|])\.{2,3}(?![^\s,\]|])")
_BRACKETS = re.compile(
    r"(?i)(\w+ *= *)?(array\(('\w', *)?)?\[[-+.\s\[\]\deinfa,]*(, *dtype=\w+)?\)?$"
)
_WHOLE = "write all, with NumPy's savetxt, MATLAB's writematrix, R's write.csv or pandas' to_json"


def unprinted(lines: Sequence[Line]) -> list[Line]:
    """The lines, one for each row; ScanError for a print that leaves out numbers, or digits.

    Examples
    --------
    >>> [text for _, text in unprinted([("", "| 1 | 2 |"), ("", "|---|--:|"), ("", "| 3 | 4 |")])]
    [' 1 | 2 ', ' 3 | 4 ']
    >>> [text for _, text in unprinted([("", "[[1. 2."), ("", "  3.]"), ("", " [4. 5. 6.]]")])]
    ['1. 2.   3.', '4. 5. 6.']
    >>> rows = "Columns 1 through 2", "1 2", "3 4", "Column 3", "5", "6"
    >>> [text for _, text in unprinted([("", row) for row in rows])]
    ['1 2 5', '3 4 6']
    >>> for rows in (("ranges = [1. 2.]", "angles = [0. 1.]"), ("Columns 3 through 4", "1 2")):
    ...     try:
    ...         unprinted([("a.txt", row) for row in rows])
    ...     except ScanError as error:
    ...         print(str(error).partition(": write")[0])
    a.txt: a second array, expected the ranges alone
    a.txt: what was printed before it is missing
    >>> unprinted([("", "[]")]), unprinted([("", "Column 1,angle,range")])
    ([], [('', 'Column 1,angle,range')])
    """
    for where, text in lines:
        if ".." in text and _LEFT_OUT.search(text):
            raise ScanError(f"{where}: it was printed shortened, with dots for numbers: {_WHOLE}")
        if _FACTOR.fullmatch(text):
            raise ScanError(f"{where}: it was printed with four digits and a factor: {_WHOLE}")
    arrays = [where for where, text in lines if _ARRAY.match(text)]
    if len(arrays) > 1:
        raise ScanError(f"{arrays[1]}: a second array, expected the ranges alone: {_WHOLE}")
    lines = [line for line in lines if not _RULE.fullmatch(line[1])]
    if lines and all(text[:1] == text[-1:] == "|" for _, text in lines):
        return [(where, text[1:-1]) for where, text in lines]
    if lines and _BRACKETS.match(lines[0][1]) and re.search(r"\](, *dtype=\w+)?\)?$", lines[-1][1]):
        inside = re.findall(r"\[([^\[\]]*)\]", " ".join(text for _, text in lines))
        return [(lines[0][0], row) for row in inside if row.strip()]
    rows, table, k = list[Line](), 0, 0
    for where, text in lines:
        if found := _BLOCK.match(text):
            if not rows and "1" not in found.groups():
                raise ScanError(f"{where}: what was printed before it is missing: {_WHOLE}")
            k = table = len(rows) if "1" in found.groups() else table
        if row := text[found.end() if found else 0 :]:
            rows[k : k + 1] = [
                (rows[k][0], f"{rows[k][1]} {row}") if k < len(rows) else (where, row)
            ]
            k += 1
    return rows
