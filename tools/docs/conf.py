"""Sphinx: the README and the guides, the API from its docstrings, the gallery with its pictures.

python -m sphinx -W tools/docs pages
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any

from numpydoc.xref import DEFAULT_LINKS

import imgloc

sys.path.insert(0, str(Path(__file__).parents[2]))  # tools, which is not installed


project, author = "imgloc", "the authors of imgloc"
version = release = imgloc.__version__
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
]
templates_path = ["templates"]
html_theme = "alabaster"
html_theme_options = {"description": "Where am I on this map?", "page_width": "1150px"}
html_show_sourcelink = html_show_copyright = False
autodoc_typehints = "none"  # numpydoc's sections say them
numpydoc_show_class_members = False
numpydoc_xref_param_type, numpydoc_xref_ignore = True, "all"
# Types of imgloc are links; those of Python are not, as the build needs no network.
numpydoc_xref_aliases = {name: name for name in DEFAULT_LINKS}
numpydoc_xref_aliases |= {name: f"imgloc.{name}" for name in imgloc.__all__}
myst_heading_anchors = 2
suppress_warnings = ["config.cache"]  # the function below is not a plain value


def pictures(_block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Call `picture()` of a script of the gallery, and show what it returns."""
    from sphinx_gallery.scrapers import figure_rst

    make = block_vars["example_globals"].get("picture")
    if make is None:
        return ""
    path = next(block_vars["image_path_iterator"])
    make().save(path, force=True)
    return str(figure_rst([path], gallery_conf["src_dir"]))


def fields(_app: Any, what: str, _name: str, obj: Any, _options: Any, lines: list[str]) -> None:
    """Add the fields of a dataclass of options, with the texts that the command line shows, too."""
    from imgloc.ranges import declared, help_of

    if what != "class" or not dataclasses.is_dataclass(obj) or "Parameters" in lines:
        return
    kind: Any = obj
    turned = " Radians in Python."  # what commands take in degrees
    texts = {
        part.name: help_of(part) + (turned if part.in_degrees else "")
        for part in declared(kind)
        if part.text
    }
    if texts:
        entries = [line for name, text in texts.items() for line in (name, f"    {text}")]
        at = next((k for k, line in enumerate(lines) if line == "Examples"), len(lines))
        lines[at:at] = ["", "Parameters", "----------", *entries, ""]


def setup(app: Any) -> None:
    """Connect what Sphinx calls."""
    app.connect("autodoc-process-docstring", fields, priority=400)  # before numpydoc


sphinx_gallery_conf = {
    "examples_dirs": "../gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/(?!__)\w+\.py$",
    "ignore_pattern": r"__\w+__\.py$",
    "image_scrapers": (pictures,),
    "reset_modules": (),
    "write_computation_times": False,
    "download_all_examples": False,
    "show_signature": False,
    "abort_on_example_error": True,
}
