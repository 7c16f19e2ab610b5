"""Error measures, one a file."""
