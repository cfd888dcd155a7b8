"""One self-contained HTML page that reads like the paper's Sec. VI, with today's numbers.

The page needs no other file and no network: style and pictures are inside, scripts there are
none. It is made of the same plain values that ``results.json`` holds.
"""

import base64
from collections.abc import Mapping
from typing import Any

from imgloc.report.style import STYLE
from imgloc.report.tables import (
    chart,
    claim_list,
    cost_table,
    escape,
    exponent_table,
    index_table,
    maximum_table,
    ratio_table,
    time_table,
)
from imgloc.report.text import (
    APPENDIX,
    BEYOND,
    CAPTIONS,
    MAXIMUM,
    ORACLE,
    PICTURES,
    RATIOS,
    RUN_TIME,
    SETTING,
)


def render_report(results: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Write the page.

    Parameters
    ----------
    results : mapping
        As in ``results.json``, see :func:`imgloc.experiments.reproduce.as_dict`.
    pictures : mapping of str to bytes
        PNG files by name: those of :data:`CAPTIONS`, and ``complexity`` if there is one.

    Returns
    -------
    str
        HTML.
    """
    rows, trials = results["table"], results["n"]
    parts = [
        "<h1>Likelihood approximation in Bayesian localization: the experiment, run again</h1>",
        f"<p class=meta>imgloc {escape(results['version'])} · {trials} trials in each world · seed "
        f"{results['seed']} · after A. Censi, <i>A comparison of algorithms for likelihood "
        "approximation in Bayesian localization</i>, Sec. VI</p>",
        "<h2>Experimental results</h2>",
        f"<p>{SETTING.format(n=trials)}</p>",
        index_table(rows),
        chart(rows),
        f"<p>{ORACLE}</p>",
        f"<p>{BEYOND}</p>",
        "<h2>What the paper says, and whether it holds</h2>",
        claim_list(results["claims"]),
        "<h2>Where is the global maximum?</h2>",
        f"<p>{MAXIMUM}</p>",
        maximum_table(rows),
        "<h2>Run time</h2>",
        f"<p>{RUN_TIME}</p>",
        time_table(rows),
        f"<p>{RATIOS}</p>",
        ratio_table(results["cost"]["ratios"]),
        claim_list(results["cost"]["claims"]),
        "<h2>Figures</h2>",
        f"<p>{PICTURES}</p>",
        *(_figure(f"Fig. {name[3:]}", name, pictures[name], caption)
          for name, caption in CAPTIONS.items() if name in pictures),
    ]  # fmt: skip
    grown, timed = results["complexity"], results["cost"]["complexity"]
    parts += [
        "<h2>Appendix: complexity, measured</h2>",
        f"<p>{APPENDIX.format(world=escape(grown['world']))}</p>",
        cost_table(grown["samples"], timed["samples"]),
        exponent_table([*grown["fits"], *timed["fits"]]),
    ]
    if "complexity" in pictures:
        caption = "All samples; the legends give the exponents fitted, the paper's in brackets."
        parts.append(_figure("Growth", "complexity", pictures["complexity"], caption))
    title = f"imgloc: the paper's experiment, {trials} trials"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body><main>\n"
        + "\n".join(parts)
        + "\n</main></body></html>\n"
    )


def _figure(label: str, name: str, png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    return (
        f'<figure><div class=wide><img alt="{escape(label)}" id="{escape(name)}" '
        f'src="data:image/png;base64,{data}"></div>'
        f"<figcaption><b>{escape(label)}.</b> {escape(caption)}</figcaption></figure>"
    )
