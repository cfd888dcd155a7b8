"""A building of two rooms, small enough to be drawn and read again in every test."""

import numpy as np

from tools.plans.drawing import Building, Opening, box


def cabin(_seed: int = 0, turn: float = 0.0) -> Building:
    """9 x 5.5 m: outer walls of 0.3 m, one of 0.12 m between the rooms; two doors, a window."""
    w, d, h = 9.0, 5.5, 0.15
    lines = [(0, h, w, h), (0, d - h, w, d - h), (h, 0, h, d), (w - h, 0, w - h, d)]
    walls = [(np.array([a, b], float), np.array([c, e], float), 0.3) for a, b, c, e in lines]
    walls.append((np.array([5.2, 0.25]), np.array([5.2, d - 0.25]), 0.12))
    openings = (
        Opening(0, 1.2, 1.0, "door", side=1),
        Opening(4, 3.4, 0.9, "door", side=1, hinge=1),
        Opening(1, 1.5, 1.6, "window"),
    )
    desk = box(6.8, 2.4, 8.2, 3.1)
    chair = np.array([(7.5, 2.0), (7.72, 2.0)])
    return Building(
        (w, d), tuple(walls), openings, (box(2.6, 2.6, 3.0, 3.0),),
        (("box", desk), ("circle", chair), ("stairs", box(3.6, 1.3, 4.8, 3.2))),
        (("HALL 25 m2", np.array([2.2, 4.3])), ("A01 18 m2", np.array([7.1, 1.2]))),
        (box(7.0, 4.0, 7.5, 4.4),), turn, np.array([2.5 + d * np.sin(turn), 2.5]),
    )  # fmt: skip
