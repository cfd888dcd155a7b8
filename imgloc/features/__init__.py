"""What the algorithms see: surface points, fields, visibility and ray distances."""
