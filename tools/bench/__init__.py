"""The benchmark of imgloc: ratios of things timed in turns in one run."""
