"""How far an image is from its reference: one metric a file, `compare` for a whole table."""
