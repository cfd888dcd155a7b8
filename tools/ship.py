"""Is what people install whole? The wheel, the ament package, the container, systemd's unit.

    python -m tools.ship                # needs pip install -e '.[ship]'

Builds an sdist of the checkout and a wheel from the sdist, compares the files in the wheel with
those under version control, installs the wheel in an empty environment and runs it there. Builds
the package of ROS 2 by colcon and runs it. Lints and builds the container, verifies the unit.
Leaves out checks whose program is not on this machine, and prints which. Exits with 1 if something
is missing or wrong.
"""

import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.script import parser_of

ROOT = Path(__file__).resolve().parents[1]
DOCKERFILE = ROOT / "tools" / "deploy" / "Dockerfile"
UNIT = ROOT / "tools" / "deploy" / "imgloc.service"
AMENT = ROOT / "tools" / "ros" / "imgloc_ros"
EXPOSED = 20
"""Tenths of the exposure, 0 to 100, that ``systemd-analyze security`` may find; 13 are left."""
_OFFLINE = 250  # systemd that looks at a unit which is only a file
_SECONDS = 1200  # that one command may take


class Wrong(Exception):  # noqa: N818 (it is a finding, not a defect of this tool)
    """What is missing or wrong."""


def run(*words: object, cwd: Path | None = None) -> str:
    """Run a command; its output, or Wrong with the end of what it printed."""
    done = subprocess.run(  # noqa: S603 (words of this file)
        [str(word) for word in words], cwd=cwd, text=True, timeout=_SECONDS,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    if done.returncode:
        last = "\n".join(done.stdout.splitlines()[-20:])
        raise Wrong(f"{' '.join(map(str, words))}: exit code {done.returncode}\n{last}")
    return done.stdout


def differences(wheel: Path, tracked: Iterable[str]) -> list[str]:
    """What a wheel lacks of the files under version control, and what else is in it.

    `tracked` are paths from the root of the checkout. All of ``imgloc/`` belongs in a wheel, and
    ``maps/`` as ``imgloc/maps/``.
    """
    wanted = {path for path in tracked if path.startswith("imgloc/")}
    wanted |= {f"imgloc/{path}" for path in tracked if path.startswith("maps/")}
    with zipfile.ZipFile(wheel) as file:
        found = {name for name in file.namelist() if ".dist-info/" not in name}
    missing = [f"{name} is missing" for name in sorted(wanted - found)]
    return missing + [f"{name} is not under version control" for name in sorted(found - wanted)]


def build(folder: Path) -> Path:
    """Build an sdist and from it a wheel, check what is in the wheel, and return its path."""
    run(sys.executable, "-m", "build", "--outdir", folder, ROOT)
    (wheel,) = folder.glob("*.whl")
    listed = run("git", "-C", ROOT, "ls-files", "-z", "imgloc", "maps")
    if wrong := differences(wheel, [name for name in listed.split("\0") if name]):
        raise Wrong(f"{wheel.name}: {'; '.join(wrong)}")
    return wheel


def install(wheel: Path, folder: Path) -> None:
    """Install a wheel in an empty environment; run the demo and open each bundled map there."""
    run(sys.executable, "-m", "venv", folder / "empty")
    programs = folder / "empty" / ("Scripts" if sys.platform == "win32" else "bin")
    run(programs / "python", "-m", "pip", "install", "-q", wheel)
    work = folder / "work"
    work.mkdir()
    imgloc = programs / "imgloc"
    if "unique" not in run(imgloc, "demo", "--out", "demo.png", cwd=work):
        raise Wrong("imgloc demo: its pose is not unique")
    if not (work / "demo.png").stat().st_size:
        raise Wrong("imgloc demo: its picture is empty")
    names = sorted(path.stem for path in (ROOT / "maps").glob("*.yaml"))
    run(imgloc, "inspect", *names, cwd=work)


def lint_dockerfile() -> str:
    """Lint the Dockerfile; return what to print about it."""
    program = shutil.which("hadolint", path=str(Path(sys.executable).parent)) or "hadolint"
    if shutil.which(program) is None:
        return "not linted, because hadolint is not installed"
    run(program, DOCKERFILE)
    return "no finding"


def build_container() -> str:
    """Build the container with docker or podman and run the demo in it; return what to print."""
    for program in ("docker", "podman"):
        try:
            run(program, "info")
        except (Wrong, OSError):
            continue
        run(program, "build", "-q", "-t", "imgloc-ship", "-f", DOCKERFILE, ROOT)
        try:
            run(program, "run", "--rm", "--network", "none", "imgloc-ship", "demo")
        finally:
            run(program, "rmi", "imgloc-ship")
        return f"built by {program}, the demo runs in it"
    return "not built, because neither docker nor podman runs here"


def build_ament() -> str:
    """Build the ament package with colcon and run its executable; return what to print."""
    program = Path(sys.executable).parent / "colcon"
    if not program.exists():
        return "not built, because colcon is not installed"
    with TemporaryDirectory() as folder:
        package = Path(folder, "src", AMENT.name)
        shutil.copytree(AMENT, package, ignore=shutil.ignore_patterns("build", "*.egg-info"))
        run(program, "build", cwd=Path(folder))
        there = Path(folder, "install", AMENT.name)
        for path in ("package.xml", "launch/first_pose.launch.py", "config/imgloc.params.yaml",
                     "rviz/imgloc.rviz", "foxglove/imgloc.json"):  # fmt: skip
            if not (there / "share" / AMENT.name / path).is_file():
                raise Wrong(f"{AMENT.name}: {path} is not installed")
        node = there / "lib" / AMENT.name / "imgloc"
        setup = f"COLCON_CURRENT_PREFIX={folder}/install; . {folder}/install/local_setup.sh"
        run("sh", "-c", f"{setup} && {node} node --help")
    return "built by colcon, its executable runs"


def verify_unit() -> str:
    """Let systemd check the unit; return what to print about it."""
    program = shutil.which("systemd-analyze")
    if program is None:
        return "not verified, because systemd-analyze is not installed"
    with TemporaryDirectory() as folder:  # for a copy whose program exists
        there = Path(folder, UNIT.name)
        start = f"ExecStart={shutil.which('true')} "
        there.write_text(re.sub(r"(?m)^ExecStart=\S+ ", start, UNIT.read_text("utf-8")))
        run(program, "verify", there)
        version = re.match(r"systemd (\d+)", run(program, "--version"))
        if version is None or int(version[1]) < _OFFLINE:
            return "verified"
        limit = f"--threshold={EXPOSED}"
        found = run(program, "security", "--no-pager", "--offline=true", limit, there)
    return f"verified, {found.splitlines()[-1].strip('→ ')}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Check wheel, container and unit; 1 if something is wrong."""
    parser = parser_of("tools.ship", __doc__)
    parser.parse_args(arguments)
    try:
        with TemporaryDirectory() as folder:
            wheel = build(Path(folder, "dist"))
            print(f"{wheel.name}: has all files, {wheel.stat().st_size / 1e6:.1f} MB")
            install(wheel, Path(folder))
            print(f"{wheel.name}: the demo and all bundled maps work in an empty environment")
        print(f"{AMENT.name}: {build_ament()}")
        print(f"{DOCKERFILE.name}: {lint_dockerfile()}")
        print(f"container: {build_container()}")
        print(f"{UNIT.name}: {verify_unit()}")
    except Wrong as error:
        print(f"wrong: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
