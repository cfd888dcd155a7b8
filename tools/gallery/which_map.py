"""Which map?
==========

Which of several maps is a scan from? Its likelihood averaged over each of them says so."""

from imgloc import Picture, draw, load_map, localize, prepare, simulate, which
from imgloc.io.maps import bundled_maps
from imgloc.output.pictures import mosaic


def picture() -> Picture:
    """The scan where it fits best in each of three maps, with the probability of the map."""
    names = ("curved", "visibility", "double_wall")
    maps = {name: prepare(load_map(bundled_maps() / f"{name}.yaml"), name) for name in names}
    scan = simulate(maps["visibility"].grid, 1, seed=6)[0]
    choice = which(maps, scan)
    sheets = [
        draw(maps[name], localize(maps[name], scan), scan, title=f"{name}, {100 * share:.1f} %")
        for name, share in choice.probability.items()
    ]
    return mosaic(sheets)
