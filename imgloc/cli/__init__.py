"""The command line: parses, calls and prints. What it calls is imported when a command runs."""
