"""The robot moves: what odometry and scan after scan say together (eq. 1)."""
