"""Folders of maps and scans: items, what is done with each, rows that no interrupt loses."""
