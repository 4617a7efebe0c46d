"""Hold runs against reference results: files, quantities, a table and pictures. It knows channels, but no model."""
