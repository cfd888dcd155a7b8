"""Simulated sensors and the experiments of the paper."""
