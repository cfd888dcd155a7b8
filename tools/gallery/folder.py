"""A folder of scans
=================

A folder of files of scans, whatever their formats: every answer, without an exception."""

from pathlib import Path
from tempfile import TemporaryDirectory

from imgloc import ImglocError, Picture, draw, load_map, load_scans, localize, prepare, save_scans
from imgloc.io.maps import bundled_maps
from imgloc.output.pictures import mosaic
from imgloc.simulation.scans import simulate


def picture() -> Picture:
    """Two good files and a broken one: a picture of each answer, the error as a title."""
    grid = load_map(bundled_maps() / "double_wall.yaml")
    features, sheets = prepare(grid), []
    with TemporaryDirectory() as name:
        folder = Path(name)
        for seed in (1, 2):
            save_scans(folder / f"run{seed}.npz", simulate(grid, 1, seed))
        (folder / "run3.csv").write_text("1.0,2.0\nnot a number,3.0\n")
        for file in sorted(folder.iterdir()):
            try:
                scan = load_scans(file)[0]
            except ImglocError as error:
                words = str(error).removeprefix(f"{folder}/")
                sheets.append(draw(grid, title=words))
                continue
            answer = localize(features, scan)
            sheets.append(draw(features, answer, scan, title=file.name))
    return mosaic(sheets)
