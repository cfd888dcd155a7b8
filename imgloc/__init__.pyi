"""The public names of imgloc, and where each is defined: they are loaded when first used."""

from .__about__ import __version__ as __version__
from .answers.explain import Explanation, explain
from .answers.sample import sample_poses
from .choice.choose import Choice, which
from .errors import ConfigError, ImglocError, MapError, OutputError, ScanError
from .features.mapfeatures import MapFeatures
from .filters.belief import Belief, Filter
from .filters.choose import make_filter
from .filters.follow import Moment, Tracking, follow
from .filters.scanodometry import ScanOdometry
from .io.mapcheck import MapReport, check_map
from .io.maps import load_map, save_map
from .io.messages import grid_from_msg, grid_to_msg, scan_from_msg, scan_to_msg
from .io.scans import load_scans, save_scans
from .io.scanset import ScanSet
from .lab.align import Alignment, ScanAlignment, align_maps, align_scans
from .lab.changes import Changes, map_changes, sure_poses
from .lab.evaluation import Evaluation, evaluate
from .likelihoods.stacks import Stack, likelihood
from .live.line import Dropped
from .live.localizer import Answer, Localizer
from .live.sites import Site
from .model import (
    Evidence,
    Floor,
    GridInfo,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
    OrientedPoints,
    Pose2D,
    Protection,
)
from .options import (
    ALL_METHODS,
    METHODS,
    Calibration,
    Every,
    FusedOptions,
    Known,
    Limits,
    Options,
    Prior,
    Sensor,
    Shared,
    Trust,
)
from .output.pictures import Picture, draw
from .pipeline import localize, localize_many, prepare
from .plans.files import load_plan
from .plans.floorplan import FloorPlan, plan_to_map
from .robot.frames import Frames
from .robot.odometry import Odometry
from .robot.recording import Recording
from .runs.batch import BatchSummary, run_batch
from .runs.jobs import Job, make_job
from .runs.priors import near, region
from .simulation.scans import simulate

__all__ = [
    "ALL_METHODS",
    "METHODS",
    "Alignment",
    "Answer",
    "BatchSummary",
    "Belief",
    "Calibration",
    "Changes",
    "Choice",
    "ConfigError",
    "Dropped",
    "Evaluation",
    "Every",
    "Evidence",
    "Explanation",
    "Filter",
    "Floor",
    "FloorPlan",
    "Frames",
    "FusedOptions",
    "GridInfo",
    "Hypothesis",
    "ImglocError",
    "Job",
    "Known",
    "LaserScan",
    "Likelihood",
    "Limits",
    "Localization",
    "Localizer",
    "MapError",
    "MapFeatures",
    "MapReport",
    "Moment",
    "OccupancyGrid",
    "Odometry",
    "Options",
    "OrientedPoints",
    "OutputError",
    "Picture",
    "Pose2D",
    "Prior",
    "Protection",
    "Recording",
    "ScanAlignment",
    "ScanError",
    "ScanOdometry",
    "ScanSet",
    "Sensor",
    "Shared",
    "Site",
    "Stack",
    "Tracking",
    "Trust",
    "__version__",
    "align_maps",
    "align_scans",
    "check_map",
    "draw",
    "evaluate",
    "explain",
    "follow",
    "grid_from_msg",
    "grid_to_msg",
    "likelihood",
    "load_map",
    "load_plan",
    "load_scans",
    "localize",
    "localize_many",
    "make_filter",
    "make_job",
    "map_changes",
    "near",
    "plan_to_map",
    "prepare",
    "region",
    "run_batch",
    "sample_poses",
    "save_map",
    "save_scans",
    "scan_from_msg",
    "scan_to_msg",
    "simulate",
    "sure_poses",
    "which",
]  # fmt: skip
