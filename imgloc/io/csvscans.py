"""Scans as tables of text, whose columns are understood by their names and by what they hold.

>>> role_of("field.ranges12"), role_of("/scan/angle_min"), role_of("Distance [mm]")
(('ranges', 12, 1.0), ('angle_min', 0, 1.0), ('range', 0, 0.001))
>>> [round(200 * role_of(name)[2] / math.pi, 6) for name in ("phi [gon]", "phi_deg", "phi")]
[1.0, 1.111111, 63.661977]
"""

import contextlib
import csv
import itertools
import logging
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.badlines import BadLines
from imgloc.io.bags import Beside
from imgloc.io.files import PathLike, display
from imgloc.io.printed import Line, unprinted
from imgloc.io.scanset import SEVERAL, SPACING, Entry, ScanSet, collect, spread
from imgloc.io.textscans import LASERS, NAMES, lines_of, number_of, setting_of
from imgloc.model import FloatArray
from imgloc.options import MAX_BAD
from imgloc.robot.recording import Recording

_LOG = logging.getLogger("imgloc")
_SETTING = re.compile(r"\b(\w+)\s*[=:]\s*([^\s,;]+)")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d+)?|[.,]\d+)(e[-+]?\d+)?|[-+]?inf|nan", re.IGNORECASE)
_SETTINGS = (*SPACING, "range_min", "range_max", "time_increment")
_PLACES = {"pose": ("x", "y", "theta"), "odom": ("odom_x", "odom_y", "odom_theta")}
_BESIDE = ("stamp", *_PLACES["pose"], *_PLACES["odom"])
_PLACE = re.compile(r"(?:(odom)(?:etry)?[._/ ]|pose[._/ ])?(?:([xy])|theta|th|yaw|heading)")
_DEGREE = math.pi / 180
# By how a word for it begins, the longest beginning first; all others are SI.
_UNITS = {
    "mm": 1e-3, "milli": 1e-3, "cm": 1e-2, "centi": 1e-2, "ft": 0.3048, "f": 0.3048, "in": 0.0254,
    "cdeg": _DEGREE / 100, "deg": _DEGREE, "°": _DEGREE, "gradian": math.pi / 200, "grado": _DEGREE,
    "gradi": _DEGREE, "grad": math.nan, "gon": math.pi / 200,
    "mrad": 1e-3, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
}  # fmt: skip
_LENGTH = r"mm|cm|m|ft|feet|foot|in|inch(?:es)?|(?:milli|centi)?m[eèé]t(?:re|er|ro)s?"
_TURNED = r"°|grad(?:ians?|[oi]s?)?|gon|c?deg(?:r[eé]*s?)?|m?rad(?:ians?)?"
_UNIT = re.compile(rf"(?:[\s_.(\[/]|\bin\b|_in_)+({_LENGTH}|{_TURNED}|ms|us|ns|s|sec)[)\]]?$")
_SAID = re.compile(
    rf"(?:(?:\b|_)(?:units?|in|are)\b[\s:='\"]*|[(\[])(?:({_LENGTH})|({_TURNED}))(?![\w.])"
)
# Finer units of angles, and how many are a degree; views of sensors are multiples of some degrees.
_TIMES = {"gradians": 10 / 9, "tenths of a degree": 10, "hundredths of a degree": 100,
          "milliradians": 1000 * _DEGREE}  # fmt: skip
_TURN, _VIEW, _OFF = 360, 30, 2  # degrees
_TURNS = math.tau, _TURN, _TURN * _TIMES["gradians"]
_ENDS = re.compile(r"\b(start|end)_angle$")
_RANGES = re.compile(r"(.*[./])?ranges?[._\[( ]*(\d+)[)\]]?$")
_ROLES = (
    (re.compile(rf"(.*[./])?({'|'.join(_SETTINGS)})$"), ""),
    (re.compile(r"(.*[./])?(time)?stamp[./]n(ano)?secs?$"), "nanoseconds"),
    (re.compile(r"(.*[./])?(time)?stamp[./]secs?$"), "seconds"),
    (re.compile(r"(.*[./])?stamp$"), "stamp"),
    (re.compile(r"(%|__)?(time|timestamp|t|zeit|zeitstempel|temps|tiempo|tempo)$"), "time"),
    (re.compile(rf"(.*[./])?(header[./_])?frame_id|({'|'.join(LASERS)})([ ._]?(id|name))?"),
     "laser"),
    (re.compile(r"(.*[./])?(header[./_])?(seq|scan_time)$|.*intensit.*|quality|"
                r"(scan_|ray_|beam_)?(id|index|idx|nr|number)$|source"), "aside"),
    (re.compile(r"angu?le|winkel|[aá]ngulo|angolo|角度|bearing|azimuth|phi|alpha"), "angle"),
    (re.compile(r"range|dist(an[cz]i?[ae]?)?|abstand|entfernung|port[eé]e|距离|rho|r"), "range"),
    (re.compile(r"scan|sweep"), "scan"),
)  # fmt: skip
_SCANS = ("", "range", "ranges", "scan")  # roles of columns beside one of angles
_COMMA, _SPELLED = re.compile(r"^([-+]?\d*),(\d+)"), re.compile(r"[-+]?[\d,.]")
_BELOW = re.compile(r"[1-9]\d\d([.,]\d+)?")  # a thousand
_ONWARD = 0.7  # share of the steps of angles that rise; of ranges it is about a half
_LONG = 200  # characters that no name of a column has
_SAMPLE = 10_000  # cells that show how numbers are spelled
_PAIR = re.compile(r"(?<!\w)([^\W\d]\w*(?:\s*\(\w+\))?)\s*[:=]\s*([-+\w.]+)")
# How a cell with a list begins.
_LIST = re.compile(r"^(array\('?\w?'?,?\s*)?[\[(]+(?=[\s\d.+\-nNiI\])])")
_EVEN, _MANY = 8, 40  # numbers that rise evenly by chance in no scan, and roughly so in none
# Rank correlation of two scans, of which most in 7 recorded logs have more, and how many times as
# far one sees as another: at most 5.3 times there.
_TOGETHER, _GREATER = 0.5, 10
_BETWEEN = 0.2  # of a step, from rays of a scan to those of another; a quarter if four alternate
_LIKE = 0.1  # median step from a range to the next one, as a share of the range
# How many times as much ranges differ from the next number as from the one after it if others stand
# between (at most 3 times in 11 recorded logs, at least 5.8 times with intensities there); of whole
# numbers beside others the least share that is no chance (0.12 of a log in decimetres).
_APART, _WHOLE, _FAR = 4, 0.3, 100.0  # the last in metres, in which other numbers have fractions
_EPOCH = 1e8  # seconds since 1970, or a finer unit, but never metres
_EPOCHS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))  # how great a time is, and its unit
_ECHO = 10  # columns of a LaserScan before its ranges, as ros2 topic echo --csv prints them
_POSE = re.compile(r"(.*?)[./]?pose[./]pose[./](position[./][xy]|orientation[./](?:[zw]|yaw))")
_AXES = "position/x", "position/y", "orientation/z", "orientation/w", "orientation/yaw"
_CLOCKWISE = "a quality beside angles is an RPLIDAR's, which counts them clockwise: `flipped=True`"
_POINTS = " are points; expected columns angle and range: atan2(y, x) in radians, hypot(x, y)"
# A quoted cell, a name and no damage, before others that are not.
_QUOTED = re.compile(r'"[^"]{1,80}"[^"]+$')
Row = tuple[str, list[str]]  #: where a line stands, and its cells
Role = tuple[str, int, float]  #: of a column, see :func:`role_of`


