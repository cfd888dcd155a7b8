"""How often is the right map named? `imgloc which`, asked with scans whose map is known."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from imgloc import Choice, ConfigError, LaserScan, Localization, Sensor, load_map, prepare, simulate
from imgloc.choice.choose import OPTIONS, choose, fit, next_maps
from imgloc.choice.folder_index import open_index
from imgloc.lab.evaluation import share
from tools.recorded import scans_beside
from tools.script import at_least_one

Asked = tuple[str, LaserScan]
"""The name of a map, and a scan taken in it."""


def scans_of(
    maps: Mapping[str, Path], n: int, seed: int, range_max: float = 20.0
) -> tuple[Asked, ...]:
    """Scans taken in the maps, at least `n` in all, unless fewer have been recorded.

    Those recorded beside a map (scans.npz, with poses), if there are any; else simulated ones.
    ConfigError if `n` is less than 1, or there is no map.
    """
    at_least_one(n=n)
    if not maps:
        raise ConfigError("there is no map to take scans in")
    each = -(-n // len(maps))
    asked: list[Asked] = []
    for name, path in maps.items():
        if path.with_name("scans.npz").exists():
            found = scans_beside(path, each, seed, range_max)
        else:
            found = simulate(load_map(path), each, seed, Sensor(range_max=range_max))
        asked += [(name, scan) for scan in found.scans]
    return tuple(asked)


def ask_all(
    maps: Mapping[str, Path],
    asked: Sequence[Asked],
    *,
    threads: int,
    advance: Callable[[], object] = lambda: None,
) -> tuple[dict[str, Localization], ...]:
    """How well each scan fits each map, by its name."""
    fits: tuple[dict[str, Localization], ...] = tuple({} for _ in asked)
    for name, path in maps.items():
        features = prepare(load_map(path), threads=threads)
        for (_, scan), found in zip(asked, fits, strict=True):
            found[name] = fit(features, scan, replace(OPTIONS, threads=threads))
            advance()
    return fits


def bound_all(
    maps: Mapping[str, Path], asked: Sequence[Asked], *, threads: int
) -> tuple[dict[str, float], ...]:
    """How well each scan can fit each map, by its name."""
    index, errors = open_index(maps, lambda path: prepare(load_map(path)), about="")
    if errors:
        raise next(iter(errors.values()))
    options = replace(OPTIONS, threads=threads)
    found = [index.bounds(scan, options).tolist() for _, scan in asked]
    return tuple(dict(zip(index.names, of, strict=True)) for of in found)


def followed(fits: Mapping[str, Localization], bounds: Mapping[str, float], sure: float) -> Choice:
    """What `which` answers of the maps of `fits`, some of which it does not search to the end."""
    some: dict[str, Localization] = {}
    left = {name: bounds[name] for name in fits}
    while names := next_maps(left, some):
        some |= {name: fits[name] for name in names}
    return choose(some, sure=sure, ruled_out=len(fits) - len(some))


def naming_shares(
    asked: Sequence[Asked],
    fits: Sequence[Mapping[str, Localization]],
    bounds: Sequence[Mapping[str, float]],
    *,
    sure: float,
    buildings: Mapping[str, str],
) -> dict[str, Any]:
    """Shares of the scans whose map is named, whose is not but another, and of silence.

    Parameters
    ----------
    asked, fits, bounds
        Of :func:`scans_of`, :func:`ask_all` and :func:`bound_all`.
    sure : float
        Probability that a map needs to be named.
    buildings : mapping of str to str
        Names of maps that count as one: those of equal value.
    """
    right, wrong, silent, same = [], [], [], []
    for (name, _), found, of in zip(asked, fits, bounds, strict=True):
        home = {m for m in found if buildings.get(m, m) == buildings.get(name, name)}
        verdict = followed(found, of, sure).verdict
        away = {m: f for m, f in found.items() if m not in home}
        right.append(verdict in home)
        wrong.append(verdict in away)
        silent.append(not away or followed(away, of, sure).verdict not in away)
        for some in (found, away):
            if some:
                full = choose(some, sure=sure).verdict
                same.append(followed(some, of, sure).verdict == full)
    return {
        "right": vars(share(right)),
        "wrong": vars(share(wrong)),
        "silent without its map": vars(share(silent)),
        "as of a search of all maps to the end": vars(share(same)),
        "not right": [k for k, yes in enumerate(right) if not yes],
    }
