"""Frames of a robot over time: where a frame sits in another, whichever way the links lead."""

from bisect import bisect_right

import numpy as np

from imgloc.model import FloatArray

GAP = 1.0
"""Most seconds from a moment to what is known before and after it."""
BASES = ("base_footprint", "base_link", "base")
"""Frames that are the robot's own, by their usual names."""
_SAME = 1e-9  # metres, and of a rotation's matrix


class _Link:
    """Poses of a child in its parent, in the order of time; one that never changes is static."""

    def __init__(self) -> None:
        self.stamps = list[float]()
        self.poses = list[FloatArray]()
        self.static = True

    def add(self, pose: FloatArray, stamp: float, most: int) -> None:
        self.static &= not self.poses or _close(pose, self.poses[0])
        k = bisect_right(self.stamps, stamp)
        last = self.poses[-2:]
        if k == len(self.stamps) and len(last) == 2 and all(_close(pose, p) for p in last):
            self.stamps[-1] = stamp  # what stays the same is a beginning and an end
            return
        self.stamps.insert(k, stamp)
        self.poses.insert(k, pose)
        if len(self.stamps) > most:
            del self.stamps[0], self.poses[0]

    def at(self, stamp: float) -> FloatArray | None:
        if self.static:
            return self.poses[-1] if self.poses else None
        k = bisect_right(self.stamps, stamp)
        if k and self.stamps[k - 1] == stamp:
            return self.poses[k - 1]
        if not 0 < k < len(self.stamps):
            return None
        before, after = self.stamps[k - 1], self.stamps[k]
        if _close(self.poses[k - 1], self.poses[k]):
            return self.poses[k]
        if max(stamp - before, after - stamp) > GAP:
            return None
        return between(self.poses[k - 1], self.poses[k], (stamp - before) / (after - before))


