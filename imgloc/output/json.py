"""Rows of results as JSON: one object a line, and nothing in it that is not JSON."""

import json
from collections.abc import Mapping

from imgloc.model import plain


def to_json(row: Mapping[str, object]) -> str:
    """Return one line of JSON; what is not finite becomes null."""
    return json.dumps(plain(row), allow_nan=False)
