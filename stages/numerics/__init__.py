"""Plain functions on arrays: no frames, no files, no settings."""
