"""Options: each value is in its range, or refused by name."""

import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from imgloc import Pose2D
from imgloc import options as module
from imgloc.errors import ConfigError
from imgloc.filters.motion import MotionNoise
from imgloc.filters.tracker import TrackerOptions
from imgloc.lab.grid import GridOptions
from imgloc.lab.particle import ParticleOptions
from imgloc.likelihoods.correlate import ENGINES
from imgloc.options import (
    Bending,
    Calibration,
    Chosen,
    Drawn,
    Every,
    EvidenceModel,
    Followed,
    FusedOptions,
    Hint,
    Known,
    Limits,
    Logs,
    Method,
    Mounting,
    Options,
    PlanWalls,
    Prior,
    Sensor,
    Shared,
    Tolerance,
    Trust,
)
from imgloc.ranges import Checked
from imgloc.runs.jobs import make_job
from imgloc.runs.opening import ScanFiles

SHOWN = (Chosen, Drawn, Every, Followed, Known, Limits, Logs, Mounting, PlanWalls, Sensor)
KINDS = (Bending, Calibration, EvidenceModel, FusedOptions, Hint, Options, Prior, Shared, Trust)
OTHERS = (GridOptions, MotionNoise, ParticleOptions, TrackerOptions, ScanFiles)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda: Options(theta_step=-1),
            "Options.theta_step: got -1, expected radians, 0.000872665 to",
        ),
        (lambda: Options(engine="foo"), "Options.engine: got 'foo', expected one of auto, filter2"),
        (lambda: Options(time_budget=math.nan), "Options.time_budget: got nan, expected seconds"),
        (lambda: Options("cmbl"), "Options.method: got 'cmbl', expected one of fused, cbml"),
        (lambda: Options(top=0), "Options.top: got 0, expected a whole number, 1 or more"),
        (lambda: Options(top=2.5), "Options.top: got 2.5, expected a whole number"),  # type: ignore[arg-type]
        (lambda: Options(threads=-1), "Options.threads: got -1"),
        (lambda: Options(trust=None), "Options.trust: got None, expected Trust"),  # type: ignore[arg-type]
        (lambda: Shared(scale=0), "Shared.scale: got 0, expected a factor, 0.5 to 2"),
        (lambda: Shared(thinner=-1), "Shared.thinner: got -1, expected a whole number, cells"),
        (lambda: FusedOptions(keep=(10,)), "FusedOptions.keep: got (10,), expected 4 values"),  # type: ignore[arg-type]
        (lambda: FusedOptions(keep=(9, 9, 0, 9)), "FusedOptions.keep[2]: got (9, 9, 0, 9)"),
        (lambda: FusedOptions(few_rays=0), "FusedOptions.few_rays: got 0"),
        (lambda: FusedOptions(unfit=True), "FusedOptions.unfit: got True, expected nats, 0 or"),
        (lambda: Trust(mass=7), "Trust.mass: got 7, expected a share, 0 to 1"),
        (lambda: Trust(elsewhere=(0, 1)), "Trust.elsewhere: got (0, 1), expected 3 values"),  # type: ignore[arg-type]
        (lambda: EvidenceModel(sigmas=()), "EvidenceModel.sigmas: got (), expected at least one"),
        (lambda: EvidenceModel(sigmas=(0.1, 0.0)), "EvidenceModel.sigmas[1]"),
        (lambda: EvidenceModel(hit="most"), "EvidenceModel.hit: got 'most', expected a share"),  # type: ignore[arg-type]
        (lambda: Prior(heading=(0.0, -1.0)), "Prior.heading[1]: got (0.0, -1.0), expected radian"),
        (lambda: Hint(0, 0, 0, weight=2.0), "Hint.weight: got 2.0, expected a weight, 0.001 to 1"),
        (lambda: Known(sd=(0.5, 0.2)), "`sd`: expected with `near`"),
        (lambda: Known((0, 0, 0, 9.0, 0.8), sd=(0.5, 0.2)), "`sd`: expected with `near`, of x"),
        (lambda: Prior(heading=(0.0, 1.0)) | Prior(), "`|` joins hints: expected poses with `sd`"),
        (lambda: Prior(weights=np.array([[2.0]])), "Prior.weights: expected 0 to 1"),
        (lambda: TrackerOptions(agree=(2, 0)), "TrackerOptions.agree[1]: got (2, 0)"),
        (
            lambda: GridOptions(method="fused"),
            "GridOptions.method: got 'fused', expected one of cb",
        ),
        (lambda: Every(-1), "Every.metres: got -1"),
        (lambda: Sensor(outliers=2), "Sensor.outliers: got 2, expected a share"),
        (lambda: make_job("sweep"), "job: got 'sweep', expected one of localize"),
        (lambda: ScanFiles(scale=0), "ScanFiles.scale: got 0"),
    ],
)
def test_nonsense_is_refused_by_name(make: Callable[[], object], says: str) -> None:
    with pytest.raises(ConfigError) as error:
        make()
    assert str(error.value).startswith(says)


def test_numbers_of_numpy_are_numbers() -> None:
    assert Options(top=np.int64(3), theta_step=np.float32(0.1)).top == 3  # type: ignore[arg-type]
    assert EvidenceModel(sigmas=np.array([0.1, 0.2])).best > 0  # type: ignore[arg-type]
    assert Trust(elsewhere=[0.0, 1.0, 2.0]).most == 30  # type: ignore[arg-type]


def test_an_engine_that_is_known_is_an_option() -> None:
    assert [Options(engine=name).engine for name in ENGINES] == list(ENGINES)


@pytest.mark.parametrize("kind", [*KINDS, *SHOWN, *OTHERS], ids=lambda kind: kind.__name__)
def test_no_number_of_options_may_be_nan(kind: type) -> None:
    made, asked = kind(), 0
    for part in fields(kind):
        value = getattr(made, part.name)
        if isinstance(value, float | int) and not isinstance(value, bool):
            asked += 1
            with pytest.raises(ConfigError, match=rf"{kind.__name__}\.{part.name}: got nan"):
                kind(**{part.name: math.nan})
    assert asked or kind in (Prior, Drawn, Known, Mounting, PlanWalls)


def test_all_options_are_checked() -> None:
    kinds = [v for v in vars(module).values() if isinstance(v, type) and is_dataclass(v)]
    named = {kind for kind in kinds if kind.__module__ == module.__name__}
    assert named == {*KINDS, *SHOWN, Method, Tolerance}
    assert all(issubclass(kind, Checked) for kind in (*KINDS, *SHOWN, *OTHERS, Tolerance))


def test_a_name_that_options_has_is_the_real_one() -> None:
    assert module.Pose2D is Pose2D
    assert not {"LaserScan", "BoolArray", "FloatArray", "Temperature"} & vars(module).keys()
    with pytest.raises(ConfigError, match=r"Sensor.mount: got '1,2,3', expected Pose2D"):
        Sensor(mount="1,2,3")
