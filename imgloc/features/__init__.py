"""Features of a map and a scan: surface points, fields, visibility and ray distances."""
