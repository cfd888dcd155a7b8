"""Results as text for people: tables, and lines that stand below each other."""

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from imgloc.errors import as_options
from imgloc.model import (
    SURE,
    VERDICTS,
    Evidence,
    Floor,
    Localization,
    Pose2D,
    Thing,
    base_of,
)  # fmt: skip
from imgloc.pose import difference

if TYPE_CHECKING:
    from imgloc.choice.choose import Choice
    from imgloc.filters.follow import Moment
    from imgloc.io.mapcheck import MapReport
    from imgloc.runs.batch import BatchSummary

_UNDER = "sd: standard deviation, with errors common to one wall"
_NAMED = 3  # things that a line names
_LISTED = 3  # maps that a line of `imgloc which` names


def as_plain(
    columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 0,
    width: int | None = None,
) -> str:  # fmt: skip
    """Format a table of cells under headings, `left` of the columns flush left; none is ever cut.

    What is wider than `width` characters goes on in further tables, below, with the `left` columns
    again.

    Examples
    --------
    >>> print(as_plain(("a", "b"), [("x", "1")], left=1))
    +---+---+
    | a | b |
    +---+---+
    | x | 1 |
    +---+---+
    >>> print(as_plain(("a", "b", "c"), [("x", "1", "2")], left=1, width=10))
    +---+---+
    | a | b |
    +---+---+
    | x | 1 |
    +---+---+
    +---+---+
    | a | c |
    +---+---+
    | x | 2 |
    +---+---+
    """
    sizes = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    if width is not None:
        last = left + 1
        while last < len(sizes) and sum(3 + size for size in sizes[: last + 1]) < width:
            last += 1
        if last < len(sizes):
            halves = [list(range(last)), [*range(left), *range(last, len(sizes))]]
            return "\n".join(
                as_plain(
                    [columns[k] for k in half],
                    [[row[k] for k in half] for row in rows],
                    left=left,
                    width=width,
                )
                for half in halves
            )
    flush = [str.ljust if k < left else str.rjust for k in range(len(sizes))]
    line = "".join(f"+{'-' * (size + 2)}" for size in sizes) + "+"

    def row_of(cells: Sequence[str]) -> str:
        put = (to(cell, size) for to, cell, size in zip(flush, cells, sizes, strict=True))
        return f"| {' | '.join(put)} |"

    return "\n".join((line, row_of(columns), line, *map(row_of, rows), line))


def pose_words(pose: Pose2D) -> str:
    """Return a pose in words."""
    return f"x {pose.x:.3f} m, y {pose.y:.3f} m, theta {math.degrees(pose.theta):.2f} deg"


def answer_header(mounted: bool = False) -> str:
    """Return what stands above the lines of :func:`answer_line`; `mounted` if they have a base."""
    base = f"  {'base x':>9} {'base y':>9} {'base theta':>11}" if mounted else ""
    place = f"{'x / m':>9} {'y / m':>9} {'theta / deg':>11}"
    shares = f"{'mass':>8} {'unlisted':>8} {'explained':>10}"
    return f"{'index':>6}  {'verdict':<10} {place} {shares}{base}"


def answer_line(index: int, answer: Localization, *, narrow: bool = False) -> str:
    """Return one line for one scan, to be written as soon as it is known.

    Where it is `narrow` the pose of the base is in a line of its own, below that of the sensor.
    """
    mass, rest, explained, mount = "-", "-", "-", answer.T_base_laser
    place = base = f"{'-':>9} {'-':>9} {'-':>11}"
    if answer.best is not None:
        mass, explained = percent(answer.hypotheses[0].mass), percent(answer.explained)
        rest = percent(_unlisted(answer))
        place = _place(answer.best)
        base = place if mount is None else _place(base_of(answer.best, mount))
    more = "" if mount is None or narrow else f"  {base}"
    more += "" if answer.complete else "  out of time"
    more += f"\n{'':>6}  {'base':<10} {base}" if narrow and mount is not None else ""
    return f"{index:>6}  {answer.verdict:<10} {place} {mass:>8} {rest:>8} {explained:>10}{more}"


