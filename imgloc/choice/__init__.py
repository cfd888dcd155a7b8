"""The choice of the map that a scan is from, among a few or, by an index, among hundreds."""
