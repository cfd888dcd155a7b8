"""`imgloc serve`, `imgloc open`: answers over HTTP, and a page to look at them."""

import logging
import os
import re
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Only, Typed
from imgloc.cli.console import INTERRUPTED, LOG, emit, say
from imgloc.errors import ConfigError
from imgloc.io.files import display, is_folder
from imgloc.io.mapyaml import YAML_ENDINGS
from imgloc.live.bounds import Bounds
from imgloc.model import Pose2D
from imgloc.options import Chosen, Logs, Mounting, Options
from imgloc.ranges import Option, Within, declared, option

if TYPE_CHECKING:
    from imgloc.io.scanset import ScanSet
    from imgloc.live.localizer import Localizer
    from imgloc.live.service import Begun

PORT = 8080
_NEEDED = ("starlette", "uvicorn", "websockets", "python_multipart", "prometheus_client")
_LOCAL = "127.0.0.1"
Port = Annotated[int, Within(0, 65_535, "")]


def serve(
    *,
    reading: opt.MapSize,
    taken: opt.Resources,
    maps: list[Path] = option(
        [],
        "Maps: map_server YAML files, images with --resolution, names of bundled maps, or folders "
        "of maps. Clients may send more.",
        "[MAPS...]",
    ),
    port: Port = option(PORT, "Port to listen at; 0 takes any that is free."),
    host: str = option(
        _LOCAL, "Address to listen at; one that others reach needs --token.", metavar="ADDRESS"
    ),
    token: str | None = option(
        None,
        "Secret that requests must carry: 16 characters or more. [default: the environment "
        "variable IMGLOC_TOKEN, or none]",
        metavar="TEXT",
    ),
    allow_host: list[str] = option(
        [], "Another name by which clients call this host. May be repeated.", metavar="NAME"
    ),
    bounds: Bounds,
    kept: opt.Kept,
    typed: Typed,
) -> None:
    """Answer over HTTP: where scans are, from which map; and a page at / that shows why.

    Prints its address when the maps are prepared. Without --host only this machine reaches it. It
    opens no file that a client names. SIGTERM and Ctrl-C end what runs and refuse the rest.

    Examples
    --------
    imgloc serve office.yaml
    imgloc serve floors --port 8080 --threads 4
    curl -X POST -T scans.npz 'http://127.0.0.1:8080/v1/localize?index=3'
    IMGLOC_TOKEN=... imgloc serve office.yaml --host 0.0.0.0
    """
    _check_installed()
    from imgloc.live.guard import Access
    from imgloc.live.service import Service

    access = Access(host, token or os.environ.get("IMGLOC_TOKEN"), tuple(allow_host))
    core, begun = _core(maps, reading, taken, kept, typed)

    def show(address: str) -> None:
        emit(address)
        if access.token is not None:
            there = re.sub(r"//(0\.0\.0\.0|\[::\])", f"//{socket.gethostname()}", address)
            say(f"in a browser: {there}/#token=TOKEN, with your token instead of TOKEN")

    _run(lambda: Service(core, access, bounds, begun), host, port, show)


def open(  # noqa: A001 (the command's name)
    *,
    map_path: opt.MapPath,
    logs: opt.LogTaken,
    chosen: Annotated[Chosen, Only("index")],
    mounting: Mounting,
    reading: opt.MapSize,
    taken: opt.Resources,
    scans_path: Annotated[Path | None, Option(opt.SCANS, "[SCANS]", parse=opt.find_scans)] = None,
    port: Port = option(0, "Port to listen at. [default: any that is free]"),
    kept: opt.Kept,
    typed: Typed,
) -> None:
    """Look at a map and scans in the browser: answers in place, and why.

    Serves a page on this machine alone, prints its address and opens it. Ctrl-C ends it.

    Examples
    --------
    imgloc open office.yaml
    imgloc open office.yaml scans.npz
    """
    _check_installed()
    import webbrowser

    from imgloc.cli import inputs
    from imgloc.live.service import ScansHeld, Service

    opened = None
    if scans_path is not None:
        how = inputs.as_recorded(logs, chosen, mounting)
        there = inputs.desk_of(**vars(taken)).scans(scans_path, how)
        chosen_few = None if len(there.indices) == there.total else tuple(there.indices)
        opened = ScansHeld(
            there.name,
            _recorded(there.recorded, mounting),
            options=_passed(typed, Logs, vars(logs)),
            indices=chosen_few,
            taken=_taken(logs, mounting),
        )
    core, begun = _core([map_path], reading, taken, kept, typed)

    def show(address: str) -> None:
        emit(address)
        webbrowser.open(address)

    _run(lambda: Service(core, given=replace(begun, opened=opened)), _LOCAL, port, show)


