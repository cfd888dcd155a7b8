"""Scans, and worlds, that are not there."""
