"""`imgloc convert`: scans of any log in the form of another file."""

from pathlib import Path

from imgloc.cli import options as opt
from imgloc.cli.console import say
from imgloc.io.files import display
from imgloc.options import Chosen, Logs, Mounting
from imgloc.ranges import option


def convert(
    *,
    scans_path: opt.ScansPath,
    out: Path = option(..., "File that is written: .csv, .jsonl, .npz or .mcap.", "OUT"),
    logs: Logs,
    chosen: Chosen,
    mounting: Mounting,
    memory_budget: opt.MemoryBudget | None = None,
    force: opt.Force = False,
) -> None:
    """Write the scans of any log as CSV, JSON lines, NPZ or MCAP.

    Ranges become metres, and readings are those of an upright sensor. Stamps, odometry, known poses
    and the place of the sensor go along where the form has room for them: CSV has none for the
    place and the name of the sensor, MCAP none for known poses. MCAP is a recording of ROS 2 with
    /scan, or a topic for each of several lasers, /odom and /tf_static, and needs rosbags:
    pip install 'imgloc[ros]'.

    Examples
    --------
    imgloc convert run.bag scans.npz
    imgloc convert run.log scans.csv --range-scale 0.001
    imgloc convert scans.csv run.mcap --scans-index ::10
    """
    from imgloc.cli import inputs
    from imgloc.output import converted

    inputs.check_target(out, tuple(converted.FORMS), force=force, inputs=[scans_path])
    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget))
    scans = desk.scans(scans_path, inputs.as_recorded(logs, chosen, mounting)).scans
    converted.convert(scans, out, force=force)
    say(f"wrote {display(out)}: {len(scans):,} scans")