def read_csv(path: PathLike, *, fov: float | None = None, max_bad: float = MAX_BAD) -> ScanSet:
    """Read scans from a table: one scan a line, its ranges in the order of the angles.

    Commas stand between the cells, or semicolons, tabs, bars or blanks. Lines that begin with ``#``
    give what the numbers do not, in metres and radians::

        # angle_min=-1.5708, angle_max=1.5708, range_min=0.05, range_max=30
        2.31,2.30,nan,inf,1.02

    ``angle_min`` is needed with ``angle_max`` or ``angle_increment``, or else `fov`: radians from
    the first ray to the last, straight ahead between; or the first line holds the angles. A first
    line of names is optional; columns called ``stamp``, ``x``, ``y``, ``theta`` are the stamp and
    the known pose of the sensor, ``odom_x``, ``odom_y``, ``odom_theta`` the odometry, the robot's
    pose in its own frame; all others are ranges in order, whose names are alike. The columns of
    ``rostopic echo -p``, ``ros2 topic echo --csv``, bagpy and PlotJuggler are known, also those of
    a nav_msgs/Odometry, and the lines that ``ultra_simple`` of RPLIDAR's SDK prints. A file with
    columns such as ``angle`` and ``range``, ``angle_deg`` and ``distance_mm``, or with just two
    columns of numbers, or three with a quality, in any order, has one reading a line. A unit is in
    the name of a column or in a comment, such as ``# unit: mm``; angles without one are of that in
    which a turn fits. Empty cells are NaN. Broken lines are left out, up to the share `max_bad`, as
    is a last one that was cut off.
    """
    name, settings, comment, units = display(path), dict[str, Any](), "", ["", ""]
    lines, below = lines_of(path, other="cp1252"), list[Line]()
    for line, text in lines.numbered:
        where = f"{name}: line {line}"
        if text.startswith(("#", "//", "% ", "sep=")):
            plain = re.sub(r"(\d),(\d)", r"\1.\2", text)
            said = [(key, value) for key, value in _SETTING.findall(plain) if key in _SETTINGS]
            settings |= {key: setting_of(key, value, f"{where}: {key}") for key, value in said}
            plain = text.strip("#/% ").lower()
            named = any(role_of(cell)[0] for cell in cells_of(plain))
            words = [] if named else _SAID.findall(plain)
            units = [max([old, *every]) for old, *every in zip(units, *words, strict=True)]
            comment = comment if below or said or words else plain
        else:
            below.append((where, text))
    if not (body := [(where, cells_of(text)) for where, text in unprinted(below)]):
        raise ScanError(f"{name}: contains no scan, expected one per line")
    body = _unpacked(_spoken(_pointed(body, name)))
    table = _Table(name, body, settings, BadLines(name, max_bad), f"{name}: line {lines.cut}")
    table.length, table.turn = map(_factor, units)
    if _is_echo(body[0][1]):
        return table.echoed()
    first, names = body[0][1], cells_of(comment)
    if not any(cell and is_number(cell) for cell in first) or first[0].startswith("%"):
        names = [cell.strip("\"'").lower() for cell in body.pop(0)[1]]
        if {len(row) - len(names) for _, row in body} == {1}:  # as R and pandas write them
            names.insert(0, "index")
    elif all(_QUOTED.match(text) for _, text in below):  # names of rows, as R writes them
        body[:] = [(where, row[1:]) for where, row in body]
        names = []
    elif (head := _head(name, body, settings, fov)) is not None:
        names = head
    elif len(names) != len(first) or any(map(is_number, names)):
        names = []
    return table.read(names, fov)


def cells_of(text: str) -> list[str]:
    """The cells of a line, whatever stands between them.

    Examples
    --------
    >>> cells_of("1.5, ,x"), cells_of("1,5;2,5"), cells_of("1.5  2"), cells_of("1,5 2 inf")
    (['1.5', '', 'x'], ['1,5', '2,5'], ['1.5', '2'], ['1,5', '2', 'inf'])
    """
    mark = next((m for m in (";", "\t", "|") if m in text and f",{m}" not in text), None)
    if mark or (" " in text and all(map(_NUMBER.fullmatch, text.split()))):
        return [cell.strip() for cell in text.split(mark)]
    if '"' in text:
        with contextlib.suppress(csv.Error):  # of a cell that is longer than any
            mark = "," if "," in re.sub('"[^"]*"', "", text) or " " not in text else " "
            read = csv.reader([text], delimiter=mark, skipinitialspace=True)
            return [cell.strip() for cell in next(read)]
    return [cell.strip() for cell in text.split(",")] if "," in text else text.split()