def answer_text(title: str, answer: Localization, truth: Pose2D | None = None) -> str:
    """Return what is known about one scan, with a table of its hypotheses.

    With the `truth`, the pose of the sensor in the map frame, the error is stated.
    """
    pose, evidence, sure = answer.best, answer.evidence, answer.verdict in SURE
    facts: list[tuple[str, str]] = []
    if pose is not None:
        facts.append(("pose" if sure else "best guess", pose_words(pose)))
        if not sure:
            facts.append(("", "not to be trusted: the map does not explain the scan there"))
        if answer.T_base_laser is not None:
            facts.append(("base", pose_words(base_of(pose, answer.T_base_laser))))
    if truth is not None:
        facts.append(("truth", pose_words(truth)))
    if pose is not None:
        if truth is not None:
            away, turned = difference(pose, truth)
            facts.append(("error", f"{away:.3f} m, {math.degrees(turned):.2f} deg"))
        explained = f"{100 * answer.explained:.0f} % of the rays explained"
        facts.append(("trust", f"{explained}, entropy {answer.entropy:.3f} nats"))
        if within := _within(answer):
            facts.append(("within", within))
        if (bent := bent_words(evidence)) is not None:
            known: Any = answer.parameters.get("shared")
            calibrated = (
                known is not None
                and known["scale"] == evidence.scale
                and (known["thinner"] > 0 or not evidence.thinner)
                and known["bent"] == evidence.bent
            )
            taken = "allows for " if evidence.bent else "fits far better with "
            how = "as calibrated, " if calibrated else taken
            facts.append(("map", how + bent))
        if evidence.floor is not None:
            facts.append(("floor", floor_words(evidence.floor)))
        if evidence.things:
            facts.append(("things", thing_words(evidence.things)))
        poses = f"{evidence.listed} of {evidence.found} places shown"
        if evidence.unlisted > 0:
            poses += f"; the rest share {percent(evidence.unlisted)}"
        facts.append(("poses", f"{poses}; {percent(answer.elsewhere)} that none is right"))
    counts = ", ".join(f"{n} {key.replace('_', ' ')}" for key, n in answer.counts.items())
    facts += [("readings", counts), ("time", times_words(answer))]
    lines = [f"{title}: {answer.verdict}" + ("" if answer.complete else ", out of time")]
    lines += [f"  {name:<10} {fact}" for name, fact in facts]
    if answer.hypotheses:
        rows = [
            (
                str(k),
                percent(h.mass),
                *_place(h.pose).split(),
                f"{math.sqrt(max(0.0, h.covariance[0, 0] + h.covariance[1, 1])):.3f}",
                f"{math.degrees(math.sqrt(max(0.0, h.covariance[2, 2]))):.2f}",
                f"{h.log_likelihood:.1f}",
            )
            for k, h in enumerate(answer.hypotheses, start=1)
        ]
        columns = ("#", "mass", "x / m", "y / m", "theta / deg", "sd xy / m", "sd deg", "log L")
        lines += ["", as_plain(columns, rows), _UNDER]
        lines.append(f"not shown above: {percent(_unlisted(answer))} of the probability")
        masses = [h.mass for h in answer.hypotheses]
        if masses != sorted(masses, reverse=True):  # a peak may be higher than it holds
            lines[-1] += "; they are in the order of log L, the score"
    return "\n".join(lines)


def _within(answer: Localization) -> str:
    """The radii around the pose that hold the true one; empty if even the first is infinite.

    A radius that takes in other places is no measure of how exact the pose is.

    Examples
    --------
    >>> from imgloc import Protection
    >>> levels = Protection(0.95, 0.1, 0.02), Protection(0.999, math.inf, math.inf)
    >>> _within(Localization((), "unique", 0.0, 0.9, protection=levels))
    '0.10 m, 1.1 deg in 95 % of such answers'
    """
    others = sum(h.mass for h in answer.hypotheses[1:])
    words = []
    for level in answer.protection:
        if others > 1 - level.share:
            words.append(f"other places have {100 * others:.0f} %")
            break
        if math.isfinite(level.metres):
            turn = math.degrees(min(level.radians, math.pi))
            answers = " of such answers" * (not words)
            words.append(
                f"{level.metres:.2f} m, {turn:.1f} deg in {100 * level.share:g} %{answers}"
            )
    return "; ".join(words)


def _unlisted(answer: Localization) -> float:
    """Mass that is in none of the hypotheses listed."""
    return max(0.0, 1.0 - sum(h.mass for h in answer.hypotheses))


