"""The reliability diagram: of the hypotheses of a mass, the share that is right."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import cv2
import numpy as np

from imgloc.output.canvas import INK, PALETTE, PAPER, SHADE, Image, text, text_width

_SIDE, _LEFT, _BELOW, _TOP = 520, 70, 60, 40


class _Share(Protocol):
    @property
    def value(self) -> float: ...
    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...


class _Bin(Protocol):
    @property
    def count(self) -> int: ...
    @property
    def mass(self) -> float: ...
    @property
    def right(self) -> _Share: ...


def draw_reliability(groups: Mapping[str, Sequence[_Bin]]) -> Image:
    """Draw the share of right hypotheses over their mass, with 95 % intervals.

    Parameters
    ----------
    groups : mapping of str to bins
        Of :func:`imgloc.experiments.reliability.reliability`, by name.

    Returns
    -------
    (H, W, 3) uint8 array
    """
    height, width = _TOP + _SIDE + _BELOW, _LEFT + _SIDE + 30
    image = np.full((height, width, 3), PAPER, np.uint8)

    def at(x: float, y: float) -> tuple[int, int]:
        return round(_LEFT + _SIDE * x), round(_TOP + _SIDE * (1 - y))

    for k in range(11):
        cv2.line(image, at(k / 10, 0), at(k / 10, 1), SHADE, 1, cv2.LINE_AA)
        cv2.line(image, at(0, k / 10), at(1, k / 10), SHADE, 1, cv2.LINE_AA)
        if k % 2 == 0:
            label = f"{k / 10:.1f}"
            x, y = at(k / 10, 0)
            text(image, label, x - text_width(label) // 2, y + 20)
            x, y = at(0, k / 10)
            text(image, label, x - 12 - text_width(label), y + 5)
    cv2.line(image, at(0, 0), at(1, 1), INK, 1, cv2.LINE_AA)
    for k, (name, bins) in enumerate(groups.items()):
        colour = PALETTE[(1 - k) % len(PALETTE)]
        known = [b for b in bins if b.count]
        for b in known:
            cv2.line(
                image, at(b.mass, b.right.low), at(b.mass, b.right.high), colour, 2, cv2.LINE_AA
            )
            radius = round(4 + 1.5 * np.log10(b.count))
            cv2.circle(image, at(b.mass, b.right.value), radius, colour, cv2.FILLED, cv2.LINE_AA)
        x, y = _LEFT + 24, _TOP + 26 + 24 * k
        cv2.circle(image, (x, y - 5), 6, colour, cv2.FILLED, cv2.LINE_AA)
        text(image, f"{name}: {sum(b.count for b in bins)} hypotheses", x + 14, y, size=14)
    text(image, "share that is right", _LEFT, _TOP - 14, size=14)
    label = "mass of the hypothesis"
    text(image, label, width - 30 - text_width(label, 14), height - 14, size=14)
    return image
