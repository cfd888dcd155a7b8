"""`imgloc report`: one page about a batch."""

import os
from pathlib import Path
from typing import Annotated

from imgloc.cli import options as opt
from imgloc.cli.console import say
from imgloc.errors import OutputError
from imgloc.io.files import display, open_regular, refuse_existing, write_text_atomic
from imgloc.ranges import Option, option

Results = Annotated[Path, Option("Folder of the results of imgloc batch.", "DIR")]


def report(
    *,
    folder: Results,
    out: Path | None = option(
        None, "Page that is written. [default: report.html in DIR]", metavar="HTML"
    ),
    force: opt.Force = False,
) -> None:
    """Write one page about a batch: verdicts, errors, times, maps, failures, pictures.

    The page needs no network. Of many pictures it has links to those in DIR, so leave it there.
    DIR/report.html is written anew each time.

    Examples
    --------
    imgloc report found
    imgloc report found --out site.html
    """
    from imgloc.cli import inputs
    from imgloc.output.report import MARK, render_report

    target = folder / "report.html" if out is None else out
    inputs.check_target(out, ".html", force=force)
    if out is None and not force and os.path.lexists(target) and MARK not in _beginning(target):
        refuse_existing(target)  # somebody else's
    html = render_report(folder, beside=target.parent)
    write_text_atomic(target, html, force=out is None or force)
    size = len(html.encode())
    said = f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"
    say(f"wrote {display(target)}: {said}")


def _beginning(path: Path) -> bytes:
    """The first bytes of a file; none if it is not one."""
    try:
        with os.fdopen(open_regular(path, OutputError, "page", follow=False), "rb") as file:
            return file.read(1000)
    except (OutputError, OSError):
        return b""
