"""The table of conditions as Markdown."""

from collections.abc import Sequence

from imgloc.experiments.robustness import Row
from imgloc.experiments.shares import Share


def robustness_table(rows: Sequence[Row]) -> str:
    """The rows as Markdown."""
    head = "condition | localize | oracle | points behind | first, both | ties | unique | wrong"
    lines = [f"| {head} |", "|---" * 8 + "|"]
    for row in rows:
        lines.append(
            f"| {row.condition} | {_interval(row.localize)} | {_interval(row.oracle)} | "
            f"{row.behind:.0f} | {_percent(row.localize_first)}, {_percent(row.oracle_first)} | "
            f"{_percent(row.ties)} | {_percent(row.unique)} | "
            f"{row.wrong.hits} of {row.wrong.trials} |"
        )
    return "\n".join(lines)


def _percent(share: Share) -> str:
    """A share as text."""
    return f"{100 * share.value:.0f} %"


def _interval(share: Share) -> str:
    """A share with its interval."""
    return f"{_percent(share)} [{100 * share.low:.0f}, {100 * share.high:.0f}]"