_TAKEN = ("scale", "range_max", "sensor", "flipped")  # the page has controls for them


def _taken(logs: Logs, mounting: Mounting) -> dict[str, Any]:
    """The service's parameters for how scans were taken; None for what is as usual."""
    said = {"range_scale": None if logs.scale == 1 else logs.scale, "range_max": logs.range_max}
    sensor = None if mounting.sensor is None else ",".join(map(str, mounting.sensor))
    return {**said, "sensor": sensor, "flipped": mounting.flipped or None}


def _recorded(recorded: "ScanSet", mounting: Mounting) -> "ScanSet":
    """The scans as the page has them before it applies how they were taken, which it may change."""
    if mounting.sensor is None:
        return recorded
    return replace(recorded, scans=tuple(replace(s, T_base_laser=None) for s in recorded.scans))


def _passed(
    typed: Typed, kind: Any, values: Mapping[str, Any], without: Sequence[str] = _TAKEN
) -> tuple[tuple[str, str], ...]:
    """The options of a group that were typed: as a command takes them, and as Python does."""
    parts = [one for one in declared(kind) if one.flag in typed and one.name not in without]
    given = {one.name: values[one.name] for one in parts}
    plain = {key: tuple(v) if isinstance(v, Pose2D) else v for key, v in given.items()}
    return tuple(("=".join(typed[one.flag]), f"{one.name}={plain[one.name]!r}") for one in parts)


def _check_installed() -> None:
    """Refuse to begin without what the service is made of."""
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        some = ", ".join(name.replace("_", "-") for name in missing)
        raise ConfigError(f"serve: needs {some}; pip install 'imgloc[serve]'")


def _core(
    given: Sequence[Path],
    reading: opt.MapImages,
    taken: opt.Resources,
    kept: opt.Kept,
    typed: Typed,
) -> "tuple[Localizer, Begun]":
    """The maps, which are prepared from now on, and how each is read on a command line."""
    from imgloc.cli import inputs
    from imgloc.live.localizer import Localizer
    from imgloc.live.service import Begun

    options = Options(**vars(taken))
    folder, paths = inputs.kept_in(kept), _named(given, reading)
    maps = inputs.map_files(reading, many=len(paths) > 1)
    makers, keep = inputs.site_makers(paths, maps, options, folder)
    core = Localizer(makers, options, background=True, prepared=keep)
    bundled = {opt.find_map(path): display(path) for path in given}
    bare = [name for name, path in paths.items() if path.suffix.lower() not in YAML_ENDINGS]
    size = _passed(typed, opt.MapImages, reading, ())
    how = {name: size if name in bare or not maps.many else () for name in paths}
    names = {name: bundled.get(path, display(path)) for name, path in paths.items()}
    return core, Begun(names, options=how)


def _named(given: Sequence[Path], reading: opt.MapImages) -> dict[str, Path]:
    """Files of maps by the names that clients call them, in the order given."""
    from imgloc.cli import inputs

    out: dict[str, Path] = {}
    for path in given:
        if is_folder(path):
            named = inputs.maps_in(path, reading)
        else:
            file = opt.find_map(path)
            file_of_folder = file.stem == "map" and file.resolve().parent.name
            named = {file_of_folder or file.stem: file}
        for name, file in named.items():
            plain = re.sub(r"[^A-Za-z0-9._ -]+", "-", name).strip("-_. ")[:90] or "map"
            some = (plain if k == 1 else f"{plain}-{k}" for k in range(1, len(out) + 2))
            out[next(one for one in some if one not in out)] = file
    return out


def _run(make: "Callable[[], Any]", host: str, port: int, show: Callable[[str], object]) -> None:
    """Serve until a signal comes; `show` is given the address when the maps are prepared."""
    from imgloc.live.server import address_of, bound, serve

    one = bound(host, port)
    service, address = make(), address_of(one)

    def ready() -> None:
        core = service.core
        core.wait()
        failed = dict(core.errors)
        if failed and len(failed) == len(core.names):
            raise next(iter(failed.values()))
        for name, error in failed.items():
            say(f"left out: {error}")
            core.drop(name)
        if not service.stopping.is_set():
            show(address)
        if not LOG.isEnabledFor(logging.INFO):  # what clients send is no news here
            for handler in LOG.handlers:
                handler.setLevel(logging.ERROR)

    LOG.info("listening at %s", address)
    if serve(service, one, ready) == INTERRUPTED - 128:
        raise typer.Exit(INTERRUPTED)
