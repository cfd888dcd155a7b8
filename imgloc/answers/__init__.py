"""Built on one answer: why it is given, what may be wrong with the scans, draws."""
