"""Pictures side by side, with captions."""

from collections.abc import Sequence

import numpy as np

from imgloc.draw.canvas import Picture, text, text_width


def mosaic(
    pictures: Sequence[tuple[str, Picture]], columns: int | None = None, gap: int = 16
) -> Picture:
    """Lay pictures out on a white sheet, each with its caption below.

    Parameters
    ----------
    pictures : sequence of (str, (H, W, 3) uint8 array)
        Captions and pictures, of any sizes.
    columns : int, optional
        Pictures in a row; by default as many as make the sheet about as wide as 4 : 3.
    gap : int
        Pixels between pictures and around them.

    Returns
    -------
    (H, W, 3) uint8 array

    Raises
    ------
    ValueError
        If there are no pictures.

    Examples
    --------
    >>> mosaic([("(a)", np.zeros((20, 30, 3), np.uint8))] * 2, columns=2).shape
    (78, 108, 3)
    """
    if not pictures:
        raise ValueError("a mosaic needs at least one picture")
    caption = 26
    n = len(pictures)
    cells = [(max(p.shape[1], text_width(c)), p.shape[0] + caption) for c, p in pictures]
    if columns is None:
        area = float(np.mean([w / h for w, h in cells]))
        columns = max(1, min(n, round((n * 4 / 3 / area) ** 0.5)))
    rows = -(-n // columns)
    wide = [max(w for w, _ in cells[k::columns]) for k in range(min(columns, n))]
    high = [max(h for _, h in cells[k * columns : (k + 1) * columns]) for k in range(rows)]
    sheet = np.full((sum(high) + gap * (rows + 1), sum(wide) + gap * (len(wide) + 1), 3), 255)
    out = sheet.astype(np.uint8)
    for k, (label, picture) in enumerate(pictures):
        row, column = divmod(k, columns)
        y = sum(high[:row]) + gap * (row + 1)
        x = sum(wide[:column]) + gap * (column + 1)
        h, w = picture.shape[:2]
        top = y + high[row] - caption - h
        left = x + (wide[column] - w) // 2
        out[top : top + h, left : left + w] = picture
        centre = x + (wide[column] - text_width(label)) // 2
        text(out, label, centre, y + high[row] - 8)
    return out