def _pointed(body: list[Row], name: str) -> list[Row]:
    """The rows with decimal points, and without the marks between thousands.

    A mark is of thousands if a column has it before each three last digits, and whole numbers
    below 1000 besides; else a comma is a decimal one.

    Examples
    --------
    >>> [row for _, row in _pointed([("", ["1,5", "2,001"]), ("", ["2,25", "0,5"])], "a.csv")]
    [['1.5', '2.001'], ['2.25', '0.5']]
    >>> [row for _, row in _pointed([("", ["1,234", "950", "2,001", "870"])], "a.csv")]
    [['1234', '950', '2001', '870']]
    """
    step = 1 + len(body) * len(body[0][1]) // _SAMPLE
    some = [row for _, row in body[::step] if any(map(_SPELLED.match, row))]
    columns = [*itertools.zip_longest(*some, fillvalue="")] if len(some) > 1 else some
    heads = [role_of(cell)[2] for cell in body[0][1]] if len(some) > 1 else []
    for mark in ",.' \xa0\u202f":
        form = re.compile(rf"[-+]?[1-9]\d?\d?(\{mark}\d{{3}})+([.,]\d+)?")
        there = [[c for c in col if mark in c and _SPELLED.match(c)] for col in columns]
        below = [[c for c in col if mark not in c and _BELOW.fullmatch(c)] for col in columns]
        # No laser sees thousandths of a millimetre, nor anything as near as 10 cm alone.
        short = [all(len(cell.partition(mark)[0]) < 3 for cell in cells) for cells in there]
        known = [unit == _UNITS["mm"] for unit in heads] or [False] * len(columns)
        sure = any(cells and (mark not in ",." or (mm and near))
                   for cells, mm, near in zip(there, known, short, strict=False))  # fmt: skip
        both = [c for a, b in zip(there, below, strict=True) if a and (b or sure) for c in a + b]
        marked = [cell for cell in both if mark in cell]
        if (sure or len({*both} - {*marked}) > 1) and all(map(form.fullmatch, marked)):
            _LOG.warning("%s: %s is read as %s, in thousands", name, marked[0],
                         marked[0].replace(mark, ""), extra={"code": "thousands"})  # fmt: skip
            body = [(w, [c.replace(mark, "") if form.fullmatch(c) else c for c in row])
                    for w, row in body]  # fmt: skip
    first, rest = body[0][1], [row for _, row in body[1:] or body]
    ends = not first[-1] or len(first) < len(rest[-1])  # there may be a mark at the end of lines
    if ends and all(row[-1:] == [""] and "" not in row[:-1] for row in rest):
        body = [(w, row[:-1] if not row[-1] else row) for w, row in body]
    return [(w, [_COMMA.sub(r"\1.\2", c) if "," in c else c for c in row]) for w, row in body]


def _spoken(body: list[Row]) -> list[Row]:
    """The rows, or those of lines that name each number, such as ``angle: 1.20, distance: 2.3``.

    RPLIDAR's SDK prints ``theta: 1.20 Dist: 02349.00 Q: 47``: degrees clockwise, millimetres, and
    0 where the ray met nothing. Lines before the first reading are about the device.
    """
    roles = [{role_of(key)[0] for key, _ in _pairs(cells)} for _, cells in body[:_MANY]]
    there = (k for k, found in enumerate(roles) if "range" in found and found & {"angle", "theta"})
    if (begin := next(there, -1)) < 0:  # notes about the recording may come before the names
        sets = ({role_of(cell.strip("\"'"))[0] for cell in cells} for _, cells in body[:_MANY])
        head = next((k for k, found in enumerate(sets) if {"angle", "range"} <= found), 0)
        return body[head * all(not all(map(is_number, row)) for _, row in body[:head]) :]
    said = [dict(_pairs(cells)) for _, cells in body[begin:]]
    names = [*said[0]]
    rows = [[*one.values()] if [*one] == names else [] for one in said]
    if names == ["theta", "Dist", "Q"]:
        names = ["angle_deg", "distance_mm"]
        rows = [["-" + r[0], r[1] if r[1].strip("0.") else "inf"] if r else [] for r in rows]
    places = [where for where, _ in body[begin:]]
    return [(places[0], names), *zip(places, rows, strict=True)]


def _pairs(cells: Sequence[str]) -> list[tuple[str, str]]:
    return _PAIR.findall(" ".join(cells))


def _unpacked(body: list[Row]) -> list[Row]:
    """The rows with a column for each number of lists of ranges in cells, as pandas writes them.

    Columns of other lists are left out.
    """
    few = [row[: len(body[0][1])] for _, row in body[1:3]]
    lists = {i for row in few for i, cell in enumerate(row) if _LIST.match(cell)}
    (where, names), rows = body[0], list[Row]()
    at = next((i for i in lists if role_of(f"{names[i]}0")[0] == "ranges"), -1)
    if at < 0:
        return body
    kept = [i for i in range(len(names)) if i not in lists]
    for line, row in body[1:]:
        whole = len(row) == len(names) and row[at].endswith((")", "]"))
        cells = _LIST.sub("", row[at]).strip(")] ").replace(",", " ").split() if whole else []
        rows.append((line, [*(row[i] for i in kept), *cells] if whole else []))
    widest = max(len(row) for _, row in rows) - len(kept)
    head = [*(names[i] for i in kept), *_ranges(widest)]
    return [(where, head), *((w, row and row + [""] * (len(head) - len(row))) for w, row in rows)]


