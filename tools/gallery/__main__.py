"""Run the scripts of the gallery and make one page of them: `python -m tools.gallery --out DIR`."""

import argparse
import inspect
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from jinja2 import Environment

from imgloc.io.files import write_text_atomic

NAMES = (
    "from_a_png", "folder", "prior", "stack", "atlas", "which_map", "own_score", "own_map",
)  # fmt: skip
_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>imgloc: gallery</title>
<style>body{font:16px/1.5 Georgia,serif;max-width:60rem;margin:2rem auto;padding:0 1rem}
img{max-width:100%;border:1px solid #d9dee4}pre{overflow-x:auto;background:#eef1f4;padding:1rem;
font-size:.85rem}</style>
<h1>imgloc: gallery</h1>
{% for name, about, code in entries %}<h2>{{ name|replace("_", " ") }}</h2><p>{{ about }}</p>
<img src="{{ name }}.png" alt="{{ about }}"><details><summary>{{ name }}.py</summary>
<pre>{{ code }}</pre></details>
{% endfor %}</html>
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Write a picture of each script, and ``index.html``, into a folder."""
    parser = argparse.ArgumentParser(prog="python -m tools.gallery", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("gallery"))
    parser.add_argument("--force", action="store_true", help="overwrite what is there")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    entries = []
    for name in NAMES:
        module = import_module(f"tools.gallery.{name}")
        module.picture().save(given.out / f"{name}.png", force=given.force)
        entries.append((name, inspect.getdoc(module), inspect.getsource(module)))
    html = Environment(autoescape=True).from_string(_PAGE).render(entries=entries)
    write_text_atomic(given.out / "index.html", html, force=given.force)


if __name__ == "__main__":
    main()
