"""The table of conditions as Markdown."""

from collections.abc import Sequence

from imgloc.evaluate import Share
from imgloc.experiments.robustness import Row


def robustness_table(rows: Sequence[Row]) -> str:
    """The rows as Markdown."""
    head = "condition | success@1 | oracle | behind | among equals, both | ties | unique | wrong"
    lines = [f"| {head} |", "|---" * 8 + "|"]
    for row in rows:
        lines.append(
            f"| {row.condition} | {_interval(row.localize_first)} | "
            f"{_interval(row.oracle_first)} | {row.behind:.0f} | "
            f"{_percent(row.localize)}, {_percent(row.oracle)} | "
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