def role_of(name: str) -> Role:
    """Role of a column by its lower-case name, its number among its like, and its unit in SI.

    It is ``ranges`` for a column of a scan a line, empty if the name is no hint.
    """
    if len(name) > _LONG:
        return "", 0, 1.0
    name = _ENDS.sub(lambda found: NAMES[found[0]], name.lower())
    if found := _RANGES.fullmatch(name):
        return "ranges", int(found[2]), 1.0
    if _POSE.fullmatch(name):
        return "pose", 0, 1.0
    unit = _UNIT.search(name)
    bare, said = (name[: unit.start()], unit[1]) if unit else (name, "")
    for pattern, role in _ROLES:
        if found := pattern.fullmatch(name) or (pattern.fullmatch(bare) if unit else None):
            factor = _factor(said) if role in ("angle", "range", "time") else 1.0
            if role in ("time", "stamp") and name.startswith(("%", "field.")):  # rostopic echo -p
                factor = _UNITS["ns"]
            return role or str(found[2]), 0, factor
    if found := _PLACE.fullmatch(name) or _PLACE.fullmatch(bare):
        said = said.replace("grad", "deg")
        return f"{found[1] + '_' if found[1] else ''}{found[2] or 'theta'}", 0, _factor(said)
    return "", 0, 1.0


def _factor(word: str) -> float:
    return next((factor for begins, factor in _UNITS.items() if word.startswith(begins)), 1.0)


