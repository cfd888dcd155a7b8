"""A robot that is not there: a log played to ROS 2, its listener, and kills at random moments."""