def bent_words(found: "Evidence | Moment") -> str | None:
    """Say what error of all readings was allowed for; None if none was.

    Examples
    --------
    >>> bent_words(Evidence(scale=1.0486, thinner=0.1)), bent_words(Evidence())
    ('ranges x 1.049 and walls 0.10 m thinner on each side', None)
    """
    said = [f"ranges x {found.scale:.3f}"] if found.scale != 1.0 else []
    if found.thinner > 0:
        said.append(f"walls {found.thinner:.2f} m thinner on each side")
    if found.bent > 0:
        said.append(f"pieces of wall {found.bent:.2f} m off")
    return " and ".join(said) or None


def thing_words(things: Sequence[Thing]) -> str:
    """Name the pieces of a scan that differ from the map.

    Examples
    --------
    >>> thing_words([Thing(0.5, 2.0, 0.15, False), Thing(-1.5, 4.0, 0.09, True)])
    '2 differ from the map, 24 % of the readings: 2.0 m away at 29 deg, 4.0 m away at -86 deg \
(through a wall of the map)'
    """
    share = 100 * sum(thing.share for thing in things)
    where = [
        f"{thing.distance:.1f} m away at {math.degrees(thing.bearing):.0f} deg"
        + " (through a wall of the map)" * thing.through
        for thing in things[:_NAMED]
    ]
    more = ["..."] * (len(things) > _NAMED)
    found = f"{len(things)} differ from the map, {share:.0f} % of the readings"
    return f"{found}: {', '.join(where + more)}"


def floor_words(floor: Floor) -> str:
    """Say which readings were left out because they end on the floor.

    Examples
    --------
    >>> floor_words(Floor(5.0, 0.1, 0.4))
    'left out 40 % of the rays: they end on a line 5.0 m away at 6 deg'
    """
    where = "a circle" if math.isnan(floor.direction) else "a line"
    at = "" if math.isnan(floor.direction) else f" at {math.degrees(floor.direction):.0f} deg"
    found = f"they end on {where} {floor.distance:.1f} m away{at}"
    return f"left out {100 * floor.share:.0f} % of the rays: {found}"


def run_words(verdicts: Sequence[str], errors: Sequence[tuple[float, float]]) -> str:
    """Say how a run of scans went: verdicts, and errors (metres, radians) where poses are known.

    Examples
    --------
    >>> run_words(["unique", "unique", "invalid"], [(0.04, 0.01), (3.0, 0.02)])
    '3 scans: 2 unique, 1 invalid; 1 of 2 first poses within 0.5 m and 10 deg of the known ones, \
median error 1.520 m and 0.86 deg'
    """
    counts = [(v, verdicts.count(v)) for v in VERDICTS]
    said = ", ".join(f"{n} {verdict}" for verdict, n in counts if n)
    text = f"{len(verdicts)} scans: {said}"
    if not errors:
        return text
    near = sum(away <= 0.5 and turned <= math.radians(10) for away, turned in errors)
    metres, radians = (statistics.median(column) for column in zip(*errors, strict=True))
    middle = f"median error {metres:.3f} m and {math.degrees(radians):.2f} deg"
    right = f"{near} of {len(errors)} first poses within 0.5 m and 10 deg of the known ones"
    return f"{text}; {right}, {middle}"


def times_words(answer: Localization) -> str:
    """The time of each step of an answer."""
    return ", ".join(f"{key} {ms:.0f} ms" for key, ms in answer.timings_ms.items())


def _place(pose: Pose2D) -> str:
    return f"{pose.x:9.3f} {pose.y:9.3f} {math.degrees(pose.theta):11.2f}"


def percent(share: float) -> str:
    """Return a share as a percentage with one digit behind the point."""
    return f"{100 * share:.1f} %"


CHOICE_HEADER = f"{'index':>6}  {'verdict':<24} {'probability':>11} {'none':>7}  pose or next best"
"""What stands above the lines of :func:`choice_line`."""


def choice_line(index: int, choice: "Choice", fits: Mapping[str, Localization]) -> str:
    """Return one line for one scan: the pose in the map that is named, else the candidates."""
    if choice.verdict == "invalid":
        return f"{index:>6}  {choice.verdict:<24} {'-':>11} {'-':>7}  too few readings"
    name = next(iter(choice.probability))
    pose = fits[name].best
    if choice.verdict == name and pose is not None:
        more = f"{pose_words(pose)} ({fits[name].verdict})"
    else:
        some = list(choice.probability.items())[:_LISTED]
        more = ", ".join(f"{other} {percent(share)}" for other, share in some)
    probability, none = percent(choice.probability[name]), percent(choice.none)
    return f"{index:>6}  {choice.verdict:<24} {probability:>11} {none:>7}  {more}"