@dataclass
class _Table:
    """The lines of a table, and what is known besides."""

    name: str
    body: list[Row]
    settings: dict[str, Any]
    bad: BadLines
    cut: str  #: where the line stands that does not end
    rows: list[tuple[str, FloatArray]] = field(default_factory=list)
    cells: list[list[str]] = field(default_factory=list)  #: of each row, as they are spelled
    length: float = 1.0  #: metres, that a comment gives as the unit of ranges
    turn: float = 1.0  #: radians, likewise of angles
    block: str = ""  #: what is said of numbers at the end of each line that may be no ranges

    def read(self, names: list[str], fov: float | None) -> ScanSet:
        """The scans, of columns that are called so, if they are."""
        roles = [self._role(i, name) for i, name in enumerate(names)]
        by = {role: i for i, (role, _, _) in reversed(list(enumerate(roles))) if role != "ranges"}
        ranges = [i for _, i in sorted((r[1], i) for i, r in enumerate(roles) if r[0] == "ranges")]
        self._refuse_lasers([names[i][: names[i].rindex("range")] for i in ranges])
        if "range" in by and "angle" not in by and "theta" in by and "x" not in by:
            by["angle"] = by.pop("theta")
        if "laser" in by and "angle" in by and "range" not in by:
            by["range"] = by.pop("laser")
        if not ranges and {"angle", "range"} <= by.keys():
            if "quality" in names:
                _LOG.warning("%s: %s", self.name, _CLOCKWISE, extra={"code": "degrees"})
            return self._readings(by, roles)
        few = len(names) in (2, 3) and len(self.body) > _EVEN and not any(r for r, _, _ in roles)
        if (not names or few) and (scans := self._by_contents(names, fov)) is not None:
            return scans
        known = {"angles", "angle_min"} & (self.settings.keys() | by.keys())
        if "angle" in by and not (ranges and (known or fov is not None)):
            self._parse(None, names)
            return self._columns(by["angle"], roles[by["angle"]][2], names)
        if not ranges:
            ranges = [i for i, (role, *_) in enumerate(roles) if names[i] and not role]
            if {"x", "y"} <= by.keys() and all(names[i][:1] == "z" for i in ranges):
                raise ScanError(f"{self.name}: columns {', '.join(names)}{_POINTS}")
            if names and not ranges:
                found = f"columns {', '.join(names[:5])}"
                raise ScanError(f"{self.name}: {found}, expected columns called angle and range")
            ranges = _alike(ranges, names, self.name)
        beside = [i for i, (role, *_) in enumerate(roles) if role == "aside"][:_EVEN]  # few
        used = [i for i, (role, _, _) in enumerate(roles) if role not in ("", "aside", "laser")]
        if not self.rows:
            self._parse([*used, *ranges], names)
        ranges = ranges or list(range(len(self.rows[0][1])))
        if not {"time", "stamp", "seconds"} & by.keys() and (times := self._times(ranges)):
            by["time"], ranges = times[0], [i for i in ranges if i not in times] or ranges
            roles = [("time", 0, 1.0)] * len(self.rows[0][1])
        self._refuse_counts(ranges, names)
        places = self._places(names, by)
        if not known:
            if fov is None:
                expected = "a first line '# angle_min=..., angle_max=...' in radians, or `fov`"
                expected += self.block and f"; {self.block}"
                raise ScanError(f"{self.rows[0][0]}: angles: missing, expected {expected}")
            self.settings["angles"] = spread(len(ranges), fov)
        entries = list[Entry]()
        unit = self._metres(names[ranges[0]] if names and ranges else "")
        for k, (where, row) in enumerate(self.rows):
            values = row[ranges] * unit
            if "angle_min" in by and np.isnan(row[by["angle_min"]]) and np.isnan(values).all():
                continue  # of another topic
            more = {key: [row[i] * roles[i][2] for i in at] or None for key, at in places.items()}
            said: dict[str, Any] = {key: float(row[by[key]]) for key in _SETTINGS if key in by}
            said = {key: value for key, value in said.items() if not math.isnan(value)}
            if (rays := _rays_of(said)) and np.isnan(values[rays:]).all():
                values = values[:rays]  # a shorter scan than others
            laser = self.cells[k][by["laser"]] if "laser" in by else ""
            said |= {f"column {i}": self.cells[k][i] for i in beside}
            said |= {"ranges": values, "stamp": _stamp_of(row, by, roles), "laser": laser, **more}
            entries.append((where, {**self.settings, **said}))
        return self._beside(names, by, roles).scans(entries, "", Recording(), "", self.bad)

    def _places(self, names: Sequence[str], by: Mapping[str, int]) -> dict[str, list[int]]:
        """The columns of a known pose and of the odometry, those of a whole pose or none."""
        places = {key: [by[c] for c in wanted if c in by] for key, wanted in _PLACES.items()}
        for key, wanted in _PLACES.items():
            if 0 < len(places[key]) < len(wanted):
                there, every = ", ".join(names[i] for i in places[key]), ", ".join(wanted)
                raise ScanError(f"{self.name}: columns {there}, expected all of {every} or none")
        return places

    def _role(self, at: int, name: str) -> Role:
        """The role of a column; one of lasers numbers no scans, nor names files one by one."""
        if (role := role_of(name))[0] != "laser":
            return role
        cells = [cells[at].strip() for _, cells in self.body if at < len(cells)]
        sure = re.match("laser|lidar|sensor|scanner", name) or not all(map(is_number, cells))
        return role if sure and len({*cells}) <= SEVERAL else ("aside", 0, 1.0)

    def _refuse_lasers(self, names: Sequence[str]) -> None:
        """ScanError for ranges of several lasers, by what stands before the name of each."""
        if len(of := dict.fromkeys(names)) > 1:
            found = f"ranges of several lasers: {', '.join(of)}"
            raise ScanError(f"{self.name}: {found}; expected those of one, or a line each")

    def _by_contents(self, names: Sequence[str], fov: float | None) -> ScanSet | None:
        """The scans of columns without names, or with those of a language that is not known."""
        self._parse(None, names)
        count = len(self.rows[0][1])
        if not self.settings and (by := self._one_a_line()):
            units = [_UNIT.search(name) for name in names] or [None] * count
            return self._readings(by, [("", 0, _factor(u[1]) if u else 1.0) for u in units])
        if not names and self._turns(fov):
            return self._columns(0, 1.0)
        if not self.settings and 1 < count < 4 and len(self.rows) > _MANY:
            expected = "expected a first line of names: angle,range,quality"
            raise ScanError(f"{self.name}: lines of {count} numbers, {expected}")
        return None

    def _beside(self, names: Sequence[str], by: Mapping[str, int], roles: Sequence[Role]) -> Beside:
        """The odometries whose columns are there, by their topics."""
        beside, topics = Beside(), dict[str, dict[str, int]]()
        for i, name in enumerate(names):
            if found := _POSE.fullmatch(name):
                topics.setdefault(found[1], {})[found[2].replace(".", "/")] = i
        for topic, at in topics.items():
            own = f"{topic}/header/stamp"
            when = {"time": names.index(own)} if own in names else by
            for _, row in self.rows:
                x, y, z, w, yaw = (row[at[key]] if key in at else math.nan for key in _AXES)
                if not math.isnan(x) and (stamp := _stamp_of(row, when, roles)) is not None:
                    yaw = 2 * math.atan2(z, w) if math.isnan(yaw) else yaw
                    beside.moves[topic, "", ""].append((stamp, x, y, yaw))
        return beside

    def _parse(self, used: Sequence[int] | None, names: Sequence[str]) -> None:
        """Make numbers of the cells that are used, by default all."""
        width = len(names)
        for where, cells in self.body:
            try:
                width = width or len(cells)
                if len(cells) != width:
                    why = ": one per name" if names else " as before"
                    raise ScanError(f"{where}: {len(cells)} numbers, expected {width}{why}")
                row = np.full(width, np.nan)
                for i in range(width) if used is None else used:
                    row[i] = number_of(cells[i], f"{where}: column {i + 1}")
            except ScanError as error:
                self.bad.skip(error, where if self.rows and where == self.cut else "")
                continue
            self.rows.append((where, row))
            self.cells.append(cells)
        if not self.rows:
            self.bad.check(0)
            raise ScanError(f"{self.name}: contains no scan, expected one per line")

    def _metres(self, name: str) -> float:
        """Metres that 1 stands for in one of several columns of ranges, such as ``r0 [mm]``."""
        unit = re.search(rf"[\W_]({_LENGTH})[\W_\d]*$", name)
        return _factor(unit[1]) if unit else self.length

    def _one_a_line(self) -> dict[str, int]:
        """Which columns, of two, or of three with a quality, hold angles and ranges, if any do.

        Angles rise or fall evenly, and hardly any value of a range comes again.
        """
        table = np.array([row for _, row in self.rows])
        if len(table) < 2 or table.shape[1] not in (2, 3):
            return {}
        with np.errstate(invalid="ignore"):  # from infinite to infinite
            around = [np.unwrap(np.arctan2(table[:, k + 1], table[:, k])) for k in (0, -2)]
            steps = np.diff(np.column_stack((table, *around)), axis=0)
            usual = np.median(steps, axis=0)
            *even, one, other = (2 * np.abs(steps - usual) < np.abs(usual)).mean(axis=0).tolist()
            onward = (steps * np.sign(usual) > 0).mean(axis=0)
        if max(0.5, *even[:2]) < one or max(0.5, *even[-2:]) < other:
            raise ScanError(f"{self.name}: its columns{_POINTS}")
        values = [len(np.unique(column)) for column in table.T]
        if len(even) > 2 and 2 * max(even[1:]) > 1 and (np.diff(table[:, 0]) == 1).all():
            even[0] = values[0] = 0  # it counts the readings
        few = len(table) <= _EVEN
        if few and table.shape[1] == 2 and (len(table) < 3 or even[0] < 1):
            found = f"{len(table)} lines of two numbers"
            raise ScanError(f"{self.name}: {found}, expected a first line of names: angle,range")
        at = 0 if few else int(np.argmax(even))
        rest = sorted(set(range(table.shape[1])) - {at}, key=lambda i: -values[i])
        apart = 8 if [at, *rest] == [0, 2, 1] else 2  # nobody has a quality before the range
        if rest[1:] and (2 * even[at] < 1 or apart * values[rest[1]] > values[rest[0]]):
            return {}
        if not few and onward[at] < _ONWARD:
            expected = "angles in their order, or names of the columns"
            raise ScanError(f"{self.name}: no column rises or falls; expected {expected}")
        if at:
            text = f"column {at + 1} rises or falls evenly: it is taken for the angle"
            text += f"; {_CLOCKWISE}" * ([at, *rest] == [1, 2, 0] and values[0] > 0)
            _LOG.warning("%s: %s", self.name, text, extra={"code": "degrees"})
        return {"angle": at, "range": rest[0]}

    def _turns(self, fov: float | None) -> bool:
        """Return whether the first column holds angles, and each other one a scan."""
        table = np.array([row for _, row in self.rows])
        if fov is not None or self.settings.keys() & {"angles", "angle_min"} or table.shape[1] < 3:
            return False
        angles = _even_angles(table[:, 0], {})
        if angles is None:
            return False
        around = abs(angles[-1] - angles[0]) + abs(angles[1] - angles[0])
        if angles.min() >= -_LIKE and not any(abs(around / turn - 1) < 0.003 for turn in _TURNS):
            return False
        self._refuse_others(table[:, 1:])
        return True

    def _refuse_others(self, table: FloatArray) -> None:
        """ScanError for columns beside angles that are not all scans of one laser.

        Those of some alone are whole, or negative; of two or three that do not rise and fall
        together some are far greater, or a number is not like the next one, as a range is.
        """
        seen = [c for c in (c[np.isfinite(c) & (c != 0)] for c in table.T) if len(c) > _EVEN]
        kinds = {(bool((c == np.round(c)).all()), bool(np.median(c) < 0)) for c in seen}
        middles = [float(np.median(c)) for c in seen] or [1.0]
        odd = len(kinds) > 1
        if table.shape[1] < 4 and (np.corrcoef(table.argsort(0).argsort(0).T) < _TOGETHER).any():
            rough = any(np.median(np.abs(np.diff(c))) > _LIKE * np.median(c) for c in seen)
            odd |= rough or max(middles) > _GREATER * min(middles) or (True, False) in kinds
        if odd:
            expected = "a first line of names: angle,range,intensity, or angle,scan0,scan1 ..."
            raise ScanError(f"{self.name}: column 1 holds angles, others no scans: give {expected}")

    def _columns(self, at: int, unit: float, names: Sequence[str] = ()) -> ScanSet:
        """The scans of a table with a column of angles, and a column for each scan."""
        table = np.array([row for _, row in self.rows])
        others = (k for k in range(table.shape[1]) if k != at)
        scans = [k for k in others if not names or role_of(names[k])[0] in _SCANS]
        stems = {re.sub(r"[\W_]*\d+", "", names[k]) for k in scans if names}
        if len(stems) > 1 or stems & {*LASERS}:
            found = f"columns {', '.join(names[k] for k in scans[:5])} beside angles"
            expected = "one that is called range, or scan0, scan1 ... of one laser"
            raise ScanError(f"{self.name}: {found}, expected {expected}")
        table = table * ([*map(self._metres, names)] or self.length)
        angles = _radians(self.name, table[:, at], self.turn if unit == 1 else unit)
        said = {**self.settings, "angles": angles}
        entries: list[Entry] = [
            (f"{self.name}: column {k + 1}", {**said, "ranges": table[:, k]})
            for k in scans if not np.isnan(table[:, k]).all()
        ]  # fmt: skip
        return collect(entries, self.name, self.bad)

    def _times(self, ranges: Sequence[int]) -> list[int]:
        """Which of the columns of ranges hold the time since 1970, else the first one if it rises.

        A range is like the next one of the same line, and a time is not.
        """
        table = np.array([row[ranges] for _, row in self.rows])
        found = (np.isfinite(table) & (table > _EPOCH)).all(axis=0)
        if not found.any() and ranges[:1] == [0] and min(table.shape) > 1 and len(table) > 3:
            with np.errstate(invalid="ignore"):  # from infinite to infinite
                steps, across = np.diff(table[:, :2], axis=0), np.diff(table[:, :2])[:, 0]
            rises = [bool((s >= 0).all() and 2 * np.count_nonzero(s) > len(s)) for s in steps.T]
            like = np.median(np.abs(across)) < _LIKE * np.median(table[:, 1])
            found[0] = rises == [True, False] and not like
        for i in np.array(ranges)[found]:
            text = f"column {i + 1} is taken for the time, not for ranges"
            _LOG.warning("%s: %s", self.name, text, extra={"code": "time-column"})
        return [int(i) for i in np.array(ranges)[found]]

    def _refuse_counts(self, ranges: Sequence[int], names: Sequence[str]) -> None:
        """ScanError for one range a line, and for a first column that counts those that follow."""
        if len(ranges) == 1 and len(self.rows) > 1:
            found = f"{len(self.rows):,} lines of one range each, expected a scan a line"
            raise ScanError(f"{self.name}: {found}, or columns called angle and range")
        if not names and len(ranges) > _MANY:
            self._refuse_between(np.array([row[ranges] for _, row in self.rows[:_MANY]]))
        count, *others = {float(row[ranges[0]]) for _, row in self.rows}
        if names or others or count <= _MANY or not len(ranges) - _ECHO <= count < len(ranges):
            return
        found = f"{count:g} in each line of {len(ranges)} numbers, as if it counted readings"
        expected = "a first line with the names of all columns, or the ranges alone"
        raise ScanError(f"{self.name}: column {ranges[0] + 1} is {found}; expected {expected}")

    def _refuse_between(self, table: FloatArray) -> None:
        """ScanError for numbers that are no ranges between ranges, or after them.

        A range is like the next one, and intensities are more like each other; they are whole. If
        they are all one number, half of the sensor may be covered as well: that is a warning.
        """
        seen = np.where(np.isfinite(table) & (table > 0), table, np.nan)
        steps = (np.abs(seen[:, k:] - seen[:, :-k]) for k in (1, 2, 3))
        near, *far = map(_median, steps)
        whole, fine = (seen[(seen == np.round(seen)) == is_whole] for is_whole in (True, False))
        share = len(whole) / max(1, int(np.count_nonzero(seen > 0)))
        many = whole[whole >= _FAR] if fine[fine > 0].max(initial=0) < _FAR else whole[:0]
        block = _WHOLE < share < 1 - _WHOLE and len(np.unique(whole)) > _EVEN
        block |= share < 1 - _WHOLE and len(np.unique(many)) > 2
        if block or math.inf > near > max(_APART * min(far), _LIKE * _median(seen)):
            found = "other numbers, such as intensities, or marks of thousands are in the ranges"
            expected = "ranges as 1234.5, or a first line of names: range0,intensity0,range1 ..."
            raise ScanError(f"{self.name}: {found}; expected {expected}")
        last = table[0, -1]
        rays = int(np.flatnonzero((table != last).any(axis=0)).max(initial=-1)) + 1
        if np.isfinite(last) and 0 < rays < (1 - _WHOLE) * table.shape[1]:
            self.block = f"after {rays} columns each line is {last:g}: if these are no ranges, "
            self.block += "cut them off, or name the columns range0,range1 ... intensity0 ..."
            _LOG.warning("%s: %s", self.name, self.block, extra={"code": "intensities"})

    def _readings(self, by: Mapping[str, int], roles: Sequence[Role]) -> ScanSet:
        """The scans of a table with a reading a line."""
        which = next((key for key in ("scan", "stamp", "time") if key in by), None)
        if not self.rows:
            keys = [*filter(None, ("angle", "range", which, "seconds", "nanoseconds"))]
            used = [by[key] for key in keys if key in by]
            self._parse(used, [role for role, _, _ in roles])
        self.bad.check(len(self.rows))
        table = np.array([row for _, row in self.rows])
        turn, length = (roles[by[key]][2] for key in ("angle", "range"))
        angles = _radians(self.name, table[:, by["angle"]], self.turn if turn == 1 else turn)
        ranges = table[:, by["range"]] * (self.length if length == 1 else length)
        of = np.array([cells[by["laser"]] if "laser" in by else "" for cells in self.cells])
        beside = [i for i, (role, *_) in enumerate(roles) if role in ("", "aside")]
        entries = list[tuple[int, Entry]]()
        for laser in dict.fromkeys(of.tolist()):
            mine = np.flatnonzero(of == laser)
            starts = _starts(table[mine, by[which]] if which else None, angles[mine])
            for a, b in itertools.pairwise([*starts, len(mine)]):
                (where, row), at = self.rows[mine[a]], mine[a:b]
                found = {
                    **{f"column {i}": self.cells[mine[a]][i] for i in beside
                       if len({self.cells[k][i] for k in at}) == 1},
                    "angles": angles[at], "ranges": ranges[at], "laser": laser,
                    "stamp": _stamp_of(row, by, roles) if which != "scan" else None,
                }  # fmt: skip
                entries.append((int(mine[a]), (where, {**self.settings, **found})))
        ordered = [entry for _, entry in sorted(entries, key=lambda at: at[0])]
        if len(ordered) == 1:
            return collect([(self.name, ordered[0][1])], self.name)
        return collect(ordered, self.name, BadLines(self.name, self.bad.most))

    def echoed(self) -> ScanSet:
        """The scans of what ``ros2 topic echo --csv`` prints: the fields without their names."""
        keys = (*SPACING, "time_increment", "", "range_min", "range_max")
        entries = list[Entry]()
        for where, cells in self.body:
            try:
                texts = [(f"{where}: column {i}", c) for i, c in enumerate(cells, 1) if i != 3]
                row = [number_of(text, at) for at, text in texts]
                said = {key: row[2 + k] for k, key in enumerate(keys) if key}
                rays, count = row[_ECHO - 1 :], _rays_of(said)
                if count < 1:
                    raise ScanError(f"{where}: angle_increment: expected radians between two rays")
                if abs(count - len(rays)) > 1:  # intensities follow
                    count = len(rays) // 2 if abs(2 * count - len(rays)) <= 2 else len(rays)
                found = {"ranges": np.array(rays[:count]), "stamp": row[0] + 1e-9 * row[1],
                         "laser": cells[2]}  # fmt: skip
                entries.append((where, {**said, **found}))
            except (ScanError, IndexError) as error:
                self.bad.skip(ScanError(str(error)), where if entries and where == self.cut else "")
        return collect(entries, self.name, self.bad)


