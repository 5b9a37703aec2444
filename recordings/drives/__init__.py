"""Renders synthetic drives past road signs, with exact truth, from TOML specifications."""

SCHEMA_VERSION = 1
"""Version of the truth files."""

RENDERER_VERSION = 1
"""Grows with every change that changes the bytes of a drive."""
