"""`imgloc export`: the results of a batch as one table, for other programs."""

from pathlib import Path

from imgloc.cli import options as opt
from imgloc.cli.console import say
from imgloc.cli.report import Results
from imgloc.io.files import display, write_bytes_atomic
from imgloc.ranges import option


def export(
    *,
    folder: Results,
    out: Path | None = option(
        None,
        "Table that is written, .csv or .parquet. [default: results.csv in DIR]",
        metavar="FILE",
    ),
    force: opt.Force = False,
) -> None:
    """Write the results of a batch as one table, a row for each scan.

    To read it, by pandas: pandas.read_parquet("results.parquet"), by Polars:
    polars.read_parquet("results.parquet"), by DuckDB: SELECT * FROM 'results.parquet'; and
    read_csv for a CSV. Parquet needs pyarrow: pip install 'imgloc[parquet]'.

    Examples
    --------
    imgloc export found
    imgloc export found --out answers.parquet
    """
    from imgloc.cli import inputs
    from imgloc.output.export import as_bytes
    from imgloc.runs.results import read_run

    read_run(folder)  # first: a folder that is no batch is told as such, not as a place to write to
    target = folder / "results.csv" if out is None else out
    inputs.check_target(target, (".csv", ".parquet"), force=force)
    data = as_bytes(folder, target.suffix.lower())
    write_bytes_atomic(target, data, force=force)
    say(f"wrote {display(target)}: {len(data) / 1000:,.0f} kB")
