"""Tables as programs print them: bars round the rows, brackets, or long rows in pieces."""

import re
from collections.abc import Sequence

from imgloc.errors import ScanError

Line = tuple[str, str]  #: where a line stands, and its text

_BOX = str.maketrans("│┃║┆╎", "|||||")
_RULE = re.compile(
    r"[-+|:=\s\u2500-\u257f]*(--|\u2500|\u2501|\u2550)[-+|:=\s\u2500-\u257f]*"
    r"|[(\[]\d+ rows?\b.*|\d+ rows? in set.*|\w+ *="
    r"|[|\s]*(<?(dbl|int|double|float|varchar|str|[fiu](32|64))>?([|\s]+|$))+"
)
# MATLAB and Octave have a line before rows that go on, R has numbers in front, or above.
_BLOCK = re.compile(
    r"Columns? (\d+)(?: (?:through|to|and) \d+)?:? *$|\[(\d+)\](?=[-+.\seE\dInfaNA]+$)"
    r"|\[,(\d+)\](?: +\[,\d+\])* *$"
)
_ARRAY = re.compile(r"(?i)(?:Out *\[\d+\]:|\w+ *=) *(\[|(np\.)?array|tensor|$)")
_FACTOR = re.compile(r"\d\.0*e[-+]\d+ *\*", re.IGNORECASE)
_LEFT_OUT = re.compile(r"(?<![^\s,\[|])(\.{2,3}|[…⋮])(?![^\s,\]|])")
_BRACKETS = re.compile(
    r"(?i)(?:Out *\[\d+\]: *|\w+ *= *)?(?:(?:np\.)?array\(|tensor\()?('\w', *)?"
    r"(?P<rows>\[[-+.\s\[\]\deinfa,]*\])"
    r"(, *(dtype|device|requires_grad|grad_fn|shape)=[^()]*(\([^()]*\))?)*\)?"
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
    >>> unprinted([("", "Out[1]: array([1., 2.],"), ("", "dtype=float32)")])[0][1].split()
    ['1.,', '2.']
    >>> for rows in (("ranges = [1. 2.]", "angles = [0. 1.]"), ("[1] 1 2", "[4] 4 5")):
    ...     try:
    ...         unprinted([("a.txt", row) for row in rows])
    ...     except ScanError as error:
    ...         print(str(error).partition(": write")[0])
    a.txt: a second array, expected the ranges alone
    a.txt: what was printed before it is missing
    >>> unprinted([("", "[]")]), unprinted([("", "Column 1,angle,range")])
    ([], [('', 'Column 1,angle,range')])
    """
    lines = [(where, text.translate(_BOX)) for where, text in lines]
    for where, text in lines:
        if (".." in text or not text.isascii()) and _LEFT_OUT.search(text):
            raise ScanError(f"{where}: it was printed shortened, with dots for numbers: {_WHOLE}")
        if _FACTOR.fullmatch(text):
            raise ScanError(f"{where}: it was printed with four digits and a factor: {_WHOLE}")
        if text.endswith("\\") and re.search(r"\S +\\$", text):
            raise ScanError(f"{where}: it was printed in pieces, one below the other: {_WHOLE}")
    arrays = [where for where, text in lines if _ARRAY.match(text)]
    if len(arrays) > 1:
        raise ScanError(f"{arrays[1]}: a second array, expected the ranges alone: {_WHOLE}")
    lines = [line for line in lines if not _RULE.fullmatch(line[1])]
    if lines and all(text[:1] == text[-1:] == "|" for _, text in lines):
        return [(where, text[1:-1]) for where, text in lines]
    begins = lines and re.match(r"[\w.\s=:('\[\]]*\[", lines[0][1])
    if begins and (found := _BRACKETS.fullmatch(" ".join(text for _, text in lines))):
        inside = re.findall(r"\[([^\[\]]*)\]", found["rows"])
        return [(lines[0][0], row) for row in inside if row.strip()]
    rows, table, k = list[Line](), 0, 0
    for where, text in lines:
        if found := _BLOCK.match(text):
            first = int(found[1] or found[2] or found[3])
            k = table = table if first > 1 else len(rows)
            there = [re.findall(r"[^\s,]+", text) for _, text in rows[k : k + 1]]
            if first > 1 and first - 1 not in map(len, there):
                raise ScanError(f"{where}: what was printed before it is missing: {_WHOLE}")
        row = text[found.end() :] if found else re.sub(r"^\[\d+,\] +", "", text)
        if row:
            rows[k : k + 1] = [
                (rows[k][0], f"{rows[k][1]} {row}") if k < len(rows) else (where, row)
            ]
            k += 1
    return rows
