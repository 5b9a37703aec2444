"""Recordings that come with the repository, and the renderer that made them."""
