"""`imgloc export`: the results of a batch as one table, for other programs."""

from enum import StrEnum
from pathlib import Path

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import say
from imgloc.cli.options import option
from imgloc.cli.report import Results
from imgloc.io.files import display, write_bytes_atomic

FormatName = StrEnum("FormatName", ("CSV", "PARQUET"))


@opt.with_options(opt.console)
def export(
    folder: Results,
    out: Path | None = option(None, "FILE", "Table to write. [default: DIR/results.csv, .parquet]"),
    form: FormatName = typer.Option(FormatName.CSV, "--format", help="Of the table."),
    force: opt.Force = False,
) -> None:
    """Write the results of a batch as one table, a row for each scan.

    To read it, by pandas: pandas.read_parquet("results.parquet"), by Polars:
    polars.read_parquet("results.parquet"), by DuckDB: SELECT * FROM 'results.parquet'; and
    read_csv for a CSV. Parquet needs pyarrow: pip install 'imgloc[parquet]'.
    """
    from imgloc.cli import inputs
    from imgloc.output.export import as_bytes

    target = folder / f"results.{form.value}" if out is None else out
    inputs.check_target(target, f".{form.value}", force=force)
    data = as_bytes(folder, form.value)
    write_bytes_atomic(target, data, force=force)
    say(f"wrote {display(target)}: {len(data) / 1000:,.0f} kB")
