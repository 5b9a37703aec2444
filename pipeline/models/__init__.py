"""The shipped model files, and how model files are read and checked."""
