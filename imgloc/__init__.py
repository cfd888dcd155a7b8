"""imgloc: where am I on this map? Global localization of a laser scan in a map image."""

__version__ = "0.1.0"