class Frames:
    """A tree of frames; each link has poses over time. A static link is one with one pose.

    Parameters
    ----------
    most : int
        Poses of a link that are kept, the latest.

    Examples
    --------
    >>> frames, turned = Frames(), np.diag([-1.0, -1.0, 1.0, 1.0])
    >>> frames.add("laser", "base_link", turned)
    True
    >>> frames.add("base_link", "base_footprint", np.eye(4))
    True
    >>> frames.at("base_footprint", "laser")[:2, :2].tolist()
    [[-1.0, 0.0], [0.0, -1.0]]
    >>> frames.base_of("laser"), frames.at("laser", "odom") is None
    ('base_footprint', True)
    """

    def __init__(self, most: int = 1_000_000) -> None:
        self._links = dict[tuple[str, str], _Link]()  # by child and parent
        self._above = dict[str, list[str]]()  # parents of a frame, the latest last
        self._below = dict[str, list[str]]()  # children
        self._paths = dict[tuple[str, str], list[str] | None]()
        self._most = most

    def add(self, child: str, parent: str, pose: FloatArray, stamp: float = -np.inf) -> bool:
        """Add the pose (4, 4) of a frame in its parent at a time, seconds.

        Returns whether it was finite; else it is left out. A static link needs no stamp.
        """
        if not np.isfinite(pose).all() or child == parent:
            return False
        link = self._links.get((child, parent))
        if link is None:
            for other in tuple(self._above.get(child, ())) if stamp == -np.inf else ():
                if self._links[child, other].stamps == [-np.inf]:
                    self._cut(child, other)  # a static link is replaced by the next
            link = self._links[child, parent] = _Link()
            self._above.setdefault(child, []).append(parent)
            self._below.setdefault(parent, []).append(child)
            self._paths = {}
        if stamp > -np.inf:
            if link.stamps == [-np.inf]:  # what moves is no placeholder
                link.stamps, link.poses = [], []
            link.add(pose, stamp, self._most)
        elif link.stamps in ([], [-np.inf]):
            link.stamps, link.poses = [stamp], [pose]
        return True

    def join(self, other: "Frames") -> None:
        """Add the links of another tree whose frames have no parent in this one."""
        known = self.named
        for (child, parent), link in other._links.items():
            if child not in known:
                self.add(child, parent, link.poses[0], link.stamps[0])
                self._links[child, parent] = link

    @property
    def named(self) -> set[str]:
        """Frames that have a parent."""
        return {child for child, _ in self._links}

    def forget(self) -> None:
        """Forget the links that move, because time begins anew."""
        for child, parent in [key for key, one in self._links.items() if one.stamps != [-np.inf]]:
            self._cut(child, parent)

    def _cut(self, child: str, parent: str) -> None:
        del self._links[child, parent]
        self._above[child].remove(parent)
        self._below[parent].remove(child)
        self._paths = {}

    def path(self, frame: str, base: str) -> list[str] | None:
        """The frames from one to another, both included, up and down the tree; None if none lead.

        Examples
        --------
        >>> frames = Frames()
        >>> frames.add("left", "base", np.eye(4)), frames.add("right", "base", np.eye(4))
        (True, True)
        >>> frames.path("left", "right"), frames.path("left", "map")
        (['left', 'base', 'right'], None)
        """
        if (frame, base) not in self._paths:
            self._paths[frame, base] = self._path(frame, base)
        return self._paths[frame, base]

    def _path(self, frame: str, base: str) -> list[str] | None:
        came, line = {frame: frame}, [frame]
        for at in line:
            if at == base:
                break
            for other in (*self._above.get(at, ())[::-1], *self._below.get(at, ())):
                if other not in came:
                    came[other] = at
                    line.append(other)
        if base not in came:
            return None
        out = [base]
        while out[-1] != frame:
            out.append(came[out[-1]])
        return out[::-1]

    def at(self, frame: str, base: str, stamp: float = np.inf) -> FloatArray | None:
        """Pose (4, 4) of a frame in another at a time; None if it is not known then.

        It is interpolated between two poses at most :data:`GAP` away, and never held.
        """
        path, pose = self.path(frame, base), np.eye(4)
        for child, parent in zip(path or (), (path or ())[1:], strict=False):
            link = self._links.get((child, parent))
            back = self._links.get((parent, child)) if link is None else None
            step = (link or back or _Link()).at(stamp)
            if step is None:
                return None
            pose = (np.linalg.inv(step) if back else step) @ pose
        return None if path is None else pose

    def parents(self, frame: str) -> list[str]:
        """The frame, its parent, and so on up to the root; the latest link counts."""
        out = {frame: None}
        while above := self._above.get(next(reversed(out)), []):
            if above[-1] in out:
                break
            out[above[-1]] = None
        return list(out)

    def above(self, frame: str) -> list[str]:
        """The frame's parent, if it has any: that of the latest link."""
        return self._above.get(frame, [])[-1:]

    def children(self, frame: str) -> list[str]:
        """Frames whose parent this one is."""
        return list(self._below.get(frame, ()))

    def base_of(self, frame: str) -> str | None:
        """The base of the robot that has a frame: the nearest of :data:`BASES`, first come first.

        Names may have a namespace: ``tb3_0/base_link``.
        """
        every = {name for link in self._links for name in link} | {frame}
        for base in BASES:
            named = sorted(name for name in every if name.split("/")[-1] == base)
            paths = [path for name in named if (path := self.path(frame, name)) is not None]
            if paths:
                return min(paths, key=len)[-1]
        return None

    def moves(self, child: str, parent: str) -> tuple[FloatArray, FloatArray]:
        """Stamps (N,) and poses (N, 4, 4) of a link."""
        link = self._links[child, parent]
        return np.array(link.stamps), np.array(link.poses)

    def static(self, child: str, parent: str) -> bool:
        """Return whether a link never changes."""
        return self._links[child, parent].static


def space_of(topic: str) -> str:
    """The namespace of a topic.

    Examples
    --------
    >>> space_of("/robot1/tf"), space_of("/tf")
    ('robot1', '')
    """
    return topic.strip("/").rpartition("/")[0]


def between(a: FloatArray, b: FloatArray, share: float) -> FloatArray:
    """The pose (4, 4) at a share, 0..1, of the way from one to another: a line, and one turn.

    Examples
    --------
    >>> quarter = np.array([[0, -1.0, 0, 2], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> between(np.eye(4), quarter, 0.5).round(3)[0].tolist()
    [0.707, -0.707, 0.0, 1.0]
    """
    from scipy.spatial.transform import Rotation

    out = a + share * (b - a)
    turn = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()
    out[:3, :3] = a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    return np.asarray(out)


def _close(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.abs(a - b).max() <= _SAME)
