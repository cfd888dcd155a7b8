"""Maps, scans and lists behind an address: from a server on this machine, and in archives."""

import http.server
import json
import shutil
import threading
import time
import zipfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call

import imgloc
from imgloc.errors import ImglocError, MapError
from imgloc.io import remote

pytest.importorskip("fsspec")


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a map whose image lies deeper, scans, a list, and all of it in an archive."""
    folder = tmp_path_factory.mktemp("there")
    (folder / "images").mkdir()
    shutil.copy(MAPS / "curved.png", folder / "images")
    text = (MAPS / "curved.yaml").read_text().replace("curved.png", "images/curved.png")
    (folder / "a.yaml").write_text(text)
    imgloc.save_scans(folder / "a.npz", imgloc.simulate(imgloc.load_map("curved"), 2, 0))
    (folder / "pairs.csv").write_text("map,scans\na.yaml,a.npz\n")
    with zipfile.ZipFile(folder / "all.zip", "w") as archive:
        for path in ("a.yaml", "images/curved.png", "a.npz"):
            archive.write(folder / path, f"in/{path}")
    return folder


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        if "endless" not in self.path:
            return super().do_GET()
        self.send_response(200)
        self.end_headers()
        try:
            while True:
                self.wfile.write(bytes(1 << 16))
                time.sleep(0.01)
        except OSError:
            return None


@pytest.fixture(scope="module")
def address(there: Path) -> Iterator[str]:
    handler = partial(_Quiet, directory=str(there))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize("form", ["{address}/", "zip://in/::{there}/all.zip",
                                  "zip://in/::{address}/all.zip"])  # fmt: skip
def test_an_address_is_read_as_the_file_that_it_names(form: str, address: str, there: Path) -> None:
    before, mark, after = form.format(address=address, there=there).partition("::")
    a_map, scans = (f"{before}{name}{mark}{after}" for name in ("a.yaml", "a.npz"))
    grid, expected = imgloc.load_map(a_map), imgloc.load_map(there / "a.yaml")
    assert grid == expected
    assert imgloc.load_scans(scans) == imgloc.load_scans(there / "a.npz")
    run = call("localize", a_map, scans, "--json")
    assert run.out.count('"verdict"') == 2, run
    poses = [json.loads(line)["pose"]["x"] for line in run.out.splitlines()]
    there_too = call("localize", there / "a.yaml", there / "a.npz", "--json").out.splitlines()
    np.testing.assert_array_equal(poses, [json.loads(line)["pose"]["x"] for line in there_too])
    assert f"next        imgloc localize {a_map} {scans} --" in call("inspect", a_map, scans).out


def test_a_list_names_files_beside_it_and_elsewhere(address, there, tmp_path):
    call("batch", f"{address}/pairs.csv", "--out", tmp_path / "a", "--workers", 1).ends(0)
    pairs = f"map,scans\n{address}/a.yaml,zip://in/a.npz::{there}/all.zip\n"
    (tmp_path / "here.csv").write_text(pairs)
    call("batch", tmp_path / "here.csv", "--out", tmp_path / "b", "--workers", 1).ends(0)


@pytest.mark.parametrize(("name", "why"), [
    ("none.yaml", "no such file"), ("all.zip/none", "no such file"), ("endless", "at most"),
])  # fmt: skip
def test_what_cannot_be_had_is_one_error(name, why, address, monkeypatch):
    monkeypatch.setattr(remote, "MOST_BYTES", 1 << 20)
    run = call("localize", f"{address}/{name}", "a.npz")
    assert (run.code, f"{address}/{name}: " in run.err) == (3, True), run
    assert why in run.err
    assert "Traceback" not in run.err
    assert call("localize", "curved", f"{address}/{name}").code == 4


@pytest.mark.parametrize("image", ["../stolen.png", "/tmp/stolen.png", "images/../../stolen.png"])
def test_a_yaml_elsewhere_writes_nothing_beside_its_copy(image, there, address):
    text = f"image: {image}\nresolution: 0.1\norigin: [0, 0, 0]\n"
    (there / "b.yaml").write_text(text)
    shutil.copy(MAPS / "curved.png", there / "stolen.png")
    with pytest.raises(MapError, match="no such file"):
        imgloc.load_map(f"{address}/b.yaml?{image}")


def test_a_server_that_is_not_there_and_a_scheme_that_is_none() -> None:
    with pytest.raises(ImglocError, match=r"http://127.0.0.1:9/a.yaml: cannot be read"):
        imgloc.load_map("http://127.0.0.1:9/a.yaml")
    with pytest.raises(ImglocError, match=r"package://maps/a.yaml: cannot be read: Protocol not"):
        imgloc.load_map("package://maps/a.yaml")


def test_a_yaml_on_this_machine_fetches_nothing(tmp_path: Path, address: str) -> None:
    said = f"image: {address}/images/curved.png\nresolution: 0.1\norigin: [0, 0, 0]\n"
    (tmp_path / "a.yaml").write_text(said)
    with pytest.raises(ImglocError, match="names it as its image; it is an address"):
        imgloc.load_map(tmp_path / "a.yaml")


def test_without_fsspec_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fsspec", None)
    with pytest.raises(ImglocError, match=r"needs fsspec: pip install 'imgloc\[remote\]'"):
        imgloc.load_map("s3://bucket/a.yaml")
