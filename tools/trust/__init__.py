"""Can answers be trusted? Masses and verdicts, conditions beside an oracle, names of maps."""
