"""Checks of a request before any work is done, and its parameters as plain values."""

from dataclasses import asdict, fields, replace

from imgloc.errors import ConfigError, expect
from imgloc.features.budget import check_budget, fused_bytes, stack_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import uniform_thetas
from imgloc.options import DEFAULTS, FUSED, Options, Prior


def check_options(features: MapFeatures, options: Options) -> None:
    """Refuse options that :func:`imgloc.localize` cannot follow on a map, before any work.

    Raises
    ------
    ConfigError
        If two options contradict each other, no cell of the prior can hold a sensor, or the search
        needs more bytes than the memory budget.
    TypeError
        If `features` or `options` is of another type.
    """
    expect(features, MapFeatures, "features")
    expect(options, Options, "options")
    if options.time_budget is not None and options.method != FUSED:
        raise ConfigError(f"a time budget is for the method {FUSED}, not for {options.method}")
    prior, weights = options.prior.cells, options.prior.weights
    for one in (prior, weights):
        if one is not None and one.shape != features.standable.shape:
            raise ConfigError(
                f"the prior has cells of shape {one.shape}, expected that of the map, "
                f"{features.standable.shape}"
            )
    if prior is not None and not (prior & features.standable).any():
        raise ConfigError("the prior leaves no cell of the map in which a sensor can be")
    if options.method == FUSED:
        (height, width), cell = features.lattice.shape, features.lattice.resolution
        what = f"{options.method} on {height} x {width} cells of {cell:g} m"
        need = answer_bytes(features, options)
        check_budget(need, options.memory_budget, what, "use larger cells")


def answer_bytes(features: MapFeatures, options: Options) -> int:
    """Bytes that :func:`imgloc.localize` needs at most, besides the map's features."""
    shape = features.lattice.shape
    if options.method == FUSED:
        return fused_bytes(shape, n_thetas=len(uniform_thetas(options.fused.theta_step)))
    return stack_bytes(
        options.method, shape, len(options.thetas), threads=options.threads, n_rays=features.n_rays
    )


def effective(options: Options, features: MapFeatures) -> dict[str, object]:
    """The parameters that decided an answer, as plain values.

    The number of threads is left out, because no answer depends on it.
    """
    out = asdict(replace(options, prior=Prior(), theta_step=options.step))
    out["prior"] = dict(options.prior.about)
    hidden = {"threads", "memory_budget"}
    if options.time_budget is None:
        hidden.add("time_budget")
    if options.method != FUSED:
        out["calibration"] = asdict(options.calibration or DEFAULTS[options.method])
        hidden.add("shared")  # no stack uses it
    else:
        hidden |= {"engine", "calibration", "theta_step"}
    unsaid = ("grid", "memory_budget", "threads")
    about_map = {
        f.name: getattr(features, f.name) for f in fields(features) if f.name not in unsaid
    }
    out = {key: value for key, value in out.items() if key not in hidden}
    return out | {"map": about_map, "seed": None}
