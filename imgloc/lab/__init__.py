"""Measurements and comparisons: evaluation, calibration, atlas, two more filters."""
