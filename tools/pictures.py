"""README's pictures, made anew from the code as it is.

python -m tools.pictures            # writes tools/demo.png, fig2.png and track.png
python -m tools.pictures --check    # says which of them no longer show what the code draws
"""

import contextlib
import io
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import matplotlib
import numpy as np
import PIL.Image
from PIL.PngImagePlugin import PngInfo

from imgloc.cli.app import main as imgloc
from imgloc.io.files import write_bytes_atomic
from imgloc.output.canvas import Image
from tools.drive import draw_drive, drive
from tools.paper.figures import figure
from tools.script import parser_of

FOLDER = Path(__file__).parent
STALE, OTHER_LETTERS = 0.0002, 0.01
"""Share of the pixels that may differ: by rounding on another processor; by other letters."""
LETTERS = "matplotlib " + ".".join(matplotlib.__version__.split(".")[:2])
_SHIFT, _LEVELS = 2, 48  # pixels and grey levels that a line may be off


def demo() -> Image:
    """What `imgloc demo` draws."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "demo.png")
        with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
            imgloc(["demo", "--out", str(path)])
        return load(path)[0]


def load(path: Path) -> tuple[Image, str]:
    """The pixels of a picture (H, W, 3), BGR, and the matplotlib that drew it."""
    with PIL.Image.open(path) as file:
        made_by = str(file.info.get("Software", ""))
        return np.asarray(file.convert("RGB"), np.uint8)[..., ::-1], made_by


def save(path: Path, image: Image) -> None:
    """Write a picture, and in it the matplotlib that drew it."""
    out, about = io.BytesIO(), PngInfo()
    about.add_text("Software", LETTERS)
    PIL.Image.fromarray(np.ascontiguousarray(image[..., ::-1])).save(
        out, "png", optimize=True, pnginfo=about
    )
    write_bytes_atomic(path, out.getvalue(), force=True)


PICTURES: Mapping[str, Callable[[], Image]] = {
    "demo": demo,
    "fig2": lambda: figure("fig2"),
    "track": lambda: draw_drive(drive()).image,
}


def difference(a: Image, b: Image) -> float:
    """Share of the pixels of either picture that the other has not, not even nearby: 0 to 1.

    A pixel counts that is darker or lighter than all of the other's within two pixels: what is
    drawn a little to the side does not, what is new, gone or of another colour does.

    Examples
    --------
    >>> blank = np.full((100, 100, 3), 255, np.uint8)
    >>> a, b, c = (cv2.circle(blank.copy(), (x, 50), 10, (0, 0, 200), -1) for x in (50, 51, 80))
    >>> difference(a, a), difference(a, b), difference(a, c) > 0.05, difference(a, blank[:50])
    (0.0, 0.0, True, 1.0)
    """
    if a.shape != b.shape:
        return 1.0
    near = np.ones((2 * _SHIFT + 1, 2 * _SHIFT + 1), np.uint8)
    outside = np.zeros(a.shape[:2], bool)
    for one, other in ((a, b), (b, a)):
        least, most = cv2.erode(other, near), cv2.dilate(other, near)
        outside |= (cv2.subtract(least, one) > _LEVELS).any(axis=2)
        outside |= (cv2.subtract(one, most) > _LEVELS).any(axis=2)
    return float(outside.mean())


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pictures, or check them; 1 if one is stale."""
    parser = parser_of("tools.pictures", __doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PICTURES))
    parser.add_argument("--check", action="store_true", help="write nothing, say what is stale")
    given = parser.parse_args(arguments)
    if wrong := set(given.names) - set(PICTURES):
        parser.error(f"no such picture: {', '.join(sorted(wrong))}")
    stale = 0
    for name in given.names or PICTURES:
        path, image = FOLDER / f"{name}.png", PICTURES[name]()
        if not given.check:
            save(path, image)
            continue
        there, made_by = load(path)
        share = difference(there, image)
        if share > (STALE if made_by == LETTERS else OTHER_LETTERS):
            stale = 1
            print(f"{path}: {100 * share:.2f} % differs; run: python -m tools.pictures {name}")
    return stale


if __name__ == "__main__":
    sys.exit(main())
