"""Figures that several pages have: written into them from the measured page that they are of.

python -m tools.figures            # writes the pages
python -m tools.figures --check    # says which of them have other figures
"""

import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from imgloc.io.files import write_text_atomic
from tools.script import parser_of

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "tools/docs"
TRUST, HITS = DOCS / "measured/trust-fit-2026-11-26.md", DOCS / "measured/hits-2026-11-22.md"
PAGES = (ROOT / "README.md", DOCS / "trust.md", DOCS / "compared.md")
_LAST = "place known to 3 m and 90 deg"  # condition with scans of the map's own building
_BLOCK = re.compile(r"<!-- figures: (\w+) -->\n(.*?)<!-- end -->", re.DOTALL)


def rows(page: Path, head: str) -> dict[str, list[str]]:
    """The rows of the table of a page below `head`: other cells by the first."""
    lines = iter(page.read_text().partition(f"\n| {head} |")[2].splitlines()[2:])
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    end = next((k for k, cells in enumerate(table) if len(cells) < 2), len(table))
    return {cells[0]: cells[1:] for cells in table[:end]}


def figures() -> Mapping[str, str]:
    r"""The blocks by name, as lines.

    Examples
    --------
    >>> "16 were wrongly called `unique`" in figures()["wrong"].replace("\n", " ")
    True
    """
    found = rows(TRUST, "condition")
    own = dict(list(found.items())[: list(found).index(_LAST) + 1])
    scans, wrong = (sum(int(row[column]) for row in own.values()) for column in (0, 3))
    whole, half = own["undisturbed"], own["half the map"]
    said = (
        f"Of {scans:,} scans of a map's own building in {len(own)} conditions (people, glass, "
        f"ranges 5 % off ...) {wrong} were\nwrongly called `unique`: {half[3]} of {half[0]} on a "
        f"map that lacks one half, {int(whole[3]) or 'none'} of {whole[0]} without a disturbance.\n"
    )
    hits, others = rows(HITS, "set"), rows(HITS, "set (60 scans; problems 50)")
    about = "| set | Cartographer | imgloc | in the first 5 | median error | times a search in C: "
    lines = [f"{about}Cartographer | imgloc |", "|---|---|---|---|---|---|---|"]
    for name, (_, first, five, error) in hits.items():
        row = others.get(re.split(r", 10 m| \(", name)[0])
        if row is None:
            continue
        theirs = row[0].split(",")[0]
        cells = (name, theirs, first, five, f"{error} m", row[1], row[3])
        lines.append("| " + " | ".join(cells) + " |")
    return {"wrong": said, "hits": "\n".join(lines) + "\n"}


def written(page: Path, blocks: Mapping[str, str]) -> str:
    """The text of a page with its blocks as they should be."""
    return _BLOCK.sub(
        lambda found: f"<!-- figures: {found[1]} -->\n{blocks[found[1]]}<!-- end -->",
        page.read_text(),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pages, or check them; 1 if one has other figures."""
    parser = parser_of("tools.figures", __doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, say what is stale")
    given, blocks, stale = parser.parse_args(arguments), figures(), 0
    for page in PAGES:
        text = written(page, blocks)
        if text == page.read_text():
            continue
        if given.check:
            stale = 1
            print(f"{page}: its figures are not those of the measured pages")
        else:
            write_text_atomic(page, text, force=True)
    return stale


if __name__ == "__main__":
    sys.exit(main())
