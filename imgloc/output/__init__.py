"""Everything that leaves the program: rows of JSON, tables, pictures and pages."""