def report_text(report: "MapReport") -> str:
    """Return what is in a map, and what is likely to be wrong with it."""
    width, height = report.size
    o = report.origin
    shares = ", ".join(f"{key} {percent(share)}" for key, share in report.shares.items())
    greys = ", ".join(f"{value:g} ({cells:,})" for value, cells in report.greys)
    more = report.grey_levels - len(report.greys)
    parts = ", ".join(f"{area:.1f}" for area in report.free_parts)
    shares += "" if report.movable is None else f"; movable {percent(report.movable)} of all"
    lines = [
        report.path,
        f"  image       {report.image} ({report.kind})",
        f"  cells       {report.width:,} x {report.height:,} of {report.resolution:g} m: "
        f"{width:.1f} x {height:.1f} m, {report.area:.1f} m2 free",
        f"  origin      x {o.x:g} m, y {o.y:g} m, yaw {math.degrees(o.theta):.2f} deg",
        f"  read as     {report.mode}, {report.semantics}, negate {report.negate}, "
        f"occupied_thresh {report.occupied_thresh:g}, free_thresh {report.free_thresh:g}",
        f"  classes     {shares}",
        f"  free parts  {parts or 'no'} m2",
        f"  greys       {greys}" + (f" and {more:,} more" if more else ""),
        f"  nav2/ros1   {report.semantics_differ:,} cells are read differently",
        f"  warnings    {len(report.warnings) or 'none'}",
    ]
    return "\n".join(lines + [f"    {as_options(str(w))}" for w in report.warnings])


def batch_text(summary: "BatchSummary", folder: str) -> str:
    """Return what the rows of a batch come to, in words.

    Examples
    --------
    >>> from imgloc.runs.batch import BatchSummary
    >>> found = BatchSummary(3, {"ok": 2, "timeout": 1}, {"unique": 9, "ambiguous": 1}, 10, 9)
    >>> print(batch_text(found, "out"))
    3 items: 2 ok, 1 timeout
    10 scans: 9 unique, 1 ambiguous
    of 10 scans with a known pose 9 are right (90.0 %), 0 unique and wrong
    1 more items failed: out/results.jsonl has the message of each
    0 new rows in 0.0 s: out/results.jsonl
    """
    lines = [f"{summary.items:,} items: {_counted(summary.statuses)}"]
    if summary.verdicts:
        total = sum(summary.verdicts.values())
        lines.append(f"{total:,} scans: {_counted(summary.verdicts)}")
    if summary.known:
        right = f"{summary.hits:,} are right ({100 * summary.hits / summary.known:.1f} %)"
        wrong = f"{summary.unique_wrong:,} unique and wrong"
        lines.append(f"of {summary.known:,} scans with a known pose {right}, {wrong}")
        if summary.pairs > summary.files:
            files = f"{summary.files:,} file{'s' * (summary.files != 1)}"
            lines.append(
                f"  the poses of {files} count on every map, in {summary.pairs:,} pairs; a CSV of "
                "pairs (map,scans) assigns files to maps"
            )
    for kind in summary.failures[:_LISTED]:
        more = f" and {kind['items'] - 1:,} more" if kind["items"] > 1 else ""
        why = as_options(kind["message"])
        lines.append(f"{kind['status']}: {kind['first']}{more}: {why}")
    if (rest := summary.failed - sum(kind["items"] for kind in summary.failures[:_LISTED])) > 0:
        lines.append(f"{rest:,} more items failed: {folder}/results.jsonl has the message of each")
    for kind in summary.warnings[:_LISTED]:
        count = f" (in {kind['items']:,} items)" if kind["items"] > 1 else ""
        lines.append(f"warning{count}: {as_options(kind['warning'])}")
    if len(summary.warnings) > _LISTED:
        more = f"{len(summary.warnings) - _LISTED} more warnings"
        lines.append(f"{more} are in cost.warnings of the rows")
    for hint in summary.hints:
        tried = f"{hint['items']} of {hint['of']} doubtful items tried again"
        lines.append(f"{tried}, for example {hint['first'][0]}: {as_options(hint['hint'])}")
    lines.append(f"{summary.new:,} new rows in {summary.seconds:.1f} s: {folder}/results.jsonl")
    return "\n".join(lines)


def _counted(counts: Mapping[str, int]) -> str:
    order = sorted(counts, key=lambda word: (-counts[word], word))
    return ", ".join(f"{counts[word]:,} {word}" for word in order)
