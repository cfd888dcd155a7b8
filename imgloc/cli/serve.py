"""`imgloc serve`, `imgloc open`: answers over HTTP, and a page to look at them."""

import re
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import INTERRUPTED, LOG, emit, say
from imgloc.cli.options import option
from imgloc.errors import ConfigError
from imgloc.io.files import display, is_folder

if TYPE_CHECKING:
    from imgloc.live.localizer import Localizer

PORT = 8080
_NEEDED = ("starlette", "uvicorn", "websockets", "python_multipart", "prometheus_client")
MapsPaths = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[MAPS...]",
        help="Maps: map_server YAML files, images with --resolution, names of bundled maps, or "
        "folders of maps. Clients may send more.",
    ),
]
_LOCAL = "127.0.0.1"
_BODY = "64M"


@opt.with_options(opt.reading, opt.taken, opt.console)
def serve(
    reading: "opt.Reading",
    taken: opt.Resources,
    maps: MapsPaths = None,
    port: int = option(
        PORT, "N", "Port to listen at; 0 takes any that is free.", min=0, max=65_535
    ),
    host: str = option(
        _LOCAL, "ADDRESS", "Address to listen at; one that others reach needs --token."
    ),
    token: str | None = option(
        None, "TEXT", "What requests must carry: 16 characters or more.", envvar="IMGLOC_TOKEN"
    ),
    allow_host: list[str] | None = option(
        None, "NAME", "Another name by which clients call this host; may be repeated."
    ),
    seconds: float = option(
        30.0, "S", "Seconds after which an answer is given up.", within=(0.1, 3600, "seconds")
    ),
    patience: float = option(
        15.0, "S", "Seconds within which a request has to come.", within=(0.1, 3600, "seconds")
    ),
    waiting: int = option(
        16, "N", "Requests that may wait for an answer; more are refused.", min=1, max=10_000
    ),
    max_body: Any = option(_BODY, "BYTES", "Largest body of a request.", parser=opt.byte_count),
    cache: opt.CacheDir = None,
    no_cache: opt.NoCache = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Answer over HTTP: where scans are, from which map; and a page at / that shows why.

    Prints its address when the maps are prepared. Without --host only this machine reaches it. It
    opens no file that a client names. SIGTERM and Ctrl-C end what runs and refuse the rest.
    """
    _check_installed()
    from imgloc.live.guard import Access
    from imgloc.live.requests import Bounds
    from imgloc.live.service import Given, Service

    access = Access(host, token, tuple(allow_host or ()))
    bounds = Bounds(body=max_body, seconds=seconds, patience=patience, waiting=waiting)
    core, paths = _core(maps or [], reading, taken, cache, no_cache, allow_lossy)
    _run(lambda: Service(core, access, bounds, Given(paths)), host, port, emit)


@opt.with_options(opt.logs, opt.reading, opt.taken, opt.console)
def open(  # noqa: A001 (the command's name)
    map_path: opt.MapPath,
    logs: opt.Logs,
    reading: "opt.Reading",
    taken: opt.Resources,
    scans_path: Annotated[
        Path | None,
        typer.Argument(metavar="[SCANS]", help="A file of scans, as of `imgloc localize`."),
    ] = None,
    cache: opt.CacheDir = None,
    no_cache: opt.NoCache = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Look at a map and scans in the browser: answers in place, and why.

    Serves a page at a free port of this machine, prints its address and opens it. Ctrl-C ends it.
    """
    _check_installed()
    import webbrowser

    from imgloc.cli import inputs
    from imgloc.live.service import Given, ScansHeld, Service

    opened = None
    if scans_path is not None:
        scans = inputs.desk_of(*taken).scans(scans_path, inputs.as_recorded(logs)).scans
        opened = ScansHeld("0" * 16, inputs.name_of(scans_path), scans)
    core, paths = _core([map_path], reading, taken, cache, no_cache, allow_lossy)

    def show(address: str) -> None:
        emit(address)
        webbrowser.open(address)

    _run(lambda: Service(core, given=Given(paths, opened)), _LOCAL, 0, show)


def _check_installed() -> None:
    """Refuse to begin without what the service is made of."""
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        some = ", ".join(name.replace("_", "-") for name in missing)
        raise ConfigError(f"serve: needs {some}; pip install 'imgloc[serve]'")


def _core(
    given: Sequence[Path],
    reading: "opt.Reading",
    taken: opt.Resources,
    cache: Path | None,
    no_cache: bool,
    allow_lossy: bool,
) -> "tuple[Localizer, dict[str, str]]":
    """The maps, which are prepared from now on, and what each is called on a command line."""
    from imgloc.cli import inputs
    from imgloc.live.localizer import Localizer
    from imgloc.options import Options
    from imgloc.runs.opening import MapFiles

    options = Options(threads=taken.threads, memory_budget=taken.memory_budget)
    folder, paths = inputs.kept_in(cache, wanted=not no_cache), _named(given, reading)
    maps = MapFiles(reading, allow_lossy, many=len(paths) > 1)
    makers, keep = inputs.site_makers(paths, maps, options, folder)
    core = Localizer(makers, options, background=True, prepared=keep)
    bundled = {opt.find_map(path): display(path) for path in given}
    return core, {name: bundled.get(path, display(path)) for name, path in paths.items()}


def _named(given: Sequence[Path], reading: "opt.Reading") -> dict[str, Path]:
    """Files of maps by the names that clients call them, in the order given."""
    from imgloc.choice.choose import names_of
    from imgloc.io.folders import find_maps

    out: dict[str, Path] = {}
    for path in given:
        if is_folder(path):
            files = find_maps(path, images=reading.get("resolution") is not None)
            named = list(zip(names_of(files, path), files, strict=True))
        else:
            file = opt.find_map(path)
            named = [(file.stem, file)]
        for name, file in named:
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

    LOG.info("listening at %s", address)
    if serve(service, one, ready) == INTERRUPTED - 128:
        raise typer.Exit(INTERRUPTED)
