"""Causes of trouble with scans, with a log of them or with a map: one table.

A cause has a sentence and what mends it, and stands where it is tried; who does so fills in values.

>>> found = cause("units", unit="centimetres", middle=250.0, beyond="", factor=0.01)
>>> found.code, found.said
('units', 'half of the ranges are above 250 m: are they centimetres? Try `range_scale=0.01`')
>>> cause("mirrored", Given(flipped=True), fits="this scan fits").short
'fits if mirrored: leave out `flipped=True`'
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any

from imgloc.answers.truth import NOT_TRUE
from imgloc.io.calibration import calibration_path
from imgloc.io.files import PathLike, display
from imgloc.io.maps import DRAWN, SLIP, SWAPPED
from imgloc.io.scanset import covers
from imgloc.model import LaserScan, OccupancyGrid
from imgloc.options import Drawn, Shared


@dataclass(frozen=True)
class Cause:
    """A likely cause, and what mends it."""

    code: str  #: one word that names it, the same in every version
    text: str  #: a sentence or two
    options: str = ""  #: arguments that mend it, in backquotes; empty if there are none
    short: str = ""  #: the text for a picture
    advice: str = ""  #: a sentence that advises them, if `text` does not
    found: bool = True  #: tried, and it helps; otherwise it is where to look
    serious: bool = True  #: whether a robot cannot be followed as long as it is so

    @property
    def said(self) -> str:
        """The sentences, and what to pass."""
        if not self.advice:
            return self.text
        return f"{self.text}{' ' if self.text.endswith('?') else '. '}{self.advice}"


@dataclass(frozen=True)
class Given:
    """Statements about scans, made before they were located."""

    flipped: bool = False  #: they were taken for those of a sensor that hangs upside down
    range_scale: float = 1.0  #: their ranges were multiplied by it
    calibration: str = ""  #: the file that the shared error of the options is from; empty: none is
    uncalibrated: Shared = field(default_factory=Shared)  #: the shared error without that file
    fov: float | None = None  #: the angle that their rays were taken to cover, radians

    def beside(
        self, map_path: PathLike, grid: OccupancyGrid, drawn: Drawn | None = None
    ) -> "Given":
        """The same, with the calibration file beside a map; `drawn` is stated about its walls."""
        shared = (drawn or Drawn()).on(Shared(), grid.resolution)
        file = display(calibration_path(map_path))
        return replace(self, calibration=file, uncalibrated=shared)

    def view_of(self, scan: LaserScan) -> float | None:
        """The angle that the rays of a scan were spread over as it was stated, degrees, if so."""
        stated = self.fov is not None and covers(scan.angles, self.fov)
        return math.degrees(self.fov or 0.0) if stated else None

    def calibrated(self, shared: Shared, keys: Sequence[str]) -> str:
        """Words that name the calibration file, and its values of some keys of `shared`.

        They end with what mends it. They are empty if the file does not decide any of these keys.

        Examples
        --------
        >>> given = Given(calibration="hall.calibration.json")
        >>> given.calibrated(Shared(scale=1.3), ["scale", "bent"])[:45]
        'hall.calibration.json, whose shared.scale is '
        >>> given.calibrated(Shared(), ["scale"]), Given().calibrated(Shared(1.3), ["scale"])
        ('', '')
        """
        used, without = vars(shared), vars(self.uncalibrated)
        values = [f"shared.{key} is {used[key]:g}" for key in keys if used[key] != without[key]]
        if not self.calibration or not values:
            return ""
        return (
            f"{self.calibration}, whose {' and '.join(values)}. Make that file anew with imgloc "
            "calibrate MAP --scans FILE `force=True`, or move it away"
        )

    def advice(self, options: str) -> str:
        """A sentence that advises `options`, or to leave out what was wrong before.

        Examples
        --------
        >>> Given().advice("`flipped=True`"), Given(flipped=True).advice("`flipped=True`")
        ('Try `flipped=True`', 'Leave out `flipped=True`')
        """
        flipped, *rest = options.split() or [""]
        if not (self.flipped and flipped == "`flipped=True`"):
            return f"Try {options}" if options else ""
        return f"Leave out {flipped}" + (f", and try {' '.join(rest)}" if rest else "")


_wrong = partial(Cause, "")
_warns, _look = partial(Cause, "", serious=False), partial(Cause, "", found=False)
_SCALED, _UPSIDE_DOWN = "`range_scale={factor:g}`", "`flipped=True`"
_CELLS, _SCANS = "`resolution={cells:.4g}`", "`odom=scans`"
AGREE = "scans and odometry agree only "
RAY_BY_RAY = "imgloc localize MAP SCANS `index=N` `explain=why.html` shows one ray by ray"
_ONCE_FOR_ALL = (
    "imgloc calibrate MAP --scans FILE finds it once for all from five scans or more, which is "
    "faster and surer"
)
_WHERE, OLD = "imgloc map changes MAP SCANS shows where", "an old map? see imgloc map changes"
#: Causes by their codes; words after a slash tell apart several of one code.
CAUSES: Mapping[str, Cause] = MappingProxyType({
    # Seen in readings, stamps and odometry.
    "stamps": _warns("all stamps are the same: they are no times"),
    "stamps/unit": _warns("the scans are {step:,.4g} s apart: are the stamps {unit}?"),
    "order": _warns("{stamps} back"),
    "units": _wrong("half of the ranges are above {middle:.4g} m{beyond}: are they {unit}?",
                    _SCALED, "{unit}? " + _SCALED),
    "units/either": _wrong("half of the ranges are above {middle:.4g} m{beyond}: are they "
                           "millimetres (`range_scale={factor:g}`) or centimetres "
                           "(`range_scale={other:g}`)?"),
    "units/moved": _wrong(AGREE + "if the ranges are {unit}", _SCALED),
    "codes": _wrong("{share:.1%} of the readings are {which}, and none is longer: it is the "
                    "sensor's code for a ray that met nothing", "`range_max={low:g}`"),
    "few": _wrong("{which} too few readings to be placed: {counts} {why}",
                  short="too few readings: {why}"),
    "too-close": _warns("{what}: the driver writes that where the sensor sees nothing, or its view "
                        "is blocked"),
    "own-body": _warns("{count:,} rays, from ray {first} to ray {last}, always see something "
                       "{metres:.2f} m away: is it the robot itself? Raise range_min of the file, "
                       "or leave these rays out"),
    "odometry-part": _warns("{count:,} scans have no odometry within 1 s: track leaves them out"),
    "odometry-zero": _wrong("the odometry never moves, but the scans change: it was not recorded",
                            _SCANS),
    "odometry-units": _wrong("the odometry moves {fast:.4g} m{each}: are these millimetres or "
                             "centimetres? Write metres, or try " + _SCANS, _SCANS),
    "odometries": _warns("{names}: {what}; `odom={first}` takes it all the same"),
    "gap": _warns("no scan for {seconds:.3g} s after scan {scan}, while the robot went "
                  "{metres:.3g} m: it may be lost there"),
    "jump": _warns("the odometry jumps by {metres:.3g} m after scan {scan}: it was reset, or "
                   "slipped"),
    "repeats": _warns("{share:.0%} of the scans repeat the one before to the last digit: the "
                      "driver publishes old buffers"),
    "twice": _warns("{share:.0%} of the scans come a second time later: was a log joined to "
                    "itself?"),
    "two-lasers": _wrong("{count} lasers in one file, and none says where it sits: keep one of "
                         "them"),
    "two-lasers/moved": _wrong("every other scan is of another laser, which sits elsewhere: keep "
                               "one of them"),
    "two-lasers/topics": _warns("{count} lasers: this is {first}; `topic={names}` follows all of "
                                "them"),
    # Tried by laying scans over each other, as the odometry moved the sensor.
    "two-lasers/odd": _wrong("of {laser} only {share:.0%} of the readings fall on an earlier scan, "
                             "as the odometry has it, but {better:.0%} if it {how}. Mend its place "
                             "on the robot, or leave it out", "`topic={others}`"),
    "two-lasers/mirrored": _wrong("scans of {laser} fit the map only if mirrored, those of "
                                  "{others} as they are: is {laser} upside down? Mend its place "
                                  "on the robot, or leave it out", "`topic={others}`"),
    "two-lasers/apart": _warns("{count} lasers: this is {first}; `topic` picks one of {names}"),
    "disagree": _warns("only {share:.0%} of the readings fall on an earlier scan, as the odometry "
                       "has it ({usual:.0%} and more is usual): is it another robot's odometry, "
                       "poor, or on another clock, or is the place of the sensor wrong, or "
                       "missing (`sensor=X,Y,YAW`)? " + _SCANS + " does without it", _SCANS),
    "disagree/along": _warns("scans fit this map one by one, but only {unique} of {count} have a "
                             "unique pose along the odometry: is it wrong, or is the map bent or "
                             "its resolution wrong?", "{options}"),
    "flipped": _wrong(AGREE + "with the scans mirrored: the sensor {hangs} upside down",
                      _UPSIDE_DOWN),
    "odometry-turn": _wrong(AGREE + "with theta of the odometry negated: left and right are "
                            "swapped", _SCANS),
    "mounting": _wrong(AGREE + "with the sensor turned by {turn:.0f} degrees on the robot",
                       "`sensor={sensor}`"),
    "view": _wrong(AGREE + "if the field of view is {right:.0f} degrees, not {view:.0f}: look at "
                   "angle_min, angle_max and angle_increment"),
    "view/stated": _wrong("{lead}if the field of view is {right:.4g} degrees, not {view:.4g}",
                          "`fov={right:.4g}`"),
    "lag": _wrong(AGREE + "with the odometry of about {late:.2g} {side} each scan: their clocks "
                  "differ, or one is written late", _SCANS),
    # Tried by locating some scans in another way, or seen in the map.
    "poses": _warns(NOT_TRUE),
    "calibration": _wrong("{fits} this map far better {than} {calibrated}", "",
                          "fits far better without {file}"),
    "centimetres": _wrong(SLIP, short="is the map's resolution in centimetres?"),
    "swapped": _wrong(SWAPPED, short="black and white of the map look swapped: is negate right?"),
    "prior": _wrong("the best fit, {where}, lies outside {asked}: {right} right?", "",
                    "fits where {asked} {leave} out"),
    "mirrored": _wrong("{fits} at one place if mirrored: is the sensor upside down, or the map's "
                       "image mirrored?", _UPSIDE_DOWN, "fits if mirrored: {advice}"),
    "mirrored/map": _wrong("scans fit the map only if mirrored, but agree with the odometry as "
                           "they are: the image of the map is mirrored. Mirror it, left to right",
                           "", "the map is mirrored"),
    "scale": _wrong("{fits} if ranges are multiplied by {times:.4g}: {why} Try "
                    + _SCALED + ", or " + _CELLS, _SCALED,
                    "fits with ranges x {times:.4g}: {why}"),
    "scale/map": _wrong("{fits} if ranges are multiplied by {times:.4g}, but agree "
                        "with the odometry as they are: the cells of the map are of {cells:.4g} m. "
                        "Try " + _CELLS, _CELLS, "the map's resolution is {cells:.4g} m"),
    "scale/ranges": _wrong("{fits}, and agree with the odometry, if ranges are "
                           "multiplied by {times:.4g}: their unit is another one, or they are "
                           "too short or too long. Try " + _SCALED, _SCALED,
                           "fits with ranges x {times:.4g}"),
    "plan": _wrong("the map: " + DRAWN, "", "the map looks like a drawing: imgloc map plan"),
    "old": _look("{none} not fit this map well, but they agree about the way between them, and "
                 "{share:.0%} of their rays fit there: the map may be old. " + _WHERE + "; "
                 + RAY_BY_RAY, short=OLD),
    "old/followed": _look("most scans do not fit this map by themselves, but {share:.0%} have a "
                          "unique pose along the way: the map may be old. " + _WHERE, short=OLD),
    "map": _look("{none} not fit this map{also}: is it the map of this place? imgloc which FOLDER "
                 "SCANS compares the maps of a folder; " + RAY_BY_RAY,
                 short="another map? see imgloc which, imgloc map check"),
    "old/walls": _look("scans at sure poses pass {share:.0%} of the walls in view: the map is old, "
                       "has a wrong resolution, or is of another place. " + _WHERE, short=OLD,
                       serious=False),
    "map/other": _wrong("scans at sure poses pass {share:.0%} of the walls in view: this map is of "
                        "another place, or much has changed since it was made. Do not rely on "
                        "these poses before you know which. " + _WHERE + ", imgloc which FOLDER "
                        "SCANS compares the maps of a folder", "", "another place, or an old map?"),
    "map/undecided": _warns("{sure} of the scans tried have one place on this map{besides}: it may "
                            "be the map of another place. imgloc track MAP LOG tells within some "
                            "metres, imgloc which FOLDER SCANS compares the maps of a folder"),
    "none": _look("imgloc localize finds such scans at one place of {name}, because it takes for "
                  "granted that they are from that map; imgloc which does not"),
    "thick": _wrong("the walls of this map are drawn thick, as on maps that no laser made. imgloc "
                    "took them to be {less:.2f} m thinner on each side, and each piece of them to "
                    "stand {off:.2f} m off. On such a map one scan is rarely enough. imgloc track "
                    "finds the robot over some metres; a map of the robot's own scans gives surer "
                    "poses", "", "the walls are drawn thick: imgloc track"),
    "bent": _wrong("{fits} this map far better with {found}. " + _ONCE_FOR_ALL, "",
                   "fits far better with {brief}: imgloc calibrate"),
    "bent/walls": _wrong("most scans fit this map far better with {found}, so imgloc allowed for "
                         "that; a map drawn from the robot's own scans gives surer poses", "",
                         "the walls of the map are bent"),
    "floor": _wrong("{fits} this map only without the {share:.0%} of the rays that end on {shape} "
                    "{metres:.1f} m away, which is on no map: is the laser tilted, so that it "
                    "meets the floor there? Level it, or cut its ranges", "",
                    "{shape} {metres:.1f} m away is on no map: the floor?"),
    "start": _wrong("the first scan fits this map at {at}, {away:.1f} m from `start`: is it right?",
                    "", "`start` is wrong"),
})  # fmt: skip


def cause(key: str, given: Given | None = None, **values: Any) -> Cause:
    """A cause of the table with its values; options that were `given` already are left out."""
    row, given = CAUSES[key], given or Given()
    values |= {"hangs": "does not hang" if given.flipped else "hangs"}
    options = row.options.format(**values)
    advice = given.advice(options)
    brief = advice[:1].lower() + advice[1:]
    text, short = (words.format(**values, advice=brief) for words in (row.text, row.short))
    return replace(
        row, code=key.partition("/")[0], text=text, short=short or text, options=options,
        advice="" if options in text else advice,
    )  # fmt: skip