def _radians(name: str, angles: FloatArray, unit: float) -> FloatArray:
    """Angles in radians; if no `unit` is given, they are of the one in which a turn fits."""
    known = angles[np.isfinite(angles)]
    step = float(np.median(np.abs(np.diff(known)))) if len(known) > 1 else 0.0
    high, low = known.max(initial=-math.inf), known.min(initial=math.inf)
    span, most = float(high - low), float(max(high, -low))
    grad = math.isnan(unit)  # degrees in German, gradians in English
    if not grad and (unit != 1 or (most <= 2 * math.tau and span <= math.tau + 2 * step)):
        return angles * unit
    finer = {"degrees": 1.0, "gradians": 10 / 9} if grad else _TIMES
    seen = (span + step, *[span] * grad)
    views = [(unit, view / times) for unit, times in finer.items() for view in seen]
    fits = (unit for unit, view in views if view <= _TURN + _OFF
            and abs(view - _VIEW * round(view / _VIEW)) <= _OFF)  # fmt: skip
    likely = "degrees" if grad or span <= _TURN + _OFF + step else ""
    found = next(fits, likely) if grad or not likely else likely
    if not found:
        expected = "radians or degrees; or call their column angle_cdeg or angle_mrad"
        raise ScanError(f"{name}: angles: span {span:g}, expected {expected}")
    text = f"the angles span {span:g}, more than a turn in radians: they are taken for {found}"
    _LOG.warning("%s: %s", name, text, extra={"code": "degrees"})
    return np.deg2rad(angles / finer.get(found, 1.0))


