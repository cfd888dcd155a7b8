"""Text as HTML."""

import html


def escape(text: object) -> str:
    """Text as HTML."""
    return html.escape(str(text), quote=True)
