"""Measurements and comparisons: evaluation, calibration, atlas."""