def _is_echo(cells: Sequence[str]) -> bool:
    """Return whether a line is a LaserScan as CSV: seconds, nanoseconds, a frame, numbers."""
    numbers = [bool(cell) and is_number(cell) for cell in cells[: _ECHO + 1]]
    return len(cells) > _ECHO and numbers == [True] * 2 + [False] + [True] * (_ECHO - 2)


def _rays_of(said: Mapping[str, float]) -> int:
    """Number of the rays that a line names; 0 if it does not, or its angles cannot be."""
    try:
        return 1 + round((said["angle_max"] - said["angle_min"]) / said["angle_increment"])
    except (KeyError, ZeroDivisionError, OverflowError, ValueError):  # an infinity, or NaN
        return 0


def _stamp_of(row: FloatArray, by: Mapping[str, int], roles: Sequence[Role]) -> float | None:
    """The stamp of a line in seconds: that of the header, else the time in whichever unit."""
    stamp = math.nan
    if "seconds" in by:
        stamp = row[by["seconds"]] + 1e-9 * (row[by["nanoseconds"]] if "nanoseconds" in by else 0)
    for key in ("stamp", "time"):
        if key in by and not stamp > 0:
            value = row[by[key]] * roles[by[key]][2]
            stamp = value * next((unit for least, unit in _EPOCHS if value > least), 1.0)
    return None if math.isnan(stamp) else float(stamp)


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) > 2 * _EVEN else math.inf


