"""Pictures, tables, files."""
