"""Filters that follow a moving robot by odometry and scan after scan (eq. 1)."""
