"""A robot as logs, streams and nodes have it: lasers with names, frames over time, odometry."""
