"""Files in, files out: maps, scans, and results written whole or not at all."""
