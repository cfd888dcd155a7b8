"""Seen by the algorithms: surface points, fields, visibility and ray distances."""
