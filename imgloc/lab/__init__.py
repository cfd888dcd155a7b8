"""What measures, and what is compared: evaluation, calibration, atlas, two more filters."""
