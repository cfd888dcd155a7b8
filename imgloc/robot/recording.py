"""Contents of a log by name, and the odometry of the robot that carries a laser."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from imgloc.errors import ScanError
from imgloc.model import FloatArray
from imgloc.robot.frames import BASES, Frames, space_of
from imgloc.robot.odometry import Odometry

# Poses of a simulator or of cameras in the room, which a robot does not know of itself.
_TRUTH = re.compile(r"truth|mocap|vicon|optitrack|gazebo|amcl", re.IGNORECASE)
_FIXED = ("map", "world", "earth")
SCANS = "scans"
"""The name of the odometry that scans tell themselves."""


@dataclass(frozen=True)
class Source:
    """An odometry of a log: a topic, or a link of tf that moves."""

    name: str  #: the topic, or the parent's name
    frame: str  #: in which the poses are
    child: str  #: the frame of the robot, whose poses they are; empty if it is not named
    odometry: Odometry = field(default_factory=Odometry)
    tf: bool = False  #: whether it is a link of tf

    @property
    def words(self) -> str:
        """Its name as messages have it."""
        return f"tf {self.frame} -> {self.child}" if self.tf else self.name

    def named(self, asked: str) -> bool:
        """Return whether somebody asks for it, by its topic or one of its frames."""
        names = (self.name.strip("/"), self.frame, self.child)
        return asked.strip("/") in filter(None, names)


@dataclass(frozen=True)
class Recording:
    """Contents of a log by name, and which of it was taken.

    Examples
    --------
    >>> Recording(("/scan",), "/scan", "/odom", "it has the frame of the laser", ("/odom2",))
    Recording(lasers=('/scan',), taken='/scan', odometry='/odom', why='it has the frame of the ...
    """

    lasers: tuple[str, ...] = ()  #: topics of scans
    taken: str = ""  #: of the scans that were read
    odometry: str = ""  #: that was taken; empty if there is none
    why: str = ""  #: why this one
    others: tuple[str, ...] = ()  #: further odometries of this robot
    robots: tuple[str, ...] = ()  #: odometries of other robots, and of nothing that carries it
    truths: tuple[str, ...] = ()  #: poses that are not the robot's own knowledge
    maps: tuple[str, ...] = ()  #: topics of maps


def pick_odometry(
    topics: Sequence[Source], frames: Frames, laser: str, about: Recording, asked: str, name: str,
    spaces: Mapping[str, Frames],
) -> tuple[Source | None, Recording]:  # fmt: skip
    """Pick the odometry of the robot that carries a laser, if any; name it and the others.

    It is the moving frame from which tf leads to the frame of the laser: a topic whose
    `child_frame_id` is a part of the same robot, else a link of tf above the laser that moves.
    Without tf, names decide: the laser's namespace. Poses that the robot cannot know of itself are
    no odometry, unless they are asked for.

    Parameters
    ----------
    topics : sequence of Source
        nav_msgs/Odometry by topic.
    frames : Frames
        All transforms of the log.
    laser : str
        Frame of the scans.
    about : Recording
        The topic of the scans is `taken`.
    asked : str
        Topic or frame that the user names; empty to pick one.
    name : str
        What errors call the log.
    spaces : mapping of str to Frames
        Transforms by the namespace of their topic.

    Raises
    ------
    ScanError
        If `asked` is not there, or several robots have an odometry and nothing shows which one
        carries the laser. The error names the candidates.
    """
    links, topic = list(_moving(frames, laser)), about.taken
    if asked:
        every = [*topics, *links, *(_link(frames, one, asked) for one in frames.children(asked))]
        found = next((source for source in every if source.named(asked)), None)
        if found is None:
            there = ", ".join(dict.fromkeys(source.words for source in every)) or "none"
            raise ScanError(f"{name}: `odom`: no odometry {asked}; it has {there}")
        rest = tuple(dict.fromkeys(s.words for s in every if s.words != found.words))
        return found, replace(about, odometry=found.words, why="it was asked for", others=rest)
    truths = [s for s in topics if _TRUTH.search(s.name)]
    if any(s.frame.split("/")[-1] not in _FIXED for s in (*topics, *links)):
        truths += [s for s in topics if s.frame.split("/")[-1] in _FIXED and s not in truths]
    own = [source for source in topics if source not in truths]
    # A body ends where an odometry begins: two robots may hang in one tree.
    ends = {source.frame for source in own if source.frame} | {link.frame for link in links[:1]}
    body = _reached(frames, laser, ends)
    near = [s for s in own if {*spaces_above(s.name, spaces)} <= {*spaces_of(topic, spaces)}]
    linked = [s for s in near if s.child in body]
    known = [s for s in own if s not in near or (s.child and frames.parents(s.child)[1:])]
    unknown = [s for s in own if s not in linked and s not in known]
    names = tuple(source.words for source in truths)
    if not linked and unknown:
        linked = [s for s in unknown if space_of(s.name) == space_of(topic)] or unknown
        if len({space_of(s.name) for s in linked}) > 1 and not links:
            there = ", ".join(source.words for source in linked)
            raise ScanError(
                f"{name}: several odometries, and tf does not lead from one of them to {laser}; "
                f"pass `odom`, one of {there}"
            )
    robots = tuple(s.words for s in (*known, *unknown) if s not in linked)
    about = replace(about, robots=robots, truths=names)
    told = [source for source in linked if len(source.odometry) > 1]
    if told or (linked and not links):
        linked = told or linked
        best = min(linked, key=lambda s: _rank(s, links, topic))
        rest = tuple(s.words for s in linked if s is not best)
        why = f"tf leads from {best.child} to {laser}" if best.child in body else "by its name"
        return best, replace(about, odometry=best.words, why=why, others=rest)
    if links:
        why = f"tf leads from {links[0].child} to {laser}"
        rest = tuple(source.words for source in linked)
        return links[0], replace(about, odometry=links[0].words, why=why, others=rest)
    return None, about


def _rank(source: Source, links: Sequence[Source], topic: str) -> tuple[bool, bool, bool, str]:
    """The lesser, the likelier: as drivers call it, and as tf has it."""
    called = source.name.strip("/").split("/")[-1] != "odom"
    away = space_of(source.name) != space_of(topic)
    other = bool(links) and (source.frame, source.child) != (links[0].frame, links[0].child)
    return called, away, other, source.name


def _moving(frames: Frames, laser: str) -> Iterator[Source]:
    """Links above the laser that move, those that are called so first, then nearest the base.

    A joint between base and laser moves, too: the base's own name distinguishes it.
    """
    line = frames.parents(laser)
    pairs = list(pairwise(line))
    some = [
        (child, parent) for child, parent in pairs
        if "odom" in parent.lower() or not frames.static(child, parent)
    ]  # fmt: skip
    based = any(child.split("/")[-1] in BASES for child in line)

    def order(pair: tuple[str, str]) -> tuple[bool, bool, bool]:
        child, parent = pair
        joint = based and not any(
            at.split("/")[-1] in BASES for at in line[: 1 + line.index(child)]
        )
        return joint, "odom" not in parent.lower(), parent.split("/")[-1] in _FIXED

    for child, parent in sorted(some, key=order):
        if not order((child, parent))[0]:
            yield _link(frames, child, parent)


def _link(frames: Frames, child: str, parent: str) -> Source:
    stamps, poses = frames.moves(child, parent)
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    rows = np.column_stack((poses[:, 0, 3], poses[:, 1, 3], yaw))
    return Source(parent, parent, child, Odometry(stamps, rows), tf=True)


def _reached(frames: Frames, laser: str, ends: set[str]) -> set[str]:
    """Frames to which links lead from the laser without those that are not of its robot."""
    out, line = {laser}, [laser]
    for at in line:
        near = [*frames.above(at), *frames.children(at)]
        new = [other for other in near if other not in out and other not in ends]
        out.update(new)
        line += new
    return out


def spaces_above(topic: str, spaces: Collection[str]) -> list[str]:
    """Pick the namespaces that a topic is in, the nearest first.

    Examples
    --------
    >>> spaces_above("/a/front/scan", ["", "a", "b"]), spaces_above("/scan", ["a"])
    (['a', ''], [])
    """
    path = f"/{space_of(topic)}/"
    own = (space for space in spaces if not space or path.startswith(f"/{space}/"))
    return sorted(own, key=len, reverse=True)


def spaces_of(topic: str, spaces: Mapping[str, Frames]) -> list[str]:
    """Pick the namespaces whose transforms are those of the robot that has a topic.

    Robots whose frames have the same names have transforms on topics of their own. Where none of
    these is the topic's, the transforms of one robot may be on several.
    """
    own = spaces_above(topic, spaces)
    named = Counter(frame for frames in spaces.values() for frame in frames.named)
    more = [space for space, frames in spaces.items() if all(named[f] == 1 for f in frames.named)]
    return own if any(own) else list(dict.fromkeys(own + more))


def frames_of(topic: str, spaces: Mapping[str, Frames]) -> Frames:
    """Transforms by namespace, joined for the robot that has a topic: the nearest ones count."""
    joined = Frames()
    for space in spaces_of(topic, spaces):
        joined.join(spaces[space])
    return joined


def mounted(
    frames: Frames, laser: str, base: str, stamps: FloatArray
) -> Mapping[float, FloatArray] | None:
    """Pose (4, 4) of a laser on its robot at each time where it is known; None if tf never has it.

    `base` is the frame of the odometry; without one it is the first of
    :data:`~imgloc.robot.frames.BASES` to which tf leads.
    """
    target = base if base and frames.path(laser, base) else frames.base_of(laser)
    if target is None:
        return None
    found = {t: frames.at(laser, target, t) for t in stamps.tolist()}
    return {t: pose for t, pose in found.items() if pose is not None}