def _head(
    name: str, body: list[Row], settings: dict[str, Any], fov: float | None
) -> list[str] | None:
    """The names of the columns below a first line of numbers: angles, which are set, or counts."""
    first, stated = body[0][1], fov is not None or "angle_min" in settings
    lead = next((k for k, cell in enumerate(first) if cell and is_number(cell)), 0)
    count = len(first) - lead
    numbers = ([str(k) for k in range(begin, begin + count)] for begin in (0, 1))
    numbered = count >= _EVEN and first[lead:] in numbers
    if numbered and (stated or count not in (_TURN, _TURN + 1)):
        if not stated:
            expected = "a line '# angle_min=..., angle_max=...' in radians before it, or `fov`"
            raise ScanError(f"{body[0][0]}: it numbers the columns; angles: expected {expected}")
        body.pop(0)
        return [*(cell.lower() or "index" for cell in first[:lead]), *_ranges(count)]
    if len(body) < 2 or lead > len(_BESIDE) or not all(c and is_number(c) for c in first[lead:]):
        return None
    row = np.array([float(cell) for cell in first[lead:]])
    angles = _even_angles(row, settings)
    angles = _even_angles(row[1:], settings) if angles is None and not lead else angles
    if angles is None:
        return None
    if numbered:
        text = f"line 1, up to {first[-1]}, is taken for angles; "
        text += "if it numbers the columns, pass `fov`"
        _LOG.warning("%s: %s", name, text, extra={"code": "degrees"})
    settings["angles"] = _radians(name, angles, 1.0)
    above = body.pop(0)[1][: len(first) - len(angles)]
    return [*("t" if is_number(cell) else cell.lower() for cell in above), *_ranges(len(angles))]


def _ranges(count: int) -> list[str]:
    return [f"ranges{k}" for k in range(count)]


def _even_angles(row: FloatArray, settings: Mapping[str, Any]) -> FloatArray | None:
    """Numbers if they are angles: they rise or fall evenly, and no ranges would; else None."""
    if len(row) < _EVEN or not np.isfinite(row).all():
        return None
    even, whole = np.linspace(row[0], row[-1], len(row)), abs(row[-1] - row[0])
    step = whole / (len(row) - 1)
    off = np.abs(row - even).max() / max(step, 1e-9)  # of rounded angles up to a half
    if off > (1 if len(row) > _MANY else 0.1) or ("angle_min" in settings and row.min() >= 0):
        return None
    most, turn = np.abs(row).max(), whole + step
    gradians = abs(turn / _TIMES["gradians"] - _TURN) <= _OFF and most <= turn
    return row if gradians or max(whole, most - step) <= _TURN + _OFF else None


def _starts(keys: FloatArray | None, angles: FloatArray) -> list[int]:
    """Where the scans begin of readings one after the other: the key changes, or angles go back."""
    if keys is not None and len(np.unique(keys)) < len(keys) / 2:
        ends = [0, *(1 + np.flatnonzero(np.diff(keys) != 0)).tolist(), len(keys)]
        return [a + k for a, b in itertools.pairwise(ends) for k in _again(angles[a:b])]
    steps = np.diff(angles)
    usual = float(np.median(steps)) if len(steps) else 0.0
    back = steps * np.sign(usual) < -max(math.pi / 4, 10 * abs(usual))
    starts, ends = [0], [*(1 + np.flatnonzero(back)).tolist(), len(angles)]
    for a, b in itertools.pairwise(ends):
        first, last = angles[starts[-1]], angles[b - 1]
        if (first - last) * np.sign(usual) <= 0:  # else it goes on beyond 0 degrees, not anew
            starts.append(a)
    return starts


def _again(angles: FloatArray) -> list[int]:
    """Where the scans begin of readings at one time, which run through the same angles again.

    >>> turn = np.arange(0, 3, 0.05)
    >>> _again(np.tile(turn, 2)), _again(np.concatenate([turn[k::4] for k in range(4)]))
    ([0, 60], [0])
    """
    starts, steps = _starts(None, angles), np.diff(angles)
    if len(starts) < 2 or min(np.diff([*starts, len(angles)])) < _EVEN:
        return [0]
    usual, gap = np.median(steps), np.quantile(np.diff(np.sort(angles)), 1 / 4)
    is_one = gap > _BETWEEN * abs(usual) or np.mean(steps * usual > 0) < _ONWARD
    return [0] if is_one else starts


def _alike(ranges: Sequence[int], names: Sequence[str], name: str) -> list[int]:
    """Those of the columns that are ranges: all, or those called so beside as many of another name.

    ScanError if half of them have one name and a number, such as d0, and others do not. Else a time
    or a heading would be a range, and all rays after it would have a wrong angle.
    """
    stems = {i: re.sub(r"[-+.\d]+", "", names[i]) for i in ranges}
    (usual, count), *rest = Counter(stems.values()).most_common() or [("", 0)]
    called = [i for i in ranges if role_of(stems[i].strip("[]()_ "))[0] == "range"]
    if len(called) == count > 1 and [n for _, n in rest] == [count]:
        return called
    others = [names[i] for i in ranges if stems[i] != usual]
    if count > 1 and count >= len(others) > 0:
        like = next(names[i] for i in ranges if stems[i] == usual)
        found = f"columns {', '.join(others[:5])}: besides ranges such as {like}"
        expected = f"{', '.join(_BESIDE)}, the ranges of one laser, or names such as"
        raise ScanError(f"{name}: {found}; expected {expected} range0,intensity0")
    return list(ranges)


def is_number(cell: str) -> bool:
    """Return whether a cell of a table may be a number: nothing is one that is not known."""
    with contextlib.suppress(ValueError):
        float(cell)
        return True
    return not cell
