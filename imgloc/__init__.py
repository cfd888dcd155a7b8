"""imgloc: where am I on this map? Global localization of a laser scan in a map image.

The names below are loaded when they are first used, so that ``import imgloc`` is cheap:

>>> import imgloc
>>> from imgloc.io.maps import bundled_maps
>>> features = imgloc.prepare(imgloc.load_map(bundled_maps() / "curved.yaml"))
>>> scans = imgloc.simulate(features.grid, 1, seed=1)
>>> imgloc.localize(features, scans[0]).verdict
'unique'
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
